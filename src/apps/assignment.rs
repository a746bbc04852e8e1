//! The assignment problem: assigns each row its own column at the least total cost.
//!
//! Shortest augmenting paths with potentials (Kuhn; Jonker and Volgenant), exact: at most rows² × columns steps, about
//! 0.1 s for 500 × 500. This is our own code because the available crates accept only integers or square matrices, and
//! the costs here are floating-point numbers that must give the same assignment on every machine.

/// No row.
const FREE: usize = usize::MAX;

/// The row assigned to each of `columns` columns, minimising Σ cost(row, column); `None` for columns left over. Returns
/// `None` if there are more rows than columns, or if costs are not finite.
pub(super) fn least_assignment(
    rows: usize,
    columns: usize,
    cost: impl Fn(usize, usize) -> f64,
) -> Option<Vec<Option<usize>>> {
    if rows > columns {
        return None;
    }
    // Potentials of rows and columns, and the row that holds each column; the last column stands for the row being
    // assigned.
    let (mut of_row, mut of_column) = (vec![0f64; rows], vec![0f64; columns]);
    let mut held_by = vec![FREE; columns + 1];
    let (mut least, mut from, mut seen) = (vec![0f64; columns], vec![columns; columns], vec![false; columns + 1]);
    for row in 0..rows {
        held_by[columns] = row;
        least.fill(f64::INFINITY);
        seen.fill(false);
        let mut at = columns;
        while held_by[at] != FREE {
            seen[at] = true;
            let here = held_by[at];
            let (mut delta, mut next) = (f64::INFINITY, columns);
            for k in (0..columns).filter(|&k| !seen[k]) {
                let reduced = cost(here, k) - of_row[here] - of_column[k];
                if reduced < least[k] {
                    (least[k], from[k]) = (reduced, at);
                }
                if least[k] < delta {
                    (delta, next) = (least[k], k);
                }
            }
            if next == columns {
                return None;
            }
            for k in 0..columns {
                if seen[k] {
                    of_row[held_by[k]] += delta;
                    of_column[k] -= delta;
                } else {
                    least[k] -= delta;
                }
            }
            of_row[row] += delta;
            at = next;
        }
        while at != columns {
            held_by[at] = held_by[from[at]];
            at = from[at];
        }
    }
    held_by.truncate(columns);
    Some(held_by.into_iter().map(|row| Some(row).filter(|&row| row != FREE)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::{stream, unit};

    /// Reference: the least of all assignments, by enumeration.
    fn brute(costs: &[Vec<f64>], columns: usize, row: usize, used: u32) -> f64 {
        if row == costs.len() {
            return 0.;
        }
        let free = (0..columns).filter(|k| used >> k & 1 == 0);
        free.map(|k| costs[row][k] + brute(costs, columns, row + 1, used | 1 << k)).fold(f64::INFINITY, f64::min)
    }

    #[test]
    fn the_least_assignment_is_the_least_of_all() {
        let mut draw = stream(2, "costs");
        for (rows, columns) in [(0, 0), (0, 3), (1, 1), (1, 4), (3, 3), (3, 6), (5, 5), (4, 6)] {
            for _ in 0..30 {
                let costs: Vec<Vec<f64>> =
                    (0..rows).map(|_| (0..columns).map(|_| unit(&mut draw) - 0.3).collect()).collect();
                let found = least_assignment(rows, columns, |i, k| costs[i][k]).unwrap();
                let sum: f64 = found.iter().enumerate().filter_map(|(k, row)| row.map(|row| costs[row][k])).sum();
                assert!((sum - brute(&costs, columns, 0, 0)).abs() < 1e-12, "{rows} {columns}");
                let mut given: Vec<usize> = found.into_iter().flatten().collect();
                given.sort_unstable();
                assert!(given.into_iter().eq(0..rows));
            }
        }
        assert_eq!(least_assignment(2, 2, |_, _| f64::NAN), None);
        assert_eq!(least_assignment(2, 1, |_, _| 0.), None);
    }
}
