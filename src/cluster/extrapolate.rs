//! Labels of the faces near boundaries by Nyström's extrapolation: each gets the nearby part whose cells are nearest in
//! the embedding.
//!
//! Only a face's column of `[A B]` is needed ([`AnchorExtension::embed`]). The candidates are the parts of the cells
//! within two steps of its own, each represented by the mean point of its cells among these. Faces are labelled
//! independently, so parts may get islands, which [`super::boundary`] removes. Cost: a pass over `[A B]`, l · width
//! multiply-adds and l exponentials per face of the narrow band. Memory: a chunk of columns per thread, and some means
//! per cell.

use super::parts::CellGraph;
use super::parts::ensemble::COMPARE_SCALE;
use super::parts::regions::EMBEDDING_DIMENSIONS;
use crate::base::Result;
use crate::base::parallel::chunk_range;
use crate::base::sort::sort_by;
use crate::distance::DistanceRows;
use crate::spectral::anchor::{AnchorExtension, LandmarkDistances, fit_anchor_embedding};
use crate::store::Run;

const CHUNK: usize = 1 << 13;

/// The mean points, in the embedding, of the parts around each cell.
#[derive(Debug)]
pub struct LocalPartMeans {
    extension: AnchorExtension,
    /// Twice the greatest finite distance of each row (l), used for unreached faces.
    far: Vec<f32>,
    /// Parts around each cell and their mean points, if there is more than one part (S).
    around: Vec<Vec<(u32, Vec<f64>)>>,
}

impl LocalPartMeans {
    /// Means of the parts `label` (S) from the rows averaged over cells, `b` (row-major l × S).
    pub fn new(cells: &CellGraph, b: &[f64], label: &[u32]) -> Self {
        let s = label.len();
        let l = b.len() / s.max(1);
        let rows = LandmarkDistances::new(b, l, s);
        let all: Vec<usize> = (0..l).collect();
        let (embedding, extension) =
            fit_anchor_embedding(&rows, &all, &cells.area_shares(), EMBEDDING_DIMENSIONS, COMPARE_SCALE);
        let far = all.iter().map(|&j| rows.row(j).iter().fold(0f64, |top, &d| top.max(d)) as f32 * 2.).collect();
        let beside = cells.neighbours();
        let around = (0..s)
            .map(|cell| {
                let first = beside[cell].iter().copied();
                let second = beside[cell].iter().flat_map(|&i| beside[i as usize].iter().copied());
                let mut near: Vec<u32> = first.chain(second).chain([cell as u32]).collect();
                sort_by(&mut near, |&i, &j| (label[i as usize], i).cmp(&(label[j as usize], j)));
                near.dedup();
                if near.iter().all(|&i| label[i as usize] == label[cell]) {
                    return Vec::new();
                }
                near.chunk_by(|&i, &j| label[i as usize] == label[j as usize])
                    .map(|part| {
                        let area: f64 = part.iter().map(|&i| cells.area[i as usize]).sum();
                        let mean = |k: usize| {
                            let sum = |&i: &u32| cells.area[i as usize] * embedding.point(i as usize)[k];
                            part.iter().map(sum).sum::<f64>() / area.max(1e-300)
                        };
                        (label[part[0] as usize], (0..embedding.width).map(mean).collect())
                    })
                    .collect()
            })
            .collect();
        Self { extension, far, around }
    }

    /// The part nearest to a face of `cell` at `point`; of several, the first.
    fn nearest(&self, cell: u16, point: &[f64]) -> Option<u32> {
        let away = |mean: &[f64]| mean.iter().zip(point).map(|(m, x)| (m - x) * (m - x)).sum::<f64>();
        let parts = self.around[cell as usize].iter();
        parts.map(|(label, mean)| (*label, away(mean))).reduce(|a, b| if b.1 < a.1 { b } else { a }).map(|best| best.0)
    }

