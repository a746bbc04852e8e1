//! Something drawn with `plotters`, to the form that a file's ending names.

use crate::apps::pixel_text::{PixelText, write_png};
use crate::base::{Error, Result};
use plotters::coord::Shift;
use plotters::prelude::{
    BitMapBackend, DrawingArea, DrawingAreaErrorKind, DrawingBackend, IntoDrawingArea, RGBColor, SVGBackend,
};
use std::path::Path;

/// Text and axes.
pub(in crate::apps) const INK: RGBColor = RGBColor(60, 60, 60);
/// Lines behind the data.
pub(in crate::apps) const RULE: RGBColor = RGBColor(225, 225, 225);

/// What drawing gives.
pub(in crate::apps) type Drawn<B> = std::result::Result<(), DrawingAreaErrorKind<<B as DrawingBackend>::ErrorType>>;

/// Something drawn on any backend.
pub(in crate::apps) trait Drawing {
    /// Draws all of it on `area`.
    fn draw<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Drawn<B>;
}

/// Draws to `path`, which ends in `.svg` or `.png`, `size` pixels wide and high.
///
/// # Errors
/// [`Error::Parameter`] for another ending, [`Error::Unusable`] where it cannot be drawn, [`Error::Io`].
pub(in crate::apps) fn save(path: &Path, size: (u32, u32), drawing: &impl Drawing) -> Result<()> {
    let failed = |problem: String| Error::unusable(path, format!("cannot be drawn ({problem})"), "check the folder");
    match path.extension().map(|ending| ending.to_ascii_lowercase()) {
        Some(ending) if ending == "svg" => {
            let mut text = String::new();
            drawing
                .draw(&SVGBackend::with_string(&mut text, size).into_drawing_area())
                .map_err(|error| failed(error.to_string()))?;
            std::fs::write(path, text).map_err(Error::io(path, "write"))
        }
        Some(ending) if ending == "png" => {
            let mut pixels = vec![255; 3 * size.0 as usize * size.1 as usize];
            let backend = PixelText(BitMapBackend::with_buffer(&mut pixels, size));
            drawing.draw(&backend.into_drawing_area()).map_err(|error| failed(error.to_string()))?;
            write_png(path, &pixels, size).map_err(Error::io(path, "write"))
        }
        _ => Err(Error::parameter("plot", format!("{} is no chart", path.display()), "end it with .svg or .png")),
    }
}
