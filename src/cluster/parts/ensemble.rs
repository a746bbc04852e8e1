//! The ensemble: over-segmentations of the cells, each from a random subset of the landmarks, and their combination.
//!
//! One over-segmentation consists of an anchor embedding, K-means, connected pieces, and islands joined to their
//! neighbours. The intersections of all of them are the superfaces, a few hundred. Each over-segmentation is merged
//! down to one part ([`super::merges`]), which gives a probability for any two superfaces; that at the mean of their
//! log odds is the co-association, R × R. A single run would depend on the randomness of its K-means; twelve agree far
//! better with people.
//!
//! Cost: constant in the size of the mesh; 8 R² bytes.

use super::cell_graph::CellGraph;
use super::cell_kmeans::CellKMeans;
use super::cell_labels::{class_sums, connected_pieces, intersect, join_small};
use super::convexity::{PairSums, WIDTHS, convexity};
use super::folding::log_folding;
use super::inflation::Inflated;
use super::matrix::Square;
use super::merges::{EnsembleMean, MergeModel, meeting_probability, merges};
use super::region_pieces::RegionPieces;
use super::regions::{CellMoments, EMBEDDING_DIMENSIONS, RegionLabels, Regions, cell_moments, region_bytes};
use super::shortcuts::with_shortcuts;
use super::thickness::log_thickness;
use crate::base::Result;
use crate::base::parallel::chunk_range;
use crate::base::random::{Random, below, splitmix_step, stream};
use crate::spectral::anchor::{AnchorEmbedding, LandmarkDistances, anchor_embedding};
use crate::store::run::Run;
use rand_xoshiro::rand_core::Rng;
use std::borrow::Cow;

/// Kernel width, relative to the mean distance, of the embedding whose means are used to compare regions.
pub const COMPARE_SCALE: f64 = 0.2;
/// Superfaces per chunk when averaging over the ensemble.
const SUPERFACES_PER_CHUNK: usize = 32;

/// One over-segmentation of the cells.
#[derive(Clone, Debug, PartialEq)]
pub struct OverSegmentation {
    /// Region of each cell (S), numbered 0, 1, ….
    pub region: Vec<u32>,
    /// Number of regions.
    pub regions: usize,
    /// Its pair width, as an index into [`WIDTHS`].
    pub width: usize,
}

impl OverSegmentation {
    /// Computes one with `params`; random choices come from the stream named `purpose`.
    pub fn new(
        cells: &CellGraph,
        rows: &LandmarkDistances,
        params: &OverSegmentationParams,
        width: usize,
        seed: u64,
        purpose: &str,
    ) -> OverSegmentation {
        let (region, regions) = over_segment(cells, rows, params, &mut stream(seed, purpose));
        OverSegmentation { region, regions, width }
    }
}

/// Bytes that a thread allocates for one over-segmentation of `cells` cells (measured): affinities with `landmarks`
/// landmarks, the arrays computed from them, and matrices among the landmarks.
pub fn member_bytes(landmarks: usize, cells: usize) -> u64 {
    let (l, cells) = (landmarks as u64, cells as u64);
    16 * l * cells + 24 * l * l
}

/// Bytes that deciding on parts allocates for `landmarks` landmarks and two thousand cells on one thread (measured).
pub fn decision_bytes(landmarks: u64) -> u64 {
    (10 << 20) + 44_000 * landmarks + 36 * landmarks * landmarks
}

/// `count` random over-segmentations, each from its own stream, on as many threads as the budget has room for
/// ([`member_bytes`]).
///
/// # Errors
/// Cancellation.
pub fn draw_ensemble(
    cells: &CellGraph,
    rows: &LandmarkDistances,
    count: usize,
    purpose: &str,
    run: &Run,
) -> Result<Vec<OverSegmentation>> {
    let names = landmark_names(cells, rows);
    let (run, _grant) = run.threads_within(member_bytes(rows.count, cells.len()));
    run.map_chunks(
        count,
        || (),
        |k, ()| {
            let mut random = stream(run.seed, &format!("{purpose} {k}"));
            let params = OverSegmentationParams::draw(&names, &mut random);
            let width = below(&mut random, WIDTHS.len());
            Ok(OverSegmentation::new(cells, rows, &params, width, run.seed, &format!("{purpose} {k} clusters")))
        },
    )
}

