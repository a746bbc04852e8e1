//! The region metrics of the Princeton benchmark, read from a contingency table.
//!
//! Chen, Golovinskiy, Funkhouser, *A Benchmark for 3D Mesh Segmentation*, 2009, section 4: Rand
//! index (4.3), Hamming distance (4.2), consistency errors (4.4). All are 0 for equal labellings,
//! below 1, lower is better. Cost: one pass over the cells.

use super::contingency::Contingency;

/// 1 − Rand index over pairs of faces: the share of pairs on which the labellings disagree whether
/// they belong together. Counted exactly, rounded once.
pub fn rand(table: &Contingency) -> f64 {
    let pairs = |faces: u64| u128::from(faces) * u128::from(faces.saturating_sub(1)) / 2;
    let all = pairs(table.faces);
    if all == 0 {
        return 0.;
    }
    let one: u128 = table.rows.iter().map(|part| pairs(part.faces)).sum();
    let other: u128 = table.columns.iter().map(|part| pairs(part.faces)).sum();
    let both: u128 = table.cells.iter().map(|cell| pairs(cell.faces)).sum();
    (one + other - 2 * both) as f64 / all as f64
}

/// [`rand`] with each pair weighted by the product of its areas: independent of the tessellation,
/// equal to [`rand`] where all areas are.
pub fn rand_area(table: &Contingency) -> f64 {
    let apart = |cell: &super::Cell| {
        let (row, column) = (&table.rows[cell.row as usize], &table.columns[cell.column as usize]);
        cell.area * ((row.area - cell.area) + (column.area - cell.area))
    };
    share(table.cells.iter().map(apart).sum(), table.area * table.area - table.squares)
}

/// The directional Hamming distances over the area, as missing rate and false-alarm rate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hamming {
    /// Area of truth parts outside the part that covers most of each.
    pub missing: f64,
    /// Area of judged parts outside the truth part that covers most of each.
    pub false_alarm: f64,
}

/// Missing and false-alarm rate by area.
pub fn hamming(table: &Contingency) -> Hamming {
    let (mut rows, mut columns) = (vec![0f64; table.rows.len()], vec![0f64; table.columns.len()]);
    for cell in &table.cells {
        let (row, column) = (&mut rows[cell.row as usize], &mut columns[cell.column as usize]);
        *row = row.max(cell.area);
        *column = column.max(cell.area);
    }
    let outside = |parts: &[super::Part], covered: &[f64]| {
        share(parts.iter().zip(covered).map(|(part, covered)| part.area - covered).sum(), table.area)
    };
    Hamming { missing: outside(&table.columns, &columns), false_alarm: outside(&table.rows, &rows) }
}

/// The consistency errors, which forgive that one labelling refines the other: everywhere in the
/// same direction (global), or in either at each face (local).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Consistency {
    /// Global consistency error.
    pub gce: f64,
    /// Local consistency error, at most the global one.
    pub lce: f64,
}

/// Global and local consistency error, faces weighted by area.
pub fn consistency(table: &Contingency) -> Consistency {
    let (mut one, mut other, mut least) = (0., 0., 0.);
    for cell in &table.cells {
        let (row, column) = (&table.rows[cell.row as usize], &table.columns[cell.column as usize]);
        let a = share(cell.area * (row.area - cell.area), row.area);
        let b = share(cell.area * (column.area - cell.area), column.area);
        one += a;
        other += b;
        least += a.min(b);
    }
    Consistency { gce: share(f64::min(one, other), table.area), lce: share(least, table.area) }
}

/// `part / whole`, at least 0; 0 where there is no whole.
fn share(part: f64, whole: f64) -> f64 {
    if whole > 0. { (part / whole).max(0.) } else { 0. }
}
