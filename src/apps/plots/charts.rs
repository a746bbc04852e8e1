//! Charts of scores and of the study: bars by category beside those of people, lines with error bars (the paper's Fig.
//! 5), a scatter plot with quadrants (Fig. 1).

use super::canvas::{Drawing, Drawn, INK, font, label, save, style_axes};
use crate::apps::evaluate::ScoreTable;
use crate::apps::study::points::SamplePair;
use crate::apps::study::summary::{SamplingSummary, Spread};
use crate::base::Result;
use crate::base::sort::sort_by;
use crate::landmarks::Sampling;
use plotters::coord::Shift;
use plotters::prelude::{
    ChartBuilder, Circle, Color, DrawingArea, DrawingBackend, ErrorBar, LineSeries, PathElement, RGBColor, Rectangle,
    Text, WHITE,
};
use plotters::style::text_anchor::HPos;
use std::path::Path;

const WIDTH: u32 = 800;
const LEFT: i32 = 120;
const RIGHT: i32 = 60;
const TOP: i32 = 50;
const LINE: i32 = 26;
const BAR_RULE: RGBColor = RGBColor(215, 215, 215);
const OURS: RGBColor = RGBColor(0, 114, 178);
const PEOPLE: RGBColor = RGBColor(230, 159, 0);

/// A category: our score and, if known, people's.
struct Bar<'a> {
    name: &'a str,
    ours: f64,
    people: Option<f64>,
}

/// Draws 1 − Rand by category to `path`, which ends in `.svg` or `.png`.
///
/// # Errors
/// [`crate::base::Error::Parameter`] for another extension, [`crate::base::Error::Unusable`] if the file cannot be
/// drawn.
pub fn scores_by_category(path: &Path, table: &ScoreTable, people: &ScoreTable) -> Result<()> {
    let all = |table: &ScoreTable| -> Vec<(String, f64)> {
        let rows = table.categories.iter().chain(&table.overall);
        rows.map(|row| (row.name.clone(), row.scores.rand)).collect()
    };
    let (ours, people) = (all(table), all(people));
    let bars: Vec<Bar> = ours
        .iter()
        .map(|(name, ours)| Bar {
            name,
            ours: *ours,
            people: people.iter().find(|(other, _)| other == name).map(|(_, score)| *score),
        })
        .collect();
    let size = (WIDTH, (TOP + LINE * bars.len() as i32 + 40) as u32);
    save(path, size, &CategoryBars { bars })
}

/// The chart.
struct CategoryBars<'a> {
    bars: Vec<Bar<'a>>,
}

impl Drawing for CategoryBars<'_> {
    fn draw<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Drawn<B> {
        let bars = &self.bars;
        let most = bars.iter().flat_map(|bar| [bar.ours, bar.people.unwrap_or(0.)]).fold(0.05, f64::max);
        let step = if most > 0.25 { 0.1 } else { 0.05 };
        let end = (most / step).ceil() * step;
        let x = |score: f64| LEFT + (score / end * f64::from(WIDTH as i32 - LEFT - RIGHT)).round() as i32;
        let bottom = TOP + LINE * bars.len() as i32;
        area.fill(&WHITE)?;
        for k in 0..=(end / step).round() as i32 {
            let score = f64::from(k) * step;
            area.draw(&PathElement::new(vec![(x(score), TOP), (x(score), bottom)], BAR_RULE))?;
            area.draw(&Text::new(format!("{score:.2}"), (x(score), bottom + 14), label(HPos::Center)))?;
        }
        area.draw(&Text::new("1 - Rand index, lower is better", (LEFT, 20), label(HPos::Left)))?;
        for (k, (name, colour)) in [("ours", OURS), ("people", PEOPLE)].into_iter().enumerate() {
            let at = WIDTH as i32 - RIGHT - 180 + 90 * k as i32;
            area.draw(&Rectangle::new([(at, 14), (at + 12, 26)], colour.filled()))?;
            area.draw(&Text::new(name, (at + 18, 20), label(HPos::Left)))?;
        }
        for (k, bar) in bars.iter().enumerate() {
            let y = TOP + LINE * k as i32;
            area.draw(&Text::new(bar.name, (LEFT - 8, y + LINE / 2), label(HPos::Right)))?;
            area.draw(&Rectangle::new([(LEFT, y + 4), (x(bar.ours), y + 13)], OURS.filled()))?;
            if let Some(score) = bar.people {
                area.draw(&Rectangle::new([(LEFT, y + 14), (x(score), y + 22)], PEOPLE.filled()))?;
            }
            area.draw(&Text::new(format!("{:.3}", bar.ours), (x(bar.ours) + 6, y + 9), label(HPos::Left)))?;
        }
        area.present()
    }
}

