//! The hierarchy of parts as a dendrogram, with the cut drawn in.
//!
//! A hierarchy has thousands of cells; people are interested in its last unions. Branches of less than a hundredth of
//! the surface are left out; branches that span several parts are expanded, and then the coarsest ones until there are
//! some thirty rows. The root is on the left; a union is drawn at the level up to which cuts make it, so that a
//! vertical line at a level crosses the parts of that cut. Branches within a part have its colour. O(cells) per branch.

use super::canvas::{Drawing, Drawn, INK, RULE, label, save};
use crate::base::Result;
use crate::base::union_find::Forest;
use crate::cluster::parts::{PartTree, TreeCut};
use plotters::coord::Shift;
use plotters::prelude::{Circle, Color, DrawingArea, DrawingBackend, PathElement, RGBColor, Rectangle, Text, WHITE};
use plotters::style::text_anchor::HPos;
use std::collections::BTreeMap;
use std::path::Path;

/// Number of rows that are filled even if there are fewer parts.
const ROWS: usize = 30;
/// Maximum number of rows.
const MOST: usize = 200;
/// Branches below this share of the surface are left out, unless parts are that small.
const LEAST: f64 = 0.01;

/// A branch: a set of cells made by some union, or a single cell.
#[derive(Clone, Debug, PartialEq)]
pub struct Branch {
    /// Level of the union of its two sides, 0 to 1; 1 for a cell.
    pub level: f64,
    /// Share of the surface.
    pub area: f64,
    /// Its row; between those of its children if it has any.
    pub row: f64,
    /// The part that it lies in, unless it spans several parts.
    pub part: Option<u32>,
    /// The two branches that it consists of, as indices into [`Dendrogram::branches`]; `None` if it is not expanded.
    pub children: Option<[usize; 2]>,
}

/// Branches for drawing.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Dendrogram {
    /// All of them, the root first, children after parents.
    pub branches: Vec<Branch>,
    /// Rows.
    pub rows: usize,
}

/// The tree as nodes: cells first, then unions in their order.
struct Nodes {
    children: Vec<Option<[usize; 2]>>,
    level: Vec<f64>,
    area: Vec<f64>,
}

impl Nodes {
    fn of(tree: &PartTree) -> Self {
        let n = tree.cells();
        let mut nodes = Self {
            children: vec![None; n],
            level: vec![1.; n],
            area: tree.area.iter().map(|&share| f64::from(share)).collect(),
        };
        // The node of each set of cells, indexed by the set's representative.
        let (mut sets, mut node): (_, Vec<usize>) = (Forest::new(n), (0..n).collect());
        for (&cells, &level) in tree.unions.iter().zip(&tree.level) {
            let [a, b] = cells.map(|cell| node[sets.find(cell) as usize]);
            sets.join(cells[0], cells[1]);
            node[sets.find(cells[0]) as usize] = nodes.area.len();
            nodes.children.push(Some([a, b]));
            nodes.level.push(f64::from(level).clamp(0., nodes.level[a].min(nodes.level[b])));
            nodes.area.push(nodes.area[a] + nodes.area[b]);
        }
        nodes
    }

    /// The first branch at or below `node` whose two sides both have at least `least`: its level and sides. If there is
    /// none, the level of `node`.
    fn forked(&self, node: usize, least: f64) -> (f64, Option<[usize; 2]>) {
        let mut at = node;
        while let Some([a, b]) = self.children[at] {
            let (small, large) = if self.area[a] < self.area[b] { (a, b) } else { (b, a) };
            if self.area[small] >= least {
                return (self.level[at], Some([large, small]));
            }
            at = large;
        }
        (self.level[node], None)
    }

    /// Shares of the surface below `node`, by part.
    fn shares(&self, node: usize, cut: &TreeCut) -> BTreeMap<u32, f64> {
        let (mut shares, mut open) = (BTreeMap::new(), vec![node]);
        while let Some(node) = open.pop() {
            match self.children[node] {
                Some(children) => open.extend(children),
                None => *shares.entry(cut.label[node]).or_insert(0.) += self.area[node],
            }
        }
        shares
    }

