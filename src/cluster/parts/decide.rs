//! The decision: which cells belong together, and with what certainty.
//!
//! The default recipe: layers of what the surface encloses, an ensemble for each, the co-association, symmetrised where
//! there is a left and a right side, and over similar limbs, with slender limbs cut off, and the hierarchy of the
//! greatest expected Rand index.
//!
//! It works on some two thousand cells whatever the mesh: tenths of a second, and less than 40 MB outside the budget.
//! Meshes of thousands of pieces and very noisy ones take more (docs/limits.md).

use super::ambiguous::without_ambiguous;
use super::answer::PartDecision;
use super::arbitrary_cuts::without_arbitrary;
use super::cell_graph::CellGraph;
use super::cell_labels::{class_sums, intersect, majorities};
use super::ensemble::Superfaces;
use super::interior::enclosed::Layers;
use super::interior::layered::{self, CoAssociation};
use super::matrix::Square;
use super::recesses::without_recesses;
use super::repeated_places::Repetition;
use super::slender_limbs::{cut_off, slender_limbs, uncut_limbs};
use super::symmetry::both_sides::Sides;
use super::symmetry::cell_map::Surface;
use super::symmetry::limbs::{LimbRegion, Limbs};
use super::symmetry::mirror_images::{CellImages, LEAST_LIKENESS, cell_points, divided, mirror_images, symmetrised};
use super::symmetry::reflection::reflection;
use super::symmetry::rotations::rotations;
use super::symmetry::turned_parts::Turns;
use super::{Decision, PartsParams, consensus, labelling};
use crate::base::{Error, Result};
use crate::cluster::mirror::{NearestPoint, PointSet};
use crate::spectral::anchor::LandmarkDistances;
use crate::store::run::Run;

/// Decides on the parts of a surface of S cells, given the mean distances of its cells from `l` landmarks: `rows`,
/// row-major l × S, infinite if not reached. Returns a decision with all answers at once, and the seconds that it took:
/// the number of parts and the detail in `params` are ignored. [`super::PartTree::cut_for`] extracts one of the
/// answers.
///
/// ```
/// use nystrom_stream::cluster::parts::{CellGraph, PartsParams, decide};
/// use nystrom_stream::store::Run;
///
/// # fn main() -> nystrom_stream::base::Result<()> {
/// // A strip of 24 cells that turns upwards at a crease in the middle, and their distances from every fourth.
/// let step = |i: u32| if i == 12 { 2. } else { 0.2 };
/// let along = |i: u32| 0.2 * f64::from(i) - 2.3;
/// let cells = CellGraph {
///     seed: (0..24).collect(),
///     area: vec![1. / 24.; 24],
///     centre: (0..24).map(|i| [along(i).min(0.), 0., along(i).max(0.)]).collect(),
///     normal: (0..24).map(|i| if i < 12 { [0., 0., 1.] } else { [-1., 0., 0.] }).collect(),
///     pairs: (1..24).map(|i| [i - 1, i]).collect(),
///     length: vec![0.2; 23],
///     concave: (1..24).map(|i| step(i) - 0.2).collect(),
///     convex: vec![0.; 23],
///     convex04: vec![0.; 23],
///     ..CellGraph::default()
/// };
/// let distance = |a: u32, b: u32| (a.min(b) + 1..=a.max(b)).map(step).sum::<f64>();
/// let rows: Vec<f64> = (0..6).flat_map(|k| (0..24).map(move |i| distance(4 * k, i))).collect();
/// let (found, _) = decide(&cells, &rows, 6, &PartsParams::default(), &Run::new(&()))?;
/// // The hierarchy has all answers: this is the one with two parts.
/// let two = found.tree.cut_k(2)?;
/// assert_eq!(two.label, [vec![0; 12], vec![1; 12]].concat());
/// # Ok(())
/// # }
/// ```
///
/// # Errors
/// Sizes that disagree, no cell, no row, options out of range, or cancellation.
pub fn decide(
    cells: &CellGraph,
    rows: &[f64],
    l: usize,
    params: &PartsParams,
    run: &Run,
) -> Result<(PartDecision, f64)> {
    let (cells, rows) = checked(cells, rows, l, params)?;
    let work = || -> Result<PartDecision> {
        match params.decision {
            Decision::SoftTrees => {
                let Some(layers) = Layers::of(&cells, run)? else {
                    let found = layered::co_association(&cells, rows, params.ensemble_size, run)?;
                    return decide_symmetric(&cells, found, params.small_part, run);
                };
                let found = layered::of_layers(&cells, &rows, &layers, params.ensemble_size, run)?;
                let decided = decide_symmetric(&cells, found, params.small_part, run)?;
                let (enclosed, is_wall) = (layers.enclosed(&cells.area_shares()), layers.walls());
                Ok(PartDecision { enclosed, is_wall, ..decided })
            }
            Decision::Consensus => consensus::consensus(&cells, &rows, params.small_part, run),
            Decision::Single => consensus::single_run(&cells, &rows, params.small_part, run),
        }
    };
    let segmentations = match params.decision {
        Decision::SoftTrees => params.ensemble_size,
        Decision::Consensus => consensus::ENSEMBLE,
        Decision::Single => 1,
    };
    run.stage("parts", "segmentations", segmentations as u64, work)
}

