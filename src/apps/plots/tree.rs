//! The hierarchy of parts as a dendrogram, with the cut drawn in.
//!
//! The root is at the left; a union stands at the level up to which cuts make it, so that a vertical line at a level
//! crosses the parts of that cut. Branches within a part have its colour.

use super::canvas::{Drawing, Drawn, INK, RULE, save};
use super::dendrogram::{Branch, Dendrogram};
use crate::base::Result;
use plotters::coord::Shift;
use plotters::prelude::{
    Circle, Color, DrawingArea, DrawingBackend, IntoFont, PathElement, RGBColor, Rectangle, Text, WHITE,
};
use plotters::style::text_anchor::{HPos, Pos, VPos};
use std::path::Path;

const WIDTH: u32 = 800;
const LEFT: i32 = 30;
const RIGHT: i32 = 150;
const TOP: i32 = 44;
const ROW: i32 = 18;
const ACROSS: RGBColor = RGBColor(130, 130, 130);

/// A dendrogram and its cut.
#[derive(Clone, Copy, Debug)]
pub struct TreePlot<'a> {
    /// A title; what the built-in font of PNGs lacks stays blank there.
    pub title: &'a str,
    /// The branches.
    pub plot: &'a Dendrogram,
    /// A colour a part; black beyond.
    pub colours: &'a [[u8; 3]],
    /// The level of the cut, where it is at one level: not where a number of parts was asked for.
    pub threshold: Option<f64>,
}

impl TreePlot<'_> {
    /// Draws to `path`, which ends in `.svg` or `.png`.
    ///
    /// # Errors
    /// [`crate::base::Error::Parameter`] for another ending, [`crate::base::Error::Unusable`] where it cannot be drawn,
    /// [`crate::base::Error::Io`].
    pub fn plot(&self, path: &Path) -> Result<()> {
        save(path, (WIDTH, (TOP + ROW * self.plot.rows as i32 + 56) as u32), self)
    }

    fn colour(&self, branch: &Branch) -> RGBColor {
        let part = branch.part.map(|part| self.colours.get(part as usize).copied().unwrap_or_default());
        part.map_or(ACROSS, |[red, green, blue]| RGBColor(red, green, blue))
    }
}

fn x(level: f64) -> i32 {
    LEFT + (level * f64::from(WIDTH as i32 - LEFT - RIGHT)).round() as i32
}

fn y(row: f64) -> i32 {
    TOP + (f64::from(ROW) * (row + 0.5)).round() as i32
}

impl Drawing for TreePlot<'_> {
    fn draw<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Drawn<B> {
        let text = |h_pos| ("sans-serif", 14).into_font().color(&INK).pos(Pos { h_pos, v_pos: VPos::Center });
        let bottom = TOP + ROW * self.plot.rows as i32 + 6;
        area.fill(&WHITE)?;
        area.draw(&Text::new(self.title.to_owned(), (LEFT, 20), text(HPos::Left)))?;
        for k in 0..=5 {
            let level = f64::from(k) / 5.;
            area.draw(&PathElement::new(vec![(x(level), TOP - 6), (x(level), bottom)], RULE))?;
            area.draw(&Text::new(format!("{level:.1}"), (x(level), bottom + 12), text(HPos::Center)))?;
        }
        let axis = "level up to which a cut unites: 0 one part, 1 single cells; small branches left out";
        area.draw(&Text::new(axis, (LEFT, bottom + 34), text(HPos::Left)))?;
        for branch in &self.plot.branches {
            let style = |branch: &Branch| match branch.part {
                Some(_) => self.colour(branch).stroke_width(4),
                None => ACROSS.stroke_width(2),
            };
            let at = x(branch.level);
            match branch.children {
                Some(children) => {
                    let children = children.map(|child| &self.plot.branches[child]);
                    let rows = children.map(|child| y(child.row));
                    for (child, row) in children.into_iter().zip(rows) {
                        area.draw(&PathElement::new(vec![(at, row), (x(child.level), row)], style(child)))?;
                    }
                    area.draw(&PathElement::new(rows.map(|row| (at, row)).to_vec(), style(branch)))?;
                }
                None => {
                    let row = y(branch.row);
                    let line = vec![(at, row), (x(1.), row)];
                    area.draw(&PathElement::new(line, self.colour(branch).stroke_width(1)))?;
                    area.draw(&Circle::new((at, row), 3, self.colour(branch).filled()))?;
                    let left = x(1.) + 12;
                    let chip = Rectangle::new([(left, row - 6), (left + 12, row + 6)], self.colour(branch).filled());
                    area.draw(&chip)?;
                    area.draw(&Rectangle::new([(left, row - 6), (left + 12, row + 6)], ACROSS))?;
                    let part = branch.part.map_or(String::from("-"), |part| part.to_string());
                    area.draw(&Text::new(part, (left + 42, row), text(HPos::Right)))?;
                    let share = format!("{:.1} %", 100. * branch.area);
                    area.draw(&Text::new(share, (left + 116, row), text(HPos::Right)))?;
                }
            }
        }
        if let Some(level) = self.threshold {
            for top in (TOP - 6..bottom).step_by(10) {
                area.draw(&PathElement::new(vec![(x(level), top), (x(level), (top + 5).min(bottom))], INK))?;
            }
        }
        area.present()
    }
}
