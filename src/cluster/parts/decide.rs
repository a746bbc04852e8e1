//! The decision: which cells belong together, and with what certainty.
//!
//! The default recipe: layers of what the surface encloses, an ensemble for each, the co-association, symmetrised where
//! there is a left and a right side, and over similar limbs, and the hierarchy of the greatest expected Rand index.
//!
//! It works on some two thousand cells whatever the mesh: tenths of a second, and up to 40 MB outside the budget.

use super::answer::PartDecision;
use super::cell_graph::{CellGraph, class_sums};
use super::ensemble::Superfaces;
use super::interior::enclosed::Layers;
use super::interior::layered::{self, CoAssociation};
use super::matrix::Square;
use super::symmetry::both_sides::Sides;
use super::symmetry::cell_map::Surface;
use super::symmetry::limbs::limb_maps;
use super::symmetry::mirror_images::{LEAST_LIKENESS, MirrorImages, mirror_images, symmetrised};
use super::symmetry::reflection::reflection;
use super::{Decision, PartsParams, consensus, labelling};
use crate::base::{Error, Result};
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

/// The decision on the superfaces in `found`, symmetrised over both sides, if there are two, and over similar limbs.
fn decide_symmetric(cells: &CellGraph, found: CoAssociation, small_part: f64, run: &Run) -> Result<PartDecision> {
    let CoAssociation { superfaces, log_thickness, c } = found;
    let shares = cells.area_shares();
    let surface = Surface::new(cells, &shares, &log_thickness);
    let limbs = surface.as_ref().map_or_else(Vec::new, limb_maps);
    let planes = mirror_images(cells, &shares);
    let has_plane = planes.first().is_some_and(|best| best.likeness(&shares) >= LEAST_LIKENESS);
    let posed = match &surface {
        Some(surface) if !has_plane => reflection(surface, run)?,
        _ => None,
    };
    // The best plane comes last, or the reflection, so that its symmetry is exact.
    let sides: Vec<&MirrorImages> = planes.iter().rev().chain(&posed).collect();
    let decided = |superfaces: Superfaces, c: Square| -> Result<PartDecision> {
        let maps = limbs.iter().map(Vec::as_slice).chain(sides.iter().map(|side| std::slice::from_ref(*side)));
        let alike = maps.fold(c, |c, maps| symmetrised(&c, &superfaces.of_cell, &shares, maps));
        let mut best = labelling::best_labelling(&superfaces.area, &alike);
        let two = sides.last().map(|map| Sides::new(&superfaces, &shares, map));
        if let Some(two) = &two {
            best = two.cut_alike(&best, &alike);
        }
        let tree = labelling::soft_hierarchy(cells, &superfaces, &alike, &best, two.as_ref(), small_part, run)?;
        Ok(PartDecision::of(superfaces, alike, tree))
    };
    let Some(images) = &posed else { return decided(superfaces, c) };
    let uncut = decided(superfaces, c.clone())?;
    // Superfaces need not end at the image of a cut on the other side; the parts show where they must.
    let parts = uncut.tree.cut_detail(0.0);
    let of_cell = &uncut.superfaces.of_cell;
    let (of_piece, count) = images.cut_at_images(cells, &shares, of_cell, &parts.label);
    if count == uncut.superfaces.len() {
        return Ok(uncut);
    }
    let area = class_sums(&of_piece, &cells.area, count);
    let finer = Superfaces::kept(of_piece, area).ok_or_else(|| Error::internal("a superface without cells"))?;
    let whole = finer.labels(of_cell);
    let row = |&x: &u32| whole.iter().map(|&y| c[(x as usize, y as usize)]).collect::<Vec<f64>>();
    let c = Square::from_values(count, whole.iter().flat_map(row).collect());
    // Adding a missing image makes one more part; slivers from inaccurate images make several.
    let cut = decided(finer, c)?;
    Ok(if cut.tree.cut_detail(0.0).parts > parts.parts + 1 { uncut } else { cut })
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
