//! Charts of the study: lines with error bars (Fig. 5), a scatter with quadrants (Fig. 1). SVG or PNG.
//!
//! Text in a PNG is of a built-in bitmap font, so that a chart needs no font of the machine. Cost: milliseconds.

use super::points::Pair;
use super::table::{Line, Spread};
use crate::apps::plots::canvas::{Drawing, Drawn, INK, RULE, save};
use crate::base::Result;
use crate::landmarks::Sampling;
use plotters::coord::Shift;
use plotters::prelude::{
    ChartBuilder, Circle, Color, DrawingArea, DrawingBackend, ErrorBar, IntoFont, LineSeries, PathElement, RGBColor,
    Text, WHITE,
};
use std::path::Path;

const RED: RGBColor = RGBColor(204, 51, 51);
/// Told apart by everyone (after Okabe and Ito).
const COLOURS: [RGBColor; 8] = [
    RGBColor(0, 0, 0),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
    RGBColor(0, 158, 115),
    RGBColor(240, 228, 66),
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(204, 121, 167),
];

/// Γ/n and the held-out residual over the number of landmarks, a line a sampling, bars of one standard deviation.
///
/// # Errors
/// [`crate::base::Error::Parameter`] for another ending, [`crate::base::Error::Unusable`] where the file cannot be drawn.
pub fn comparison(path: &Path, lines: &[Line], title: &str) -> Result<()> {
    save(path, (960, 440), &Comparison { lines, title })
}

struct Comparison<'a> {
    lines: &'a [Line],
    title: &'a str,
}

/// A panel: its title, and the value of a line.
type Panel = (&'static str, fn(&Line) -> Option<Spread>);

impl Drawing for Comparison<'_> {
    fn draw<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Drawn<B> {
        area.fill(&WHITE)?;
        let font = || ("sans-serif", 14).into_font().color(&INK);
        area.draw(&Text::new(self.title.to_owned(), (16, 12), font()))?;
        let mut samplings: Vec<Sampling> = Vec::new();
        for line in self.lines {
            if !samplings.contains(&line.sampling) {
                samplings.push(line.sampling);
            }
        }
        let panels: [Panel; 2] = [
            ("Gamma/n, higher is better", |line| Some(line.gamma_per_node)),
            ("held-out residual, lower is better", |line| line.held_out),
        ];
        let (body, legend) = area.split_vertically(392);
        for ((title, value), part) in panels.iter().zip(body.margin(30, 0, 0, 0).split_evenly((1, 2))) {
            self.panel(&part, title, *value, &samplings)?;
        }
        let mut x = 20;
        for (k, sampling) in samplings.iter().enumerate() {
            let colour = COLOURS[k % COLOURS.len()];
            legend.draw(&PathElement::new(vec![(x, 20), (x + 18, 20)], colour.stroke_width(3)))?;
            legend.draw(&Text::new(sampling.name(), (x + 24, 14), font()))?;
            x += 44 + 8 * sampling.name().len() as i32;
        }
        area.present()
    }
}

impl Comparison<'_> {
    fn panel<B: DrawingBackend>(
        &self,
        area: &DrawingArea<B, Shift>,
        title: &str,
        value: fn(&Line) -> Option<Spread>,
        samplings: &[Sampling],
    ) -> Drawn<B> {
        let all: Vec<(f64, Spread)> =
            self.lines.iter().filter_map(|line| Some((line.l as f64, value(line)?))).collect();
        let low = all.iter().map(|(_, s)| s.mean - s.deviation).fold(f64::INFINITY, f64::min);
        let high = all.iter().map(|(_, s)| s.mean + s.deviation).fold(f64::NEG_INFINITY, f64::max);
        let most = all.iter().map(|(l, _)| *l).fold(1., f64::max);
        if !(low.is_finite() && high.is_finite()) {
            return Ok(());
        }
        let margin = 0.05 * (high - low).max(1e-6);
        let font = || ("sans-serif", 13).into_font().color(&INK);
        let mut chart = ChartBuilder::on(area)
            .margin(8)
            .margin_right(16)
            .caption(title, font())
            .x_label_area_size(34)
            .y_label_area_size(52)
            .build_cartesian_2d(0f64..most * 1.05, low - margin..high + margin)?;
        chart
            .configure_mesh()
            .x_desc("landmarks l")
            .label_style(font())
            .axis_desc_style(font())
            .bold_line_style(RULE)
            .light_line_style(WHITE)
            .axis_style(INK)
            .x_label_formatter(&|x| format!("{x:.0}"))
            .y_label_formatter(&|y| format!("{y:.2}"))
            .draw()?;
        for (k, sampling) in samplings.iter().enumerate() {
            let colour = COLOURS[k % COLOURS.len()];
            // Bars side by side instead of on top of each other.
            let shift = (k as f64 - (samplings.len() - 1) as f64 / 2.) * most * 0.004;
            let mut points: Vec<(f64, Spread)> = self
                .lines
                .iter()
                .filter(|line| line.sampling == *sampling)
                .filter_map(|line| Some((line.l as f64 + shift, value(line)?)))
                .collect();
            points.sort_by(|a, b| a.0.total_cmp(&b.0));
            let line = points.iter().map(|&(x, spread)| (x, spread.mean));
            chart.draw_series(LineSeries::new(line, colour.stroke_width(2)))?;
            chart.draw_series(points.iter().map(|&(x, s)| {
                ErrorBar::new_vertical(x, s.mean - s.deviation, s.mean, s.mean + s.deviation, colour.filled(), 5)
            }))?;
        }
        Ok(())
    }
}

/// The markers of Fig. 1 with their quadrants: agreement is the first and third.
///
/// # Errors
/// As [`comparison`].
pub fn scatter(path: &Path, pairs: &[Pair], title: &str) -> Result<()> {
    save(path, (520, 480), &Scatter { pairs, title })
}

struct Scatter<'a> {
    pairs: &'a [Pair],
    title: &'a str,
}

impl Drawing for Scatter<'_> {
    fn draw<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Drawn<B> {
        area.fill(&WHITE)?;
        let markers: Vec<(f64, f64)> = self.pairs.iter().map(|pair| pair.marker(|s| s.frobenius)).collect();
        let reach =
            |pick: fn(&(f64, f64)) -> f64| markers.iter().map(pick).fold(1e-9, |a, b: f64| b.abs().max(a)) * 1.08;
        let (x, y) = (reach(|m| m.0), reach(|m| m.1));
        let font = || ("sans-serif", 13).into_font().color(&INK);
        let mut chart = ChartBuilder::on(area)
            .margin(10)
            // Text of the built-in font cannot be turned, so the axis is named here.
            .caption(format!("upwards: Gamma, S2 - S1; {}", self.title), font())
            .x_label_area_size(36)
            .y_label_area_size(48)
            .build_cartesian_2d(-x..x, -y..y)?;
        chart
            .configure_mesh()
            .disable_mesh()
            .x_desc("Schur complement, Frobenius: S1 - S2")
            .label_style(font())
            .axis_desc_style(font())
            .axis_style(INK)
            .x_label_formatter(&|x| format!("{x:.1}"))
            .y_label_formatter(&|y| format!("{y:.1}"))
            .draw()?;
        chart.draw_series([
            PathElement::new(vec![(-x, 0.), (x, 0.)], INK),
            PathElement::new(vec![(0., -y), (0., y)], INK),
        ])?;
        chart.draw_series(markers.iter().map(|&marker| Circle::new(marker, 3, RED.filled())))?;
        area.present()
    }
}