    /// The part that contains all of `node` except pieces below `least`.
    fn part(&self, node: usize, cut: &TreeCut, least: f64) -> Option<u32> {
        let shares = self.shares(node, cut);
        let (&part, _) = shares.iter().max_by(|a, b| a.1.total_cmp(b.1))?;
        shares.iter().all(|(other, share)| *other == part || *share < least).then_some(part)
    }
}

impl Dendrogram {
    /// Lays out the branches of `tree`, which must pass [`PartTree::check`], for its cut `cut`. O(S) per branch.
    pub fn of(tree: &PartTree, cut: &TreeCut) -> Self {
        let nodes = Nodes::of(tree);
        let mut parts = vec![0.; cut.parts];
        cut.label.iter().zip(&nodes.area).for_each(|(&part, area)| parts[part as usize] += area);
        // A requested number of parts may make them small.
        let least = parts.iter().fold(LEAST, |least, part| least.min(part / 2.));
        let mut plot = Self { branches: Vec::new(), rows: 1 };
        // The sides of branches that can be expanded.
        let mut sides = Vec::new();
        let add = |plot: &mut Self, sides: &mut Vec<Option<[usize; 2]>>, node: usize| {
            let (level, fork) = nodes.forked(node, least);
            let part = nodes.part(node, cut, least);
            sides.push(fork);
            plot.branches.push(Branch { level, area: nodes.area[node], row: 0., part, children: None });
        };
        add(&mut plot, &mut sides, nodes.area.len() - 1);
        while plot.rows < MOST {
            // Branches that span several parts first, then the coarsest.
            let urgent = |branch: usize| plot.branches[branch].part.is_none();
            let order = |&a: &usize, &b: &usize| {
                let level = |branch: usize| plot.branches[branch].level;
                urgent(a).cmp(&urgent(b)).then(level(b).total_cmp(&level(a))).then(b.cmp(&a))
            };
            let next = (0..sides.len()).filter(|&branch| sides[branch].is_some()).max_by(order);
            let Some(next) = next.filter(|&branch| plot.rows < ROWS || urgent(branch)) else { break };
            let first = plot.branches.len();
            sides[next].take().into_iter().flatten().for_each(|node| add(&mut plot, &mut sides, node));
            plot.branches[next].children = Some([first, first + 1]);
            plot.rows += 1;
        }
        plot.place();
        plot
    }

    /// Assigns a row to every branch.
    fn place(&mut self) {
        let (mut row, mut open) = (0., vec![0]);
        while let Some(branch) = open.pop() {
            match self.branches[branch].children {
                Some([a, b]) => open.extend([b, a]),
                None => {
                    self.branches[branch].row = row;
                    row += 1.;
                }
            }
        }
        // Children have greater indices than their parents.
        for branch in (0..self.branches.len()).rev() {
            if let Some([a, b]) = self.branches[branch].children {
                self.branches[branch].row = (self.branches[a].row + self.branches[b].row) / 2.;
            }
        }
    }
}

const WIDTH: u32 = 800;
const LEFT: i32 = 30;
const RIGHT: i32 = 150;
const TOP: i32 = 44;
const ROW: i32 = 18;
const ACROSS: RGBColor = RGBColor(130, 130, 130);

/// A dendrogram and its cut.
#[derive(Clone, Copy, Debug)]
pub struct TreePlot<'a> {
    /// A title.
    pub title: &'a str,
    /// The branches.
    pub plot: &'a Dendrogram,
    /// One colour per part; black beyond.
    pub colours: &'a [[u8; 3]],
    /// The level of the cut, if it is at a single level: not if a number of parts was requested.
    pub threshold: Option<f64>,
}