/// The decision on the superfaces in `found`, symmetrised over rotations, over both sides, if there are two, and over
/// similar limbs, with slender limbs cut off.
fn decide_symmetric(cells: &CellGraph, found: CoAssociation, small_part: f64, run: &Run) -> Result<PartDecision> {
    let CoAssociation { superfaces, log_thickness, c, encloses } = found;
    let shares = cells.area_shares();
    let surface = Surface::new(cells, &shares, &log_thickness);
    let limbs = surface.as_ref().map(Limbs::of);
    let (slender, limbs) =
        limbs.map(|limbs| (slender_limbs(limbs.regions(&shares)), limbs.maps(&shares))).unwrap_or_default();
    let points = cell_points(cells);
    let nearest = NearestPoint::new(PointSet::new(&points, &shares, cells.total_area()));
    let turns = rotations(&nearest);
    let planes = mirror_images(&nearest);
    let has_plane = planes.first().is_some_and(|best| best.likeness(&shares) >= LEAST_LIKENESS);
    let posed = match &surface {
        Some(surface) if !has_plane && turns.is_empty() => reflection(surface, run)?,
        _ => None,
    };
    // The best plane comes last, or the reflection, so that its symmetry is exact.
    let sides: Vec<&CellImages> = planes.iter().rev().chain(&posed).collect();
    let nearest = &nearest;
    let (shares, limbs, turns, sides) = (&shares, &limbs, &turns, &sides);
    let deciding = Deciding { cells, shares, nearest, limbs, turns, sides, encloses, small_part, run };
    if slender.is_empty() && turns.is_empty() && posed.is_none() {
        let (alike, label) = deciding.labels(&superfaces, c)?;
        return deciding.decision(superfaces, alike, &label);
    }
    // From here on C is needed as it was before it was averaged.
    let (mut superfaces, mut c) = (superfaces, c);
    let (mut alike, mut label) = deciding.labels(&superfaces, c.clone())?;
    if let Some(finer) = deciding.with_limbs_cut_off(&superfaces, &c, &label, &slender)? {
        (superfaces, c) = finer;
        (alike, label) = deciding.labels(&superfaces, c.clone())?;
    }
    if turns.is_empty() && posed.is_none() {
        return deciding.decision(superfaces, alike, &label);
    }
    let Some(images) = &posed else { return deciding.turned(superfaces, &c, alike, &label) };
    // Superfaces need not end at the image of a cut on the other side; the parts show where they must.
    let decided = deciding.decision(superfaces, alike, &label)?;
    let parts = decided.tree.cut_detail(0.0);
    let of_cell = &decided.superfaces.of_cell;
    let (of_piece, count) = images.cut_at_images(cells, shares, of_cell, &parts.label);
    if count == decided.superfaces.len() {
        return Ok(decided);
    }
    let (finer, c) = deciding.finer(of_cell, of_piece, count, &c)?;
    // Adding a missing image makes one more part; slivers from inaccurate images make several.
    let (alike, label) = deciding.labels(&finer, c)?;
    let cut = deciding.decision(finer, alike, &label)?;
    Ok(if cut.tree.cut_detail(0.0).parts > parts.parts + 1 { decided } else { cut })
}

/// A surface, what maps it onto itself, and how to decide on it.
struct Deciding<'a> {
    cells: &'a CellGraph,
    shares: &'a [f64],
    /// A search for the nearest cells.
    nearest: &'a NearestPoint<'a>,
    /// Maps of similar limbs, group by group.
    limbs: &'a [Vec<CellImages>],
    /// Rotations.
    turns: &'a [CellImages],
    /// Maps of left and right, the best last.
    sides: &'a [&'a CellImages],
    /// Whether the surface encloses something.
    encloses: bool,
    small_part: f64,
    run: &'a Run<'a>,
}