/// The ensemble of `count` members used for deciding on parts, and its superfaces: drawn with shortcuts through thin
/// places ([`super::shortcuts`]), but compared by the geometry on the surface.
///
/// # Errors
/// Cancellation.
pub fn measured_ensemble(
    cells: &CellGraph,
    rows: LandmarkDistances,
    count: usize,
    run: &Run,
) -> Result<(Vec<OverSegmentation>, MeasuredSuperfaces)> {
    let embedding = comparison_embedding(cells, &rows);
    let rows = with_shortcuts(cells, rows, run)?;
    let ensemble = draw_ensemble(cells, &rows, count, "parts member", run)?;
    let measured = MeasuredSuperfaces::of(cells, &embedding, &ensemble, run)?;
    Ok((ensemble, measured))
}

/// The identifier of each landmark in random draws: that of the nearest cell, made unique among landmarks there.
fn landmark_names(cells: &CellGraph, rows: &LandmarkDistances) -> Vec<u64> {
    let (names, mut there) = (cells.names(), vec![0u64; cells.len()]);
    (0..rows.count)
        .map(|j| {
            let nearest = rows.nearest_point(j);
            there[nearest] += 1;
            u64::from(names[nearest]) | there[nearest] << 32
        })
        .collect()
}

/// Superfaces: the intersections of all regions of the ensemble.
#[derive(Clone, Debug)]
pub struct Superfaces {
    /// Superface of each cell (S), numbered by first appearance.
    pub of_cell: Vec<u32>,
    /// A representative cell of each superface: its first (R).
    pub first: Vec<u32>,
    /// Area of each superface (R).
    pub area: Vec<f64>,
}

/// Superfaces and the data from which region sums are gathered.
#[derive(Clone, Debug)]
pub struct MeasuredSuperfaces {
    /// The superfaces.
    pub superfaces: Superfaces,
    /// Logarithm of the thickness behind each cell (S), from [`log_thickness`].
    pub log_thickness: Vec<f64>,
    /// Sums over each cell (S).
    moments: Vec<CellMoments>,
    /// Convexity between superfaces.
    sums: Vec<Vec<PairSums>>,
    /// How folded the surface is ([`log_folding`]).
    log_folding: f64,
    /// The shape in which regions of a plate or a sheet are compared.
    inflated: Option<Inflated>,
}

/// The embedding of all `rows` whose means are used to compare regions.
pub fn comparison_embedding(cells: &CellGraph, rows: &LandmarkDistances) -> AnchorEmbedding {
    let all: Vec<usize> = (0..rows.count).collect();
    anchor_embedding(rows, &all, &cells.area_shares(), EMBEDDING_DIMENSIONS, COMPARE_SCALE)
}

impl MeasuredSuperfaces {
    /// The superfaces of an ensemble, and the data for comparing regions: `embedding` is the [`comparison_embedding`].
    ///
    /// # Errors
    /// Cancellation.
    pub fn of(
        cells: &CellGraph,
        embedding: &AnchorEmbedding,
        ensemble: &[OverSegmentation],
        run: &Run,
    ) -> Result<MeasuredSuperfaces> {
        let (mut of_cell, mut n) = (vec![0; cells.len()], usize::from(!cells.is_empty()));
        for m in ensemble {
            (of_cell, n) = intersect(&of_cell, &m.region);
        }
        let mut first = vec![0; n];
        for (i, &a) in of_cell.iter().enumerate().rev() {
            first[a as usize] = i as u32;
        }
        let inflated = Inflated::of(cells);
        let superfaces = Superfaces { area: class_sums(&of_cell, &cells.area, n), of_cell, first };
        let (of_cell, points) = match &inflated {
            Some(shape) => {
                let values = shape.values(&embedding.values).into_owned();
                (shape.values(&superfaces.of_cell), Cow::Owned(AnchorEmbedding { values, ..*embedding }))
            }
            None => (superfaces.of_cell.as_slice().into(), Cow::Borrowed(embedding)),
        };
        let shape = inflated.as_ref().map_or(cells, |shape| &shape.cells);
        let mut log_thickness = log_thickness(shape, run)?;
        let sums = convexity(shape, &log_thickness, &of_cell, &RegionPieces::connected(shape, &of_cell, n), run)?;
        let moments = cell_moments(shape, &points, &log_thickness);
        log_thickness.truncate(cells.len());
        Ok(MeasuredSuperfaces { log_folding: log_folding(shape), sums, moments, log_thickness, inflated, superfaces })
    }