impl TreePlot<'_> {
    /// Draws to `path`, which ends in `.svg` or `.png`.
    ///
    /// # Errors
    /// [`crate::base::Error::Parameter`] for another extension, [`crate::base::Error::Unusable`] if it cannot be drawn,
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
        let bottom = TOP + ROW * self.plot.rows as i32 + 6;
        area.fill(&WHITE)?;
        area.draw(&Text::new(self.title.to_owned(), (LEFT, 20), label(HPos::Left)))?;
        for k in 0..=5 {
            let level = f64::from(k) / 5.;
            area.draw(&PathElement::new(vec![(x(level), TOP - 6), (x(level), bottom)], RULE))?;
            area.draw(&Text::new(format!("{level:.1}"), (x(level), bottom + 12), label(HPos::Center)))?;
        }
        let axis = "level up to which a cut unites: 0 one part, 1 single cells; small branches left out";
        area.draw(&Text::new(axis, (LEFT, bottom + 34), label(HPos::Left)))?;
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
                    area.draw(&Text::new(part, (left + 42, row), label(HPos::Right)))?;
                    let share = format!("{:.1} %", 100. * branch.area);
                    area.draw(&Text::new(share, (left + 116, row), label(HPos::Right)))?;
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cluster::parts::CellGraph;
    use crate::cluster::parts::hierarchy::CellUnion;

    /// Sixteen cells: neighbours joined in pairs, pairs in fours, and so on; the level decreases with each step.
    fn tree(area: Vec<f64>) -> PartTree {
        let pairs: Vec<[u32; 2]> = (1..16).map(|i| [i - 1, i]).collect();
        let cells = CellGraph { area, length: vec![1.; pairs.len()], pairs, ..CellGraph::default() };
        let unions = [1u32, 2, 4, 8].into_iter().zip([0.9, 0.7, 0.4, 0.1]).flat_map(|(step, level)| {
            (0..16 / (2 * step)).map(move |k| CellUnion { level, rank: level, a: 2 * k * step, b: (2 * k + 1) * step })
        });
        PartTree::new(&cells, unions, 0.)
    }

    #[test]
    fn every_part_is_a_branch_and_rows_are_counted() {
        let tree = tree(vec![1.; 16]);
        for k in 1..=16 {
            let plot = Dendrogram::of(&tree, &tree.cut_k(k).unwrap());
            assert_eq!(plot.rows, 16, "all cells of so small a tree");
            let leaves = plot.branches.iter().filter(|branch| branch.children.is_none());
            let mut rows: Vec<f64> = leaves.map(|branch| branch.row).collect();
            rows.sort_by(f64::total_cmp);
            assert_eq!(rows, (0..16).map(f64::from).collect::<Vec<_>>());
            // As many greatest branches within one part as there are parts.
            let across = plot.branches.iter().filter(|branch| branch.part.is_none());
            let sides = across.flat_map(|branch| branch.children.unwrap());
            assert_eq!(sides.filter(|&side| plot.branches[side].part.is_some()).count().max(1), k);
            assert!((plot.branches[0].area - 1.).abs() < 1e-6 && plot.branches[0].level == f64::from(0.1f32));
        }
    }

    #[test]
    fn branches_too_small_to_see_are_left_out() {
        // Of each pair, one cell is tiny.
        let tree = tree((0..16).map(|cell| if cell % 2 == 0 { 1. } else { 0.01 }).collect());
        let plot = Dendrogram::of(&tree, &tree.cut(0.5));
        assert_eq!(plot.rows, 8, "pairs");
        let leaves: Vec<&Branch> = plot.branches.iter().filter(|branch| branch.children.is_none()).collect();
        let whole: f64 = leaves.iter().map(|branch| branch.area).sum();
        assert!((whole - 1.).abs() < 1e-6, "tiny cells count where they lie");
        assert!(leaves.iter().all(|branch| branch.level == f64::from(0.9f32)), "{leaves:?}");
        let parts: Vec<_> = leaves.iter().map(|branch| branch.part.unwrap()).collect();
        assert_eq!(parts.len(), 8);
        assert_eq!(parts.iter().collect::<std::collections::BTreeSet<_>>().len(), 4);
    }

    #[test]
    fn one_cell_is_one_row() {
        let cells = CellGraph { area: vec![1.], ..CellGraph::default() };
        let tree = PartTree::new(&cells, [], 0.);
        let plot = Dendrogram::of(&tree, &tree.cut(0.5));
        assert_eq!((plot.rows, plot.branches[0].part), (1, Some(0)));
    }
}