const RED: RGBColor = RGBColor(204, 51, 51);
/// Colours that everyone can distinguish (after Okabe and Ito).
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

/// Γ/n and the held-out residual over the number of landmarks, one line per sampling, bars of one standard deviation.
///
/// # Errors
/// [`crate::base::Error::Parameter`] for another extension, [`crate::base::Error::Unusable`] if the file cannot be
/// drawn.
pub fn comparison(path: &Path, lines: &[SamplingSummary], title: &str) -> Result<()> {
    save(path, (960, 440), &Comparison { lines, title })
}

struct Comparison<'a> {
    lines: &'a [SamplingSummary],
    title: &'a str,
}

/// A panel: its title, and the value of a line.
type Panel = (&'static str, fn(&SamplingSummary) -> Option<Spread>);

impl Drawing for Comparison<'_> {
    fn draw<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Drawn<B> {
        area.fill(&WHITE)?;
        area.draw(&Text::new(self.title.to_owned(), (16, 12), font(14)))?;
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
            let name = sampling.to_string();
            let width = 44 + 8 * name.len() as i32;
            legend.draw(&Text::new(name, (x + 24, 14), font(14)))?;
            x += width;
        }
        area.present()
    }
}

impl Comparison<'_> {
    fn panel<B: DrawingBackend>(
        &self,
        area: &DrawingArea<B, Shift>,
        title: &str,
        value: fn(&SamplingSummary) -> Option<Spread>,
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
        let mut chart = ChartBuilder::on(area)
            .margin(8)
            .margin_right(16)
            .caption(title, font(13))
            .x_label_area_size(34)
            .y_label_area_size(52)
            .build_cartesian_2d(0f64..most * 1.05, low - margin..high + margin)?;
        let mut axes = chart.configure_mesh();
        style_axes(&mut axes, 13);
        axes.x_desc("landmarks l")
            .x_label_formatter(&|x| format!("{x:.0}"))
            .y_label_formatter(&|y| format!("{y:.2}"))
            .draw()?;
        for (k, sampling) in samplings.iter().enumerate() {
            let colour = COLOURS[k % COLOURS.len()];
            // Error bars beside each other instead of on top of each other.
            let shift = (k as f64 - (samplings.len() - 1) as f64 / 2.) * most * 0.004;
            let mut points: Vec<(f64, Spread)> = self
                .lines
                .iter()
                .filter(|line| line.sampling == *sampling)
                .filter_map(|line| Some((line.l as f64 + shift, value(line)?)))
                .collect();
            sort_by(&mut points, |a, b| a.0.total_cmp(&b.0));
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
pub fn scatter(path: &Path, pairs: &[SamplePair], title: &str) -> Result<()> {
    save(path, (520, 480), &Scatter { pairs, title })
}

struct Scatter<'a> {
    pairs: &'a [SamplePair],
    title: &'a str,
}

impl Drawing for Scatter<'_> {
    fn draw<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Drawn<B> {
        area.fill(&WHITE)?;
        let markers: Vec<(f64, f64)> = self.pairs.iter().map(|pair| pair.marker(|s| s.frobenius)).collect();
        let reach =
            |pick: fn(&(f64, f64)) -> f64| markers.iter().map(pick).fold(1e-9, |a, b: f64| b.abs().max(a)) * 1.08;
        let (x, y) = (reach(|m| m.0), reach(|m| m.1));
        let mut chart = ChartBuilder::on(area)
            .margin(10)
            // Text in a PNG cannot be rotated, so the axis is named here.
            .caption(format!("upwards: Gamma, S2 - S1; {}", self.title), font(13))
            .x_label_area_size(36)
            .y_label_area_size(48)
            .build_cartesian_2d(-x..x, -y..y)?;
        let mut axes = chart.configure_mesh();
        style_axes(&mut axes, 13);
        axes.disable_mesh()
            .x_desc("Schur complement, Frobenius: S1 - S2")
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