    /// Region sums of a labelling of cells that is constant on superfaces.
    pub fn regions(&self, cells: &CellGraph, region: &[u32], n: usize, width: usize) -> Regions {
        let whole = RegionPieces::whole(n);
        self.regions_in_pieces(cells, region, &whole, width).pop().unwrap_or_default()
    }

    /// The same for each of the `pieces` that the regions lie in.
    fn regions_in_pieces(
        &self,
        cells: &CellGraph,
        region: &[u32],
        pieces: &RegionPieces,
        width: usize,
    ) -> Vec<Regions> {
        let (shape, of_cell) = match &self.inflated {
            Some(shape) => (&shape.cells, shape.values(region)),
            None => (cells, region.into()),
        };
        let labels = RegionLabels { of_cell: &of_cell, of_superface: &self.superfaces.labels(region), pieces };
        let mut all = Regions::gather(shape, &self.moments, &self.sums, labels, width);
        all.iter_mut().for_each(|regions| regions.log_folding = self.log_folding);
        all
    }
}

impl Superfaces {
    /// Superfaces read from storage: the superface of each cell (S), and their areas (R). `None` if a number is out of
    /// range, or a superface has no cell.
    pub fn kept(of_cell: Vec<u32>, area: Vec<f64>) -> Option<Superfaces> {
        let mut first = vec![u32::MAX; area.len()];
        for (cell, &superface) in of_cell.iter().enumerate().rev() {
            *first.get_mut(superface as usize)? = cell as u32;
        }
        let whole = !first.contains(&u32::MAX);
        whole.then_some(Superfaces { of_cell, first, area })
    }

    /// Number of superfaces R.
    pub fn len(&self) -> usize {
        self.first.len()
    }

    /// Converts a labelling of cells that is constant on superfaces to one of superfaces.
    pub fn labels(&self, cells: &[u32]) -> Vec<u32> {
        self.first.iter().map(|&i| cells[i as usize]).collect()
    }

    /// Converts a labelling of superfaces (R) to one of cells (S).
    pub fn cell_labels(&self, label: &[u32]) -> Vec<u32> {
        self.of_cell.iter().map(|&x| label[x as usize]).collect()
    }

    /// The boundaries between superfaces as a list of (superface, superface, length), one entry for each pair of
    /// adjacent cells.
    pub fn shared_boundaries(&self, cells: &CellGraph) -> Vec<(u32, u32, f64)> {
        let name = |i: u32| self.of_cell[i as usize];
        let apart = |(&[i, j], &length): (&[u32; 2], &f64)| (name(i), name(j), length);
        cells.pairs.iter().zip(&cells.length).map(apart).filter(|(a, b, _)| a != b).collect()
    }
}

