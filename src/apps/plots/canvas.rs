//! Draws with `plotters` to SVG or PNG, depending on the file extension; text in a PNG uses the [embedded
//! typeface](crate::apps::text), so that no system font is needed.

use crate::apps::picture::image;
use crate::apps::text;
use crate::base::{Error, Result, printable};
use crate::mesh::output::publish;
use plotters::chart::MeshStyle;
use plotters::coord::Shift;
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::{
    BitMapBackend, DrawingArea, DrawingAreaErrorKind, DrawingBackend, IntoDrawingArea, IntoFont, RGBColor, SVGBackend,
    TextStyle, WHITE,
};
use plotters::style::text_anchor::Pos;
use plotters_backend::text_anchor::{HPos, VPos};
use plotters_backend::{BackendColor, BackendCoord, BackendStyle, BackendTextStyle, DrawingErrorKind};
use std::io::Write;
use std::path::Path;

/// Colour of text and axes.
pub(super) const INK: RGBColor = RGBColor(60, 60, 60);
/// Colour of grid lines.
pub(super) const RULE: RGBColor = RGBColor(225, 225, 225);

/// Text of this size, in pixels.
pub(super) fn font(size: u32) -> TextStyle<'static> {
    ("sans-serif", size).into_font().color(&INK)
}

/// Text of a chart without axes, beside or below a point at its middle.
pub(super) fn label(h_pos: HPos) -> TextStyle<'static> {
    font(14).pos(Pos { h_pos, v_pos: VPos::Center })
}

/// Styles axes, with their labels in text of this size, and grid lines.
pub(super) fn style_axes<B: DrawingBackend>(
    mesh: &mut MeshStyle<'_, '_, RangedCoordf64, RangedCoordf64, B>,
    size: u32,
) {
    mesh.label_style(font(size)).axis_desc_style(font(size)).axis_style(INK);
    mesh.bold_line_style(RULE).light_line_style(WHITE);
}

/// The result of drawing.
pub(super) type Drawn<B> = std::result::Result<(), DrawingAreaErrorKind<<B as DrawingBackend>::ErrorType>>;

/// Something that can be drawn on any backend.
pub(super) trait Drawing {
    /// Draws all of it on `area`.
    fn draw<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Drawn<B>;
}

/// Draws to `path`, which ends in `.svg` or `.png`, `size` pixels wide and high.
///
/// # Errors
/// [`Error::Parameter`] for another extension, [`Error::Unusable`] if drawing fails, [`Error::Io`].
pub(super) fn save(path: &Path, size: (u32, u32), drawing: &impl Drawing) -> Result<()> {
    let failed = |problem: String| Error::unusable(path, format!("cannot be drawn ({problem})"), "check the folder");
    match path.extension().map(|extension| extension.to_ascii_lowercase()) {
        Some(extension) if extension == "svg" => {
            let mut text = String::new();
            drawing
                .draw(&SVGBackend::with_string(&mut text, size).into_drawing_area())
                .map_err(|error| failed(error.to_string()))?;
            // Titles contain names of meshes; XML does not allow control characters.
            let text = printable::lines(&text);
            publish(path, 0, |file| file.write_all(text.as_bytes()).map_err(Error::io(path, "write")))
        }
        Some(extension) if extension == "png" => {
            let mut pixels = vec![255; 3 * size.0 as usize * size.1 as usize];
            let backend = PixelText(BitMapBackend::with_buffer(&mut pixels, size));
            drawing.draw(&backend.into_drawing_area()).map_err(|error| failed(error.to_string()))?;
            image::write_png(path, size, png::ColorType::Rgb, &pixels)
        }
        _ => Err(Error::extension("plot", path, "use .svg or .png")),
    }
}

/// A bitmap whose text is drawn pixel by pixel, in the embedded typeface.
struct PixelText<'a>(BitMapBackend<'a>);

type Done<B> = Result<(), DrawingErrorKind<<B as DrawingBackend>::ErrorType>>;

impl<'a> DrawingBackend for PixelText<'a> {
    type ErrorType = <BitMapBackend<'a> as DrawingBackend>::ErrorType;

    fn get_size(&self) -> (u32, u32) {
        self.0.get_size()
    }

    fn ensure_prepared(&mut self) -> Done<Self> {
        self.0.ensure_prepared()
    }

    fn present(&mut self) -> Done<Self> {
        self.0.present()
    }

    fn draw_pixel(&mut self, point: BackendCoord, colour: BackendColor) -> Done<Self> {
        self.0.draw_pixel(point, colour)
    }

    fn draw_rect<S: BackendStyle>(&mut self, a: BackendCoord, b: BackendCoord, style: &S, fill: bool) -> Done<Self> {
        self.0.draw_rect(a, b, style, fill)
    }

    fn estimate_text_size<S: BackendTextStyle>(
        &self,
        text: &str,
        style: &S,
    ) -> Result<(u32, u32), DrawingErrorKind<Self::ErrorType>> {
        Ok((text::width(text, style.size()).ceil() as u32, style.size().ceil() as u32))
    }

    fn draw_text<S: BackendTextStyle>(&mut self, text: &str, style: &S, at: BackendCoord) -> Done<Self> {
        let (width, size) = (text::width(text, style.size()), style.size());
        let anchor = style.anchor();
        let left = f64::from(at.0)
            - match anchor.h_pos {
                HPos::Left => 0.,
                HPos::Center => width / 2.,
                HPos::Right => width,
            };
        // Measured from the middle of capitals, which are 0.73 em high.
        let base = f64::from(at.1)
            + match anchor.v_pos {
                VPos::Top => 0.86 * size,
                VPos::Center => 0.36 * size,
                VPos::Bottom => -0.14 * size,
            };
        let (right, bottom) = (i64::from(self.get_size().0), i64::from(self.get_size().1));
        let (colour, mut result) = (style.color(), Ok(()));
        text::draw(text, [left.round(), base.round()], size, |x, y, coverage| {
            if coverage > 0. && result.is_ok() && (0..right).contains(&x) && (0..bottom).contains(&y) {
                let colour = BackendColor { alpha: colour.alpha * f64::from(coverage), ..colour };
                result = self.draw_pixel((x as i32, y as i32), colour);
            }
        });
        result
    }
}
