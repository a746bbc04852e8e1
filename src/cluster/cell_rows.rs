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