/// C (R × R): for two superfaces the mean over the ensemble, as [`MergeModel::mean`] says, of the probability at their
/// lowest common merge, 1 if an over-segmentation has them in one region, 0 if its tree never joins them.
///
/// # Errors
/// Cancellation.
pub fn co_association(
    cells: &CellGraph,
    measured: &MeasuredSuperfaces,
    ensemble: &[OverSegmentation],
    model: &MergeModel,
    run: &Run,
) -> Result<Square> {
    let most = ensemble.iter().map(|m| m.regions).max().unwrap_or(0);
    let (few, _grant) = run.threads_within(region_bytes(most));
    let trees = few.map_chunks(
        ensemble.len(),
        || (),
        |k, ()| {
            let m = &ensemble[k];
            let pieces = RegionPieces::connected(cells, &m.region, m.regions);
            let regions = measured.regions_in_pieces(cells, &m.region, &pieces, m.width);
            let meet = |r: Regions| meeting_probability(r.len(), &merges(r, model, |_| false));
            let blocks = regions.into_iter().map(meet).collect();
            Ok((measured.superfaces.labels(&m.region), MeetingProbabilities { pieces, blocks }))
        },
    )?;
    let c = mean_over_ensemble(measured.superfaces.len(), trees, model.mean, run)?;
    Ok(match &measured.inflated {
        Some(shape) => shape.sides_as_one(cells, &measured.superfaces.of_cell, c),
        None => c,
    })
}

/// The [`meeting_probability`] of any two regions of an over-segmentation; 0 for regions of different pieces.
#[derive(Clone, Debug)]
pub struct MeetingProbabilities {
    /// The pieces that the regions lie in.
    pub pieces: RegionPieces,
    /// The probabilities within each piece.
    pub blocks: Vec<Square>,
}

impl MeetingProbabilities {
    /// Writes the values of `region` with each other one to `row` (regions): `apart` with those of different pieces.
    fn put_row(&self, region: u32, apart: f64, row: &mut [f64]) {
        let (piece, place) = self.pieces.place(region);
        row.fill(apart);
        let values = self.blocks[piece].row(place);
        self.pieces.regions(piece).iter().zip(values).for_each(|(&other, &value)| row[other as usize] = value);
    }
}

/// C of `n` superfaces, given the region of each superface in every over-segmentation and the probabilities that two
/// regions belong together, which are combined as `how` says.
///
/// # Errors
/// Cancellation.
pub fn mean_over_ensemble(
    n: usize,
    mut trees: Vec<(Vec<u32>, MeetingProbabilities)>,
    how: EnsembleMean,
    run: &Run,
) -> Result<Square> {
    // There are far fewer regions than superfaces.
    let blocks = trees.iter_mut().flat_map(|(_, meet)| &mut meet.blocks);
    blocks.flat_map(|block| block.values_mut()).for_each(|p| *p = how.term(*p));
    let apart = how.term(0.0);
    let count = trees.len().max(1) as f64;
    let mut mean = Square::zeros(n);
    let fill = |k: usize, rows: &mut [f64], (): &mut ()| {
        for (label, meet) in &trees {
            let mut terms = vec![0.0; meet.pieces.region_count()];
            for (a, row) in chunk_range(n, SUPERFACES_PER_CHUNK, k).zip(rows.chunks_exact_mut(n)) {
                meet.put_row(label[a], apart, &mut terms);
                row.iter_mut().zip(label).for_each(|(sum, &b)| *sum += terms[b as usize]);
            }
        }
        rows.iter_mut().for_each(|x| *x = how.probability(*x / count));
        Ok(())
    };
    run.fill_chunks(mean.values_mut(), SUPERFACES_PER_CHUNK * n, || (), fill)?;
    Ok(mean)
}

/// Islands below this share of the area join the neighbour with the longest common boundary.
const ISLAND: f64 = 0.001;
/// Kernel widths of the embedding relative to the mean distance, one of which is drawn each time; greater ones lose
/// small parts.
pub const SCALES: [f64; 3] = [0.2, 0.25, 0.3];
/// Range of the number of clusters of an over-segmentation, both ends included: more than any object has parts.
const CLUSTERS: [usize; 2] = [22, 33];
/// Minimum number of landmarks of an over-segmentation, if there are as many.
const FEWEST_ROWS: usize = 30;

/// Parameters of an over-segmentation.
#[derive(Clone, Debug, PartialEq)]
pub struct OverSegmentationParams {
    /// Landmarks used, ascending.
    pub rows: Vec<usize>,
    /// Width of the embedding's kernel, relative to the mean distance.
    pub scale: f64,
    /// The K-means; its number of clusters is also the number of coordinates of the embedding, if there are enough
    /// rows.
    pub kmeans: CellKMeans,
}