    /// Relabels the faces for which `open` holds, by their columns of `rows`; `cell` (n) and `labels` (n).
    ///
    /// # Errors
    /// [`crate::base::Error::Cancelled`].
    pub fn relabel(
        &self,
        rows: &DistanceRows,
        cell: &[u16],
        open: impl Fn(usize) -> bool + Sync,
        labels: &mut [u32],
        run: &Run,
    ) -> Result<()> {
        let l = rows.len();
        let scratch = || (Vec::new(), Vec::<f32>::new(), vec![0f64; self.extension.width]);
        run.fill_chunks(labels, CHUNK, scratch, |k, out, (open_faces, columns, point)| {
            let range = chunk_range(rows.nodes, CHUNK, k);
            open_faces.clear();
            open_faces.extend(range.clone().filter(|&i| open(i) && !self.around[cell[i] as usize].is_empty()));
            columns.resize(open_faces.len() * l, 0.);
            for j in 0..l {
                let row = &rows.row(j)[range.clone()];
                for (b, &i) in open_faces.iter().enumerate() {
                    let d = row[i - range.start];
                    columns[b * l + j] = if d.is_finite() { d } else { self.far[j] };
                }
            }
            for (column, &i) in columns.chunks_exact(l.max(1)).zip(open_faces.iter()) {
                self.extension.embed(column, point);
                if let Some(label) = self.nearest(cell[i], point) {
                    out[i - range.start] = label;
                }
            }
            Ok(())
        })
        .map(drop)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::{below, stream, unit};
    use crate::spectral::anchor::anchor_embedding;
    use crate::store::WorkDir;

    /// A strip of cells with labels, their distances from six landmarks, and faces of random columns in random cells.
    struct TestStrip {
        cells: CellGraph,
        b: Vec<f64>,
        label: Vec<u32>,
        columns: Vec<Vec<f32>>,
        cell: Vec<u16>,
    }

    fn scene(n: usize) -> TestStrip {
        let (s, l, mut random) = (30usize, 6usize, stream(5, "extrapolation"));
        let pairs: Vec<[u32; 2]> = (1..s as u32).map(|i| [i - 1, i]).collect();
        let area: Vec<f64> = (0..s).map(|_| 0.5 + unit(&mut random)).collect();
        let cells = CellGraph { area, length: vec![1.; pairs.len()], pairs, ..CellGraph::default() };
        let b: Vec<f64> = (0..l * s).map(|k| ((k % s) as f64 - (k / s * 5) as f64).abs() + unit(&mut random)).collect();
        let label: Vec<u32> = (0..s as u32).map(|i| i / 7).collect();
        let columns = (0..l).map(|_| (0..n).map(|_| (30. * unit(&mut random)) as f32).collect()).collect();
        let cell = (0..n).map(|_| below(&mut random, s) as u16).collect();
        TestStrip { cells, b, label, columns, cell }
    }

    /// Reference: the face as an additional cell without area, embedded with all others.
    fn oracle(cells: &CellGraph, b: &[f64], label: &[u32], column: &[f32], cell: usize) -> u32 {
        let (s, l) = (label.len(), column.len());
        let with: Vec<f64> =
            (0..l).flat_map(|j| b[j * s..(j + 1) * s].iter().copied().chain([f64::from(column[j])])).collect();
        let shares: Vec<f64> = cells.area_shares().into_iter().chain([0.]).collect();
        let all: Vec<usize> = (0..l).collect();
        let x = anchor_embedding(
            &LandmarkDistances::new(&with, l, s + 1),
            &all,
            &shares,
            EMBEDDING_DIMENSIONS,
            COMPARE_SCALE,
        );
        let near = |part: u32| (0..s).filter(move |&i| label[i] == part && i.abs_diff(cell) <= 2);
        let away = |part: u32| {
            let area: f64 = near(part).map(|i| cells.area[i]).sum();
            let mean = |k: usize| near(part).map(|i| cells.area[i] * x.point(i)[k]).sum::<f64>() / area;
            (0..x.width).map(|k| (mean(k) - x.point(s)[k]).powi(2)).sum::<f64>()
        };
        let parts = (0..5).filter(|&part| near(part).next().is_some());
        parts.min_by(|&a, &b| away(a).total_cmp(&away(b))).unwrap()
    }

    #[test]
    fn each_face_gets_what_one_more_cell_would() {
        let n = 20_000;
        let TestStrip { cells, b, label, columns, cell } = scene(n);
        let folder = tempfile::tempdir().unwrap();
        let work = WorkDir::open(&folder.path().join("work")).unwrap();
        let mut array = work.array::<f32>("distances.npy", &[columns.len(), n]).unwrap();
        array.data().copy_from_slice(&columns.concat());
        let distances = array.finish(false).unwrap();
        let rows = DistanceRows { landmarks: vec![0; 6], distances, facts: vec![], nodes: n, key: String::new() };
        let means = LocalPartMeans::new(&cells, &b, &label);
        let relabel = |threads| {
            let mut labels: Vec<u32> = cell.iter().map(|&c| label[c as usize]).collect();
            let run = Run { threads, ..Run::new(&()) };
            means.relabel(&rows, &cell, |i| i % 3 > 0, &mut labels, &run).unwrap();
            labels
        };
        let found = relabel(1);
        assert_eq!(found, relabel(3));
        let mut moved = 0;
        for i in (0..n).step_by(61) {
            let own = label[cell[i] as usize];
            let column: Vec<f32> = columns.iter().map(|row| row[i]).collect();
            let expected = if i % 3 == 0 { own } else { oracle(&cells, &b, &label, &column, cell[i] as usize) };
            assert_eq!(found[i], expected, "{i}");
            moved += usize::from(expected != own);
        }
        assert!(moved > 20, "{moved}");
    }
}
