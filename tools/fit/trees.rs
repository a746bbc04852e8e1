//! The members' trees of a model: what people make of each merge, and the parts that they lead to.

use super::data::{Data, Overlap};
use nystrom_stream::base::Result;
use nystrom_stream::cluster::parts::ensemble::{
    MeetingProbabilities, OverSegmentation, mean_over_ensemble, measured_ensemble,
};
use nystrom_stream::cluster::parts::labelling::{best_labelling, soft_hierarchy};
use nystrom_stream::cluster::parts::merge_features::FEATURES;
use nystrom_stream::cluster::parts::merges::{EnsembleMean, MergeModel, RegionMerge, meeting_probability, merges};
use nystrom_stream::cluster::parts::region_pieces::RegionPieces;
use nystrom_stream::cluster::parts::{CellGraph, PartsParams, Superfaces};
use nystrom_stream::spectral::anchor::LandmarkDistances;
use nystrom_stream::store::Run;

/// A merge as the fit sees it.
pub struct Example {
    pub features: [f64; FEATURES],
    /// Share of people who keep the two regions in one part: the mean over people and pairs of points of either.
    pub together: f64,
    /// Product of the two areas, the whole being 1.
    pub pairs: f64,
}

/// A member: the region of each atom, how many there are, and how they merge.
struct Tree {
    region: Vec<u32>,
    regions: usize,
    merges: Vec<RegionMerge>,
}

/// A model with its members' trees.
pub struct Trees {
    cells: CellGraph,
    people: Vec<Vec<Overlap>>,
    superfaces: Superfaces,
    trees: Vec<Tree>,
    mean: EnsembleMean,
    pub examples: Vec<Example>,
}

/// 1 − Rand index over pairs of faces, mean over people, of labels on cells.
#[derive(Clone, Copy, Default)]
pub struct Score {
    pub found: f64,
    pub given: f64,
}

impl Trees {
    /// Draws the members as the library does and merges them in the order of `model`.
    pub fn grow(data: Data, model: &MergeModel, count: usize, seed: u64) -> Result<Trees> {
        let run = Run { threads: 1, seed, ..Run::new(&()) };
        let rows = LandmarkDistances::new(&data.rows, data.landmarks, data.cells.len());
        let (ensemble, measured) = measured_ensemble(&data.cells, rows, count, &run)?;
        let mut examples = Vec::new();
        let grow = |m: &OverSegmentation| {
            let merges = merges(measured.regions(&data.cells, &m.region, m.regions, m.width), model, |_| false);
            examples.extend(judged(m, &merges, &data.people));
            Tree { region: measured.superfaces.labels(&m.region), regions: m.regions, merges }
        };
        let trees = ensemble.iter().map(grow).collect();
        // Only merging needs the measures, and they are most of the memory.
        let superfaces = measured.superfaces;
        Ok(Trees { cells: data.cells, people: data.people, superfaces, trees, mean: model.mean, examples })
    }

    /// How good the parts are, as many as are found and as many as `parts`.
    pub fn score(&self, parts: usize) -> Result<Score> {
        let run = Run { threads: 1, ..Run::new(&()) };
        let meet = |tree: &Tree| {
            let blocks = vec![meeting_probability(tree.regions, &tree.merges)];
            (tree.region.clone(), MeetingProbabilities { pieces: RegionPieces::whole(tree.regions), blocks })
        };
        let trees = self.trees.iter().map(meet).collect();
        let together = mean_over_ensemble(self.superfaces.len(), trees, self.mean, &run)?;
        let best = best_labelling(&self.superfaces.area, &together);
        let small_part = PartsParams::default().small_part;
        let tree = soft_hierarchy(&self.cells, &self.superfaces, &together, &best, None, small_part, &run)?;
        let (found, given) = (tree.cut_detail(0.), tree.cut_k(parts)?);
        Ok(Score { found: self.rand(&found.label), given: self.rand(&given.label) })
    }

    fn rand(&self, label: &[u32]) -> f64 {
        let sum: f64 = self.people.iter().map(|person| disagreement(label, person)).sum();
        sum / self.people.len().max(1) as f64
    }
}

/// 1 − Rand index over pairs of faces.
fn disagreement(label: &[u32], person: &[Overlap]) -> f64 {
    let rows = label.iter().max().map_or(0, |&k| k as usize + 1);
    let columns = person.iter().map(|o| o.label as usize + 1).max().unwrap_or(0);
    let mut table = vec![0f64; rows * columns];
    for o in person {
        table[label[o.cell as usize] as usize * columns + o.label as usize] += f64::from(o.faces);
    }
    let square = |x: f64| x * x;
    let n: f64 = table.iter().sum();
    let both: f64 = table.iter().copied().map(square).sum();
    let ours: f64 = table.chunks(columns).map(|row| square(row.iter().sum())).sum();
    let theirs: f64 = (0..columns).map(|c| square(table.iter().skip(c).step_by(columns).sum())).sum();
    (ours + theirs - 2. * both) / (n * (n - 1.)).max(1.)
}

/// What people make of a member's merges.
fn judged(member: &OverSegmentation, merges: &[RegionMerge], people: &[Vec<Overlap>]) -> Vec<Example> {
    let mut examples: Vec<Example> =
        merges.iter().map(|m| Example { features: m.features, together: 0., pairs: 0. }).collect();
    for person in people {
        let labels = person.iter().map(|o| o.label as usize + 1).max().unwrap_or(0);
        let mut sums = vec![vec![0f64; labels]; member.regions];
        for o in person {
            sums[member.region[o.cell as usize] as usize][o.label as usize] += o.area;
        }
        let all: f64 = sums.iter().flatten().sum();
        for (m, example) in merges.iter().zip(&mut examples) {
            let other = std::mem::take(&mut sums[m.j]);
            let area = |sums: &[f64]| sums.iter().sum::<f64>() / all;
            example.pairs = area(&sums[m.i]) * area(&other);
            let same: f64 = sums[m.i].iter().zip(&other).map(|(a, b)| a * b).sum::<f64>() / (all * all);
            example.together += same / example.pairs.max(1e-300) / people.len() as f64;
            sums[m.i].iter_mut().zip(&other).for_each(|(a, b)| *a += b);
        }
    }
    examples
}