impl Deciding<'_> {
    /// The co-association averaged over all maps.
    fn averaged(&self, superfaces: &Superfaces, c: Square) -> Square {
        let limbs = self.limbs.iter().map(Vec::as_slice);
        let maps = limbs.chain([self.turns]).chain(self.sides.iter().map(|side| std::slice::from_ref(*side)));
        let some = maps.filter(|maps| !maps.is_empty());
        some.fold(c, |c, maps| symmetrised(&c, &superfaces.of_cell, self.shares, maps))
    }

    /// The superfaces divided at slender `limbs` that no part of `label` (R) ends at, and their co-association, `c`
    /// before; `None` without such limbs.
    fn with_limbs_cut_off(
        &self,
        superfaces: &Superfaces,
        c: &Square,
        label: &[u32],
        limbs: &[LimbRegion],
    ) -> Result<Option<(Superfaces, Square)>> {
        let of_cell = &superfaces.of_cell;
        let parts = superfaces.cell_labels(label);
        let Some(limb) = uncut_limbs(self.cells, limbs, self.shares, &parts) else { return Ok(None) };
        let (of_piece, count) = intersect(of_cell, &limb);
        let (finer, mut c) = self.finer(of_cell, of_piece, count, c)?;
        cut_off(&mut c, &finer.labels(&limb));
        Ok(Some((finer, c)))
    }

    fn two_sides(&self, superfaces: &Superfaces) -> Option<Sides> {
        self.sides.last().map(|map| Sides::new(superfaces, self.shares, map))
    }

    /// The averaged co-association, and the labels of superfaces, both sides alike, without ambiguous patches,
    /// arbitrary cuts, cuts at repeated places and floors of recesses.
    fn labels(&self, superfaces: &Superfaces, c: Square) -> Result<(Square, Vec<u32>)> {
        let alike = self.averaged(superfaces, c);
        let mut best = labelling::best_labelling(&superfaces.area, &alike);
        let two = self.two_sides(superfaces);
        if let Some(two) = &two {
            best = two.cut_alike(&best, &alike);
        }
        let label = without_ambiguous(self.cells, superfaces, &alike, two.as_ref(), &best);
        let label = without_arbitrary(self.cells, superfaces, &alike, &label);
        let (cells, nearest, run) = (self.cells, self.nearest, self.run);
        let repetition = Repetition { cells, nearest, superfaces, co_association: &alike, run };
        let label = repetition.without_repeated(&label)?;
        let label = if self.encloses { label } else { without_recesses(self.cells, superfaces, &label) };
        Ok((alike, label))
    }

    fn decision(&self, superfaces: Superfaces, alike: Square, label: &[u32]) -> Result<PartDecision> {
        let two = self.two_sides(&superfaces);
        let (two, small, run) = (two.as_ref(), self.small_part, self.run);
        let tree = labelling::soft_hierarchy(self.cells, &superfaces, &alike, label, two, small, run)?;
        Ok(PartDecision::of(superfaces, alike, tree))
    }

    /// The decision with the parts `label` (R) made equal under rotations; `c` is the co-association before it was
    /// averaged.
    fn turned(&self, superfaces: Superfaces, c: &Square, alike: Square, label: &[u32]) -> Result<PartDecision> {
        let of_cell = &superfaces.of_cell;
        let before = superfaces.cell_labels(label);
        let turned = Turns { cells: self.cells, shares: self.shares, maps: self.turns }.alike(&before);
        let (of_piece, count) = divided(of_cell, &turned, self.shares);
        let label = majorities(&of_piece, count, &turned, self.shares);
        if count == superfaces.len() {
            return self.decision(superfaces, alike, &label);
        }
        let (finer, c) = self.finer(of_cell, of_piece, count, c)?;
        let alike = self.averaged(&finer, c);
        self.decision(finer, alike, &label)
    }

    /// The `count` superfaces `of_piece` (S) into which the superfaces `of_cell` (S) are divided, and their
    /// co-association.
    fn finer(&self, of_cell: &[u32], of_piece: Vec<u32>, count: usize, c: &Square) -> Result<(Superfaces, Square)> {
        let area = class_sums(&of_piece, &self.cells.area, count);
        let finer = Superfaces::kept(of_piece, area).ok_or_else(|| Error::internal("a superface without cells"))?;
        let whole = finer.labels(of_cell);
        let row = |&x: &u32| whole.iter().map(|&y| c[(x as usize, y as usize)]).collect::<Vec<f64>>();
        let c = Square::from_values(count, whole.iter().flat_map(row).collect());
        Ok((finer, c))
    }
}

/// Validates the input and makes it safe to compute with.
fn checked(cells: &CellGraph, rows: &[f64], l: usize, params: &PartsParams) -> Result<(CellGraph, LandmarkDistances)> {
    let cells = cells.cleaned()?;
    let n = cells.len();
    if n == 0 || l == 0 || l.checked_mul(n) != Some(rows.len()) {
        let problem = format!("{} distances are not {l} rows of {n} cells", rows.len());
        return Err(Error::parameter("rows", problem, "pass at least one row and one cell, with all rows complete"));
    }
    params.check()?;
    let rows = LandmarkDistances::new(rows, l, n);
    Ok((cells, rows))
}
