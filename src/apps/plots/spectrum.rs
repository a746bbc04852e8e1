//! The decay of the eigenvalues of the landmarks' affinities A, on a logarithmic scale if they span several decades.
//!
//! Where they have decayed to nothing, more landmarks or coordinates add no information; negative ones show that the
//! kernel of these distances is indefinite.

use super::canvas::{Drawing, Drawn, font, save, style_axes};
use crate::base::{Error, Result};
use plotters::coord::Shift;
use plotters::prelude::{ChartBuilder, Circle, Color, DrawingArea, DrawingBackend, PathElement, RGBColor, Text, WHITE};
use std::path::Path;

const KEPT: RGBColor = RGBColor(0, 114, 178);
const DROPPED: RGBColor = RGBColor(150, 150, 150);
const NEGATIVE: RGBColor = RGBColor(213, 94, 0);
/// Values below this share of the greatest are drawn at it: they are rounding errors.
const LEAST: f64 = 1e-9;

/// Eigenvalues to draw.
///
/// ```
/// use nystrom_stream::apps::plots::Spectrum;
/// let path = std::env::temp_dir().join("spectrum.svg");
/// Spectrum { title: "three landmarks", values: &[2.1, 0.7, 0.2], dropped: 0 }.plot(&path)?;
/// # Ok::<(), nystrom_stream::base::Error>(())
/// ```
#[derive(Clone, Copy, Debug)]
pub struct Spectrum<'a> {
    /// A title.
    pub title: &'a str,
    /// The eigenvalues, descending.
    pub values: &'a [f64],
    /// How many of them, from the end, are dropped as negative or too small.
    pub dropped: usize,
}

impl Spectrum<'_> {
    /// Draws to `path`, which ends in `.svg` or `.png`.
    ///
    /// # Errors
    /// [`Error::Parameter`] for another extension or no positive eigenvalue, [`Error::Unusable`], [`Error::Io`].
    pub fn plot(&self, path: &Path) -> Result<()> {
        if self.values.first().is_some_and(|first| first.is_finite() && *first > 0.) {
            return save(path, (720, 420), self);
        }
        Err(Error::parameter("eigenvalues", "none is positive", "plot those of a run that has landmarks"))
    }
}

impl Drawing for Spectrum<'_> {
    fn draw<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Drawn<B> {
        area.fill(&WHITE)?;
        let (count, first) = (self.values.len(), self.values[0]);
        let share = |value: f64| (value.abs() / first).max(LEAST);
        let least = self.values.iter().map(|&value| share(value)).fold(1., f64::min);
        // A range of less than a decade is better shown on a linear scale.
        let decades = -least.log10().floor();
        let logarithmic = decades > 1.;
        let height = |value: f64| if logarithmic { share(value).log10() } else { share(value) };
        let range = if logarithmic { -decades..0.2 } else { 0. ..1.1 };
        area.draw(&Text::new(self.title.to_owned(), (16, 12), font(14)))?;
        let (_, body) = area.split_vertically(36);
        let mut chart = ChartBuilder::on(&body)
            .margin(8)
            .margin_right(16)
            .x_label_area_size(40)
            .y_label_area_size(62)
            .build_cartesian_2d(0f64..count as f64 + 1., range)?;
        let mut axes = chart.configure_mesh();
        style_axes(&mut axes, 14);
        axes.x_desc("eigenvalue, from the greatest")
            .x_label_formatter(&|x| format!("{x:.0}"))
            .y_labels(if logarithmic { decades as usize + 1 } else { 6 })
            .y_label_formatter(&|&y| if logarithmic { format!("1e{y:.0}") } else { format!("{y:.1}") })
            .draw()?;
        let kept = count.saturating_sub(self.dropped);
        let points = self.values.iter().enumerate().map(|(k, &value)| (k, value, (k as f64 + 1., height(value))));
        let line: Vec<(f64, f64)> = points.clone().filter(|(.., p)| p.0 <= kept as f64).map(|(.., p)| p).collect();
        chart.draw_series([PathElement::new(line, KEPT.mix(0.4))])?;
        chart.draw_series(points.map(|(k, value, at)| match (value < 0., k < kept) {
            (true, _) => Circle::new(at, 4, NEGATIVE.stroke_width(2)),
            (false, true) => Circle::new(at, 4, KEPT.filled()),
            (false, false) => Circle::new(at, 4, DROPPED.filled()),
        }))?;
        let negative = self.values.iter().filter(|value| **value < 0.).count();
        let rows = [
            (format!("{kept} kept"), KEPT.filled()),
            (format!("{} too small", self.dropped.saturating_sub(negative)), DROPPED.filled()),
            (format!("{negative} negative, size drawn"), NEGATIVE.stroke_width(2)),
        ];
        for (k, (text, style)) in (0..).zip(rows) {
            body.draw(&Circle::new((500, 22 + 20 * k), 4, style))?;
            body.draw(&Text::new(text, (512, 16 + 20 * k), font(14)))?;
        }
        area.present()
    }
}
