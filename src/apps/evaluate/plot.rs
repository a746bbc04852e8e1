//! Scores by category as a chart of bars, beside those of people: SVG or PNG.
//!
//! Text in a PNG is of a built-in bitmap font, so that a chart needs no font of the machine. Cost: milliseconds.

use super::Table;
use crate::apps::plots::canvas::{Drawing, Drawn, INK, save};
use crate::base::Result;
use plotters::coord::Shift;
use plotters::prelude::{Color, DrawingArea, DrawingBackend, IntoFont, PathElement, RGBColor, Rectangle, Text, WHITE};
use plotters::style::text_anchor::{HPos, Pos, VPos};
use std::path::Path;

const WIDTH: u32 = 800;
const LEFT: i32 = 120;
const RIGHT: i32 = 60;
const TOP: i32 = 50;
const LINE: i32 = 26;
const RULE: RGBColor = RGBColor(215, 215, 215);
const OURS: RGBColor = RGBColor(0, 114, 178);
const PEOPLE: RGBColor = RGBColor(230, 159, 0);

/// A category: ours and, where known, people's.
struct Bar<'a> {
    name: &'a str,
    ours: f64,
    people: Option<f64>,
}

/// Draws 1 − Rand by category to `path`, which ends in `.svg` or `.png`.
///
/// # Errors
/// [`crate::base::Error::Parameter`] for another ending, [`crate::base::Error::Unusable`] where the file cannot be drawn.
pub fn plot(path: &Path, table: &Table, people: &Table) -> Result<()> {
    let all = |table: &Table| -> Vec<(String, f64)> {
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
    save(path, size, &Chart { bars })
}

/// The chart.
struct Chart<'a> {
    bars: Vec<Bar<'a>>,
}

impl Drawing for Chart<'_> {
    fn draw<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Drawn<B> {
        let bars = &self.bars;
        let text = |h_pos| ("sans-serif", 14).into_font().color(&INK).pos(Pos { h_pos, v_pos: VPos::Center });
        let most = bars.iter().flat_map(|bar| [bar.ours, bar.people.unwrap_or(0.)]).fold(0.05, f64::max);
        let step = if most > 0.25 { 0.1 } else { 0.05 };
        let end = (most / step).ceil() * step;
        let x = |score: f64| LEFT + (score / end * f64::from(WIDTH as i32 - LEFT - RIGHT)).round() as i32;
        let bottom = TOP + LINE * bars.len() as i32;
        area.fill(&WHITE)?;
        for k in 0..=(end / step).round() as i32 {
            let score = f64::from(k) * step;
            area.draw(&PathElement::new(vec![(x(score), TOP), (x(score), bottom)], RULE))?;
            area.draw(&Text::new(format!("{score:.2}"), (x(score), bottom + 14), text(HPos::Center)))?;
        }
        area.draw(&Text::new("1 - Rand index, lower is better", (LEFT, 20), text(HPos::Left)))?;
        for (k, (name, colour)) in [("ours", OURS), ("people", PEOPLE)].into_iter().enumerate() {
            let at = WIDTH as i32 - RIGHT - 180 + 90 * k as i32;
            area.draw(&Rectangle::new([(at, 14), (at + 12, 26)], colour.filled()))?;
            area.draw(&Text::new(name, (at + 18, 20), text(HPos::Left)))?;
        }
        for (k, bar) in bars.iter().enumerate() {
            let y = TOP + LINE * k as i32;
            area.draw(&Text::new(bar.name, (LEFT - 8, y + LINE / 2), text(HPos::Right)))?;
            area.draw(&Rectangle::new([(LEFT, y + 4), (x(bar.ours), y + 13)], OURS.filled()))?;
            if let Some(score) = bar.people {
                area.draw(&Rectangle::new([(LEFT, y + 14), (x(score), y + 22)], PEOPLE.filled()))?;
            }
            area.draw(&Text::new(format!("{:.3}", bar.ours), (x(bar.ours) + 6, y + 9), text(HPos::Left)))?;
        }
        area.present()
    }
}