/// The K-means of a single run: two starts, run to convergence.
const THOROUGH: CellKMeans = CellKMeans { clusters: 28, restarts: 2, rounds: 20, candidates: 3, tolerance: 1e-6 };
/// The K-means of one run among many: one start, eight rounds. Measured on 190 models, the parts of twelve such runs
/// are as good as with thorough ones, in half the time.
const FAST: CellKMeans = CellKMeans { clusters: 28, restarts: 1, rounds: 8, candidates: 3, tolerance: 1e-3 };

impl OverSegmentationParams {
    /// All rows, the middle scale, 28 clusters (fewer if there are fewer rows): the single run.
    pub fn single(rows: usize) -> OverSegmentationParams {
        let clusters = THOROUGH.clusters.min(rows.saturating_sub(1)).max(1);
        OverSegmentationParams {
            rows: (0..rows).collect(),
            scale: SCALES[1],
            kmeans: CellKMeans { clusters, ..THOROUGH },
        }
    }

    /// Draws random parameters: 30 to all of the landmarks identified by `names`, a scale, 22 to 33 clusters.
    pub fn draw(names: &[u64], random: &mut Random) -> OverSegmentationParams {
        let rows = names.len();
        let fewest = FEWEST_ROWS.min(rows.saturating_sub(1)).max(1);
        let count = (fewest + below(random, (rows + 1).saturating_sub(fewest))).min(rows);
        let mut all: Vec<usize> = (0..rows).collect();
        // By identifier, not by number: reordering landmarks changes nothing, and moving one changes only that one.
        let key = random.next_u64();
        all.sort_by_cached_key(|&j| splitmix_step(names[j] ^ key));
        all.truncate(count);
        all.sort_unstable();
        let scale = SCALES[below(random, SCALES.len())];
        let clusters = CLUSTERS[0] + below(random, CLUSTERS[1] - CLUSTERS[0] + 1);
        let clusters = clusters.min(count.saturating_sub(1)).max(1);
        OverSegmentationParams { rows: all, scale, kmeans: CellKMeans { clusters, ..FAST } }
    }
}

/// Region of each cell (S), numbered 0, 1, …, each region connected; and their number.
fn over_segment(
    cells: &CellGraph,
    rows: &LandmarkDistances,
    params: &OverSegmentationParams,
    random: &mut Random,
) -> (Vec<u32>, usize) {
    let shares = cells.area_shares();
    let x = anchor_embedding(rows, &params.rows, &shares, params.kmeans.clusters, params.scale);
    let label = params.kmeans.run(&x.values, &shares, &cells.names(), random);
    let (piece, _) = connected_pieces(&cells.pairs, &label);
    join_small(&cells.pairs, &cells.length, &shares, &piece, ISLAND, 0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::stream;

    #[test]
    fn parameters_stay_within_the_rows() {
        let mut random = stream(0, "test");
        for rows in [1, 2, 3, 30, 31, 60] {
            for _ in 0..50 {
                let names: Vec<u64> = (0..rows as u64).collect();
                let r = OverSegmentationParams::draw(&names, &mut random);
                assert!(!r.rows.is_empty() && r.rows.len() <= rows && r.rows.len() >= FEWEST_ROWS.min(rows - 1));
                assert!(r.rows.windows(2).all(|w| w[0] < w[1]) && r.rows.iter().all(|&j| j < rows));
                assert!(r.kmeans.clusters >= 1 && r.kmeans.clusters <= 33);
            }
        }
    }

    #[test]
    fn landmarks_that_change_places_are_drawn_all_the_same() {
        let names: Vec<u64> = (0..60).map(|i| 7 * i).collect();
        let mut other = names.clone();
        other.swap(3, 40);
        for seed in 0..20 {
            let of = |names: &[u64]| {
                let rows = OverSegmentationParams::draw(names, &mut stream(seed, "test")).rows;
                let mut chosen: Vec<u64> = rows.iter().map(|&j| names[j]).collect();
                chosen.sort_unstable();
                chosen
            };
            assert_eq!(of(&names), of(&other));
        }
    }
}
