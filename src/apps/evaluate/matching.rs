//! The share of faces that carry the right label once parts are named as the truth names them.
//!
//! Each part is matched to at most one part of the truth so that the common area is greatest.
//! Cost: the Hungarian method, O(a² b) for a ≤ b parts; above a thousand parts on the smaller side
//! greedily by overlap, O(cells log cells).

use super::contingency::Contingency;

/// The most parts on the smaller side for the exact method.
const EXACT: usize = 1000;
/// The most entries of the dense table of the exact method (64 MB).
const EXACT_ENTRIES: usize = 1 << 23;

/// Share of the area under the best one-to-one matching of parts; 1 for equal labellings, and for
/// an empty one.
pub fn matches(table: &Contingency) -> f64 {
    if table.area <= 0. {
        return 1.;
    }
    let (a, b) = (table.rows.len(), table.columns.len());
    let common = if a.min(b) <= EXACT && a.saturating_mul(b) <= EXACT_ENTRIES { best(table) } else { greedy(table) };
    (common / table.area).min(1.)
}

/// The greatest overlaps first, each part once.
fn greedy(table: &Contingency) -> f64 {
    let mut order: Vec<usize> = (0..table.cells.len()).collect();
    order.sort_by(|&x, &y| table.cells[y].area.total_cmp(&table.cells[x].area));
    let (mut rows, mut columns) = (vec![false; table.rows.len()], vec![false; table.columns.len()]);
    let mut common = 0.;
    for cell in order.into_iter().map(|at| &table.cells[at]) {
        let (row, column) = (&mut rows[cell.row as usize], &mut columns[cell.column as usize]);
        if !*row && !*column {
            (*row, *column) = (true, true);
            common += cell.area;
        }
    }
    common
}

/// The greatest common area of any matching: shortest augmenting paths with potentials.
fn best(table: &Contingency) -> f64 {
    let flip = table.rows.len() > table.columns.len();
    let (a, b) = (table.rows.len().min(table.columns.len()), table.rows.len().max(table.columns.len()));
    let mut area = vec![0f64; a * b];
    for cell in &table.cells {
        let (row, column) = if flip { (cell.column, cell.row) } else { (cell.row, cell.column) };
        area[row as usize * b + column as usize] = cell.area;
    }
    // Column 0 is a stand-in for the row being placed; rows and columns count from 1.
    let (mut of_row, mut of_column) = (vec![0f64; a + 1], vec![0f64; b + 1]);
    let (mut owner, mut before) = (vec![0usize; b + 1], vec![0usize; b + 1]);
    for row in 1..=a {
        owner[0] = row;
        let mut at = 0;
        let (mut slack, mut seen) = (vec![f64::INFINITY; b + 1], vec![false; b + 1]);
        while owner[at] != 0 {
            seen[at] = true;
            let (mut step, mut next) = (f64::INFINITY, 0);
            for column in (1..=b).filter(|&column| !seen[column]) {
                let cost = -area[(owner[at] - 1) * b + column - 1] - of_row[owner[at]] - of_column[column];
                if cost < slack[column] {
                    (slack[column], before[column]) = (cost, at);
                }
                if slack[column] < step {
                    (step, next) = (slack[column], column);
                }
            }
            for column in 0..=b {
                if seen[column] {
                    of_row[owner[column]] += step;
                    of_column[column] -= step;
                } else {
                    slack[column] -= step;
                }
            }
            at = next;
        }
        while at != 0 {
            owner[at] = owner[before[at]];
            at = before[at];
        }
    }
    (1..=b).filter(|&column| owner[column] > 0).map(|column| area[(owner[column] - 1) * b + column - 1]).sum()
}

#[cfg(test)]
mod tests {
    use super::super::contingency;
    use super::*;

    #[test]
    fn names_do_not_matter_and_greed_is_not_best() {
        let share = |a: &[u32], b: &[u32]| matches(&contingency(a, b, None).unwrap());
        assert_eq!(share(&[1, 1, 2, 3], &[7, 7, 0, 5]), 1.);
        assert_eq!(share(&[1, 1, 1, 1], &[0, 1, 2, 2]), 0.5);
        assert_eq!(share(&[0, 1, 2, 2], &[1, 1, 1, 1]), 0.5);
        assert_eq!(share(&[], &[]), 1.);
        // Overlaps 4 and 3 in the first row, 3 and 0 in the second: 3 + 3 beats 4 + 0.
        let table = contingency(&[0, 0, 0, 0, 0, 0, 0, 1, 1, 1], &[0, 0, 0, 0, 1, 1, 1, 0, 0, 0], None).unwrap();
        assert_eq!((best(&table), greedy(&table)), (6., 4.));
    }

    #[test]
    fn equal_to_trying_all_permutations() {
        use crate::base::random;
        let mut random = random::stream(1, "matching");
        for _ in 0..50 {
            let labels: Vec<u32> = (0..40).map(|_| random::below(&mut random, 4) as u32).collect();
            let truth: Vec<u32> = (0..40).map(|_| random::below(&mut random, 5) as u32).collect();
            let table = contingency(&labels, &truth, None).unwrap();
            let mut most = 0;
            for code in 0..5u32.pow(4) {
                let name = |l: u32| code / 5u32.pow(l) % 5;
                let names: std::collections::BTreeSet<u32> = (0..4).map(name).collect();
                if names.len() == 4 {
                    most = most.max(labels.iter().zip(&truth).filter(|(l, t)| name(**l) == **t).count());
                }
            }
            assert_eq!(best(&table), most as f64);
        }
    }
}
