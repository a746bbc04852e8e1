//! Rows averaged over cells: B (l × S), all that deciding parts needs of `[A B]`.
//!
//! Rows on the cell graph alone are much worse (.15–.22 against .10 in 1 − Rand); averages of rows over all faces are not.
//! One sequential pass over each row, 12 bytes read a face, 4 of them of the row: as it comes from its front, or from where it is kept.

use super::area_shares::AreaShares;
use super::cells::Cells;
use crate::base::Result;
use crate::base::parallel::map_chunks;
use crate::distance::DistanceRows;
use crate::store::Run;

/// Averages rows over cells.
#[derive(Clone, Debug)]
pub struct Average<'a> {
    cell: &'a [u32],
    share: &'a [f32],
    /// Area of each cell (S).
    mass: Vec<f64>,
}

impl<'a> Average<'a> {
    /// Averages over `cells`; faces count by `shares`.
    pub fn new(cells: &'a Cells, shares: &'a AreaShares) -> Self {
        let (cell, share) = (&cells.of_node[..], &shares.share[..]);
        let mut mass = vec![0f64; cells.len()];
        for (&c, &share) in cell.iter().zip(share) {
            mass[c as usize] += weight(share);
        }
        Self { cell, share, mass }
    }

    /// Area means over each cell (S) of a row of distances (n); infinite where a cell is not reached.
    pub fn of(&self, row: &[f32]) -> Vec<f64> {
        let mut sums = vec![0f64; self.mass.len()];
        for ((&c, &share), &d) in self.cell.iter().zip(self.share).zip(row) {
            sums[c as usize] += weight(share) * f64::from(d);
        }
        sums.iter().zip(&self.mass).map(|(sum, mass)| sum / mass).collect()
    }
}

/// What a face counts: the same floor as in the cells' own means, for cells of dust alone.
fn weight(share: f32) -> f64 {
    f64::from(share).max(1e-18)
}

/// Area means of each row over each cell, row-major l × S; infinite where a cell is not reached.
///
/// # Errors
/// [`crate::base::Error::Cancelled`].
pub fn average(rows: &DistanceRows, cells: &Cells, shares: &AreaShares, run: &Run) -> Result<Vec<f64>> {
    let average = Average::new(cells, shares);
    let averaged = map_chunks(
        run.threads,
        &run.cancel,
        rows.len(),
        || (),
        |k, ()| {
            let mean = average.of(rows.row(k));
            run.progress.advance("cell rows", 1);
            Ok(mean)
        },
    )?;
    Ok(averaged.into_iter().flatten().collect())
}

/// Share of the surface that is nearest to the landmark with the most of it, from rows averaged over cells
/// (row-major l × S) and the cells' areas (S). .54 or less on 185 of 190 models of the Princeton benchmark; .89 where all
/// but one landmark sat in pockets of an isosurface.
pub fn greatest_share(b: &[f64], area: &[f64]) -> f64 {
    let mut share = vec![0f64; b.len() / area.len().max(1)];
    for (cell, a) in area.iter().enumerate() {
        let nearer =
            |best: usize, k: usize| if b[k * area.len() + cell] < b[best * area.len() + cell] { k } else { best };
        if let Some(nearest) = (0..share.len()).reduce(nearer) {
            share[nearest] += a;
        }
    }
    let total: f64 = area.iter().sum();
    if total > 0. { share.into_iter().fold(0., f64::max) / total } else { 0. }
}

#[cfg(test)]
mod tests {
    use super::greatest_share;

    #[test]
    fn the_landmark_that_most_of_the_surface_is_nearest_to() {
        let b = [0., 1., 2., 9., 5., 4., 3., 0., f64::INFINITY, f64::INFINITY, f64::INFINITY, f64::INFINITY];
        assert_eq!(greatest_share(&b, &[1., 1., 1., 1.]), 0.75);
        assert_eq!(greatest_share(&b, &[1., 1., 1., 9.]), 0.75);
        assert_eq!(greatest_share(&b, &[0., 0., 0., 0.]), 0.);
        assert_eq!(greatest_share(&[], &[1.]), 0.);
    }
}
