//! Rows averaged over cells: B (l × S), all that deciding parts needs of `[A B]`.
//!
//! Rows on the cell graph alone are much worse (.15–.22 against .10 in 1 − Rand); averages of rows over all faces are not.
//! One sequential pass, 4 l bytes read a face.

use super::cells::Cells;
use super::shares::Shares;
use crate::base::Result;
use crate::base::parallel::map_chunks;
use crate::distance::DistanceRows;
use crate::store::Run;

/// Area means of each row over each cell, row-major l × S; infinite where a cell is not reached.
///
/// # Errors
/// [`crate::base::Error::Cancelled`].
pub fn average(rows: &DistanceRows, cells: &Cells, shares: &Shares, run: &Run) -> Result<Vec<f64>> {
    let s = cells.len();
    let cell = &cells.of_node[..];
    // The same floor as the cells' own means, for cells of dust alone.
    let mut mass = vec![0f64; s];
    for (&c, &share) in cell.iter().zip(shares.share.iter()) {
        mass[c as usize] += f64::from(share).max(1e-18);
    }
    let averaged = map_chunks(
        run.threads,
        &run.cancel,
        rows.len(),
        || (),
        |k, ()| {
            let mut sums = vec![0f64; s];
            for ((&c, &share), &d) in cell.iter().zip(shares.share.iter()).zip(rows.row(k)) {
                sums[c as usize] += f64::from(share).max(1e-18) * f64::from(d);
            }
            run.progress.advance("cell rows", 1);
            Ok(sums.iter().zip(&mass).map(|(sum, mass)| sum / mass).collect::<Vec<f64>>())
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
