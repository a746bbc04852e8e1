//! The overlaps of two labellings of the same faces, and the metrics computed from that table.
//!
//! Labels may be any `u32`: they are numbered by ascending value first. Rand index, Hamming distance and consistency
//! errors are those of Chen, Golovinskiy, Funkhouser, *A Benchmark for 3D Mesh Segmentation*, 2009, section 4: 0 for
//! equal labellings, at most 1, lower is better. [`matches`] is the share of faces labelled correctly after parts are
//! renamed to fit the truth. Cost: two passes over each labelling, about 5 ns per face; memory: a table of parts ×
//! parts, or a hash map of the non-empty cells if that table would be larger than the labels (then 200 ns per face).

use crate::apps::assignment::least_assignment;
use crate::base::printable::counted;
use crate::base::sort::order_by;
use crate::base::{Error, Result};
use std::collections::HashMap;

/// Tables of up to this many cells (16 MB), or as many as there are faces, are dense.
const DENSE_CELLS: usize = 1 << 20;

/// A part of a labelling: the faces that carry one label.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Marginal {
    /// Its original label.
    pub label: u32,
    /// Number of its faces, at least 1.
    pub faces: u64,
    /// Their area, in squared units of the mesh.
    pub area: f64,
}

/// The overlap of a part of one labelling with a part of the other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Overlap {
    /// Number of the part in [`Contingency::rows`].
    pub row: u32,
    /// Number of the part in [`Contingency::columns`].
    pub column: u32,
    /// Faces in both, at least 1.
    pub faces: u64,
    /// Their area, in squared units of the mesh.
    pub area: f64,
}

/// The overlaps of two labellings of the same faces.
#[derive(Clone, Debug, PartialEq)]
pub struct Contingency {
    /// Parts of the evaluated labelling, by ascending label. Their areas are the sums of their cells.
    pub rows: Vec<Marginal>,
    /// Parts of the truth, by ascending label. Their areas are the sums of their cells.
    pub columns: Vec<Marginal>,
    /// The non-empty overlaps, by row, then column.
    pub cells: Vec<Overlap>,
    /// Number of faces.
    pub faces: u64,
    /// Area of all faces.
    pub area: f64,
    /// Sum of the squared areas of single faces (the weight of pairs of a face with itself).
    pub squares: f64,
}

/// Labels numbered from 0 by ascending value.
#[derive(Clone, Debug)]
pub(super) struct LabelIndex {
    labels: Vec<u32>,
    lookup: Lookup,
}

#[derive(Clone, Debug)]
enum Lookup {
    /// Number by label, for small labels.
    Direct(Vec<u32>),
    /// Number by label, for any labels.
    Hashed(HashMap<u32, u32>),
}

impl LabelIndex {
    /// Numbers the labels that occur.
    pub(super) fn of(labels: &[u32]) -> Self {
        let span = labels.iter().max().map_or(0, |&max| max as usize + 1);
        if span > 4 * labels.len() + (1 << 16) {
            let mut distinct: Vec<u32> = labels.to_vec();
            distinct.sort_unstable();
            distinct.dedup();
            let map = distinct.iter().zip(0..).map(|(&label, number)| (label, number)).collect();
            return Self { labels: distinct, lookup: Lookup::Hashed(map) };
        }
        let mut table = vec![0u32; span];
        for &label in labels {
            table[label as usize] = 1;
        }
        let mut distinct = Vec::new();
        for (entry, label) in table.iter_mut().zip(0u32..) {
            if *entry == 1 {
                *entry = distinct.len() as u32;
                distinct.push(label);
            }
        }
        Self { labels: distinct, lookup: Lookup::Direct(table) }
    }

    /// Number of distinct labels.
    pub(super) fn len(&self) -> usize {
        self.labels.len()
    }

    /// The number of a label that occurs.
    #[inline]
    fn number(&self, label: u32) -> u32 {
        match &self.lookup {
            Lookup::Direct(table) => table.get(label as usize).copied().unwrap_or(0),
            Lookup::Hashed(map) => map.get(&label).copied().unwrap_or(0),
        }
    }
}

/// Counts the overlaps of `labels` (rows) with `truth` (columns), one label per face; `areas` has one area per face, or
/// `None` for 1 each.
///
/// # Errors
/// [`Error::Parameter`] if the lengths differ.
pub fn contingency(labels: &[u32], truth: &[u32], areas: Option<&[f64]>) -> Result<Contingency> {
    let faces = areas.map_or(truth.len(), <[f64]>::len);
    check_count("labels", labels.len(), faces)?;
    check_count("truth", truth.len(), faces)?;
    Ok(count((labels, &LabelIndex::of(labels)), (truth, &LabelIndex::of(truth)), areas))
}

/// Rejects a labelling that does not have one label per face.
pub(super) fn check_count(name: &str, labels: usize, faces: usize) -> Result<()> {
    if labels == faces {
        return Ok(());
    }
    Err(Error::parameter(
        name,
        format!("{} for {}", counted(labels, "label"), counted(faces, "face")),
        "give one label per face, in the order of the mesh file",
    ))
}

/// [`contingency`] of labellings of equal length whose numbering is known.
pub(super) fn count(
    (labels, rows): (&[u32], &LabelIndex),
    (truth, columns): (&[u32], &LabelIndex),
    areas: Option<&[f64]>,
) -> Contingency {
    let width = columns.len() as u64;
    let keys =
        labels.iter().zip(truth).map(|(&a, &b)| u64::from(rows.number(a)) * width + u64::from(columns.number(b)));
    let size = rows.len().saturating_mul(columns.len());
    let dense = size <= DENSE_CELLS.max(labels.len());
    let tallies = match areas {
        Some(areas) => tally(dense.then_some(size), keys.zip(areas.iter().copied())),
        None => tally(dense.then_some(size), keys.zip(std::iter::repeat(1.))),
    };
    let mut table = Contingency {
        rows: rows.labels.iter().map(|&label| Marginal { label, faces: 0, area: 0. }).collect(),
        columns: columns.labels.iter().map(|&label| Marginal { label, faces: 0, area: 0. }).collect(),
        cells: Vec::with_capacity(tallies.len()),
        faces: labels.len() as u64,
        area: 0.,
        squares: areas.map_or(labels.len() as f64, |areas| areas.iter().map(|a| a * a).sum()),
    };
    for (key, (faces, area)) in tallies {
        let cell = Overlap { row: (key / width) as u32, column: (key % width) as u32, faces, area };
        for part in [&mut table.rows[cell.row as usize], &mut table.columns[cell.column as usize]] {
            part.faces += faces;
            part.area += area;
        }
        table.area += area;
        table.cells.push(cell);
    }
    table
}

/// Faces and area per key, ascending by key; through a dense table if its size is given, which all keys must be below.
fn tally(dense: Option<usize>, faces: impl Iterator<Item = (u64, f64)>) -> Vec<(u64, (u64, f64))> {
    if let Some(size) = dense {
        let mut table = vec![(0u64, 0f64); size];
        for (key, area) in faces {
            let cell = &mut table[key as usize];
            cell.0 += 1;
            cell.1 += area;
        }
        return (0u64..).zip(table).filter(|(_, cell)| cell.0 > 0).collect();
    }
    let mut map: HashMap<u64, (u64, f64)> = HashMap::new();
    for (key, area) in faces {
        let cell = map.entry(key).or_default();
        cell.0 += 1;
        cell.1 += area;
    }
    ascending(map)
}

fn ascending(map: HashMap<u64, (u64, f64)>) -> Vec<(u64, (u64, f64))> {
    let mut cells: Vec<_> = map.into_iter().collect();
    cells.sort_unstable_by_key(|(key, _)| *key);
    cells
}

/// 1 − Rand index over pairs of faces: the share of pairs for which the labellings disagree on whether they belong
/// together. Counted exactly, rounded once.
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

/// [`rand`] with each pair weighted by the product of its areas: independent of the tessellation, equal to [`rand`] if
/// all areas are equal.
pub fn rand_area(table: &Contingency) -> f64 {
    let apart = |cell: &Overlap| {
        let (row, column) = (&table.rows[cell.row as usize], &table.columns[cell.column as usize]);
        cell.area * ((row.area - cell.area) + (column.area - cell.area))
    };
    share(table.cells.iter().map(apart).sum(), table.area * table.area - table.squares)
}

/// The directional Hamming distances over the area, as missing rate and false-alarm rate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hamming {
    /// Area of truth parts outside the evaluated part that overlaps each most.
    pub missing: f64,
    /// Area of evaluated parts outside the truth part that overlaps each most.
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
    let outside = |parts: &[Marginal], covered: &[f64]| {
        share(parts.iter().zip(covered).map(|(part, covered)| part.area - covered).sum(), table.area)
    };
    Hamming { missing: outside(&table.columns, &columns), false_alarm: outside(&table.rows, &rows) }
}

/// The consistency errors, which tolerate that one labelling refines the other: everywhere in the same direction
/// (global), or in either direction at each face (local).
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

/// `part / whole`, at least 0; 0 if `whole` is 0.
fn share(part: f64, whole: f64) -> f64 {
    if whole > 0. { (part / whole).max(0.) } else { 0. }
}

/// Maximum number of parts on the smaller side for the exact method.
const EXACT: usize = 1000;
/// Maximum number of entries of the dense table of the exact method (64 MB).
const EXACT_ENTRIES: usize = 1 << 23;

/// Share of the area under the best one-to-one matching of parts; 1 for equal labellings, and for an empty one.
///
/// ```
/// use nystrom_stream::apps::evaluate::{contingency, matches};
/// let table = contingency(&[7, 3, 3, 3], &[0, 0, 1, 1], None)?;
/// assert_eq!(matches(&table), 0.75);
/// # Ok::<(), nystrom_stream::base::Error>(())
/// ```
pub fn matches(table: &Contingency) -> f64 {
    if table.area <= 0. {
        return 1.;
    }
    let (a, b) = (table.rows.len(), table.columns.len());
    let common = if a.min(b) <= EXACT && a.saturating_mul(b) <= EXACT_ENTRIES { best(table) } else { greedy(table) };
    (common / table.area).min(1.)
}

/// Greedy matching: the greatest overlaps first, each part once.
fn greedy(table: &Contingency) -> f64 {
    let order = order_by(table.cells.len(), |x, y| table.cells[y].area.total_cmp(&table.cells[x].area));
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

/// The greatest common area of any matching.
fn best(table: &Contingency) -> f64 {
    let flip = table.rows.len() > table.columns.len();
    let (a, b) = (table.rows.len().min(table.columns.len()), table.rows.len().max(table.columns.len()));
    let mut area = vec![0f64; a * b];
    for cell in &table.cells {
        let (row, column) = if flip { (cell.column, cell.row) } else { (cell.row, cell.column) };
        area[row as usize * b + column as usize] = cell.area;
    }
    let owners = least_assignment(a, b, |row, column| -area[row * b + column]).unwrap_or_default();
    owners.iter().enumerate().filter_map(|(column, owner)| owner.map(|row| area[row * b + column])).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn overlaps_are_counted_and_weighed() {
        let table = contingency(&[7, 7, 2, 2], &[0, 9, 9, 9], Some(&[1., 2., 3., 4.])).unwrap();
        let part = |label, faces, area| Marginal { label, faces, area };
        assert_eq!(table.rows, [part(2, 2, 7.), part(7, 2, 3.)]);
        assert_eq!(table.columns, [part(0, 1, 1.), part(9, 3, 9.)]);
        let cell = |row, column, faces, area| Overlap { row, column, faces, area };
        assert_eq!(table.cells, [cell(0, 1, 2, 7.), cell(1, 0, 1, 1.), cell(1, 1, 1, 2.)]);
        assert_eq!((table.faces, table.area, table.squares), (4, 10., 30.));
    }

    #[test]
    fn large_labels_and_many_parts_make_the_same_table() {
        let n = 3000u32;
        let small: Vec<u32> = (0..n).map(|f| f % 1500).collect();
        let large: Vec<u32> = small.iter().map(|l| u32::MAX - 1500 + l).collect();
        let truth: Vec<u32> = (0..n).map(|f| f % 2000).collect();
        let (a, b) = (contingency(&small, &truth, None).unwrap(), contingency(&large, &truth, None).unwrap());
        assert_eq!(a.cells, b.cells);
        assert_eq!(a.cells.iter().map(|cell| cell.faces).sum::<u64>(), u64::from(n));
        assert_eq!((a.rows.len(), a.columns.len()), (1500, 2000));
    }

    #[test]
    fn lengths_must_agree() {
        let error = contingency(&[1, 2], &[1, 2, 3], None).unwrap_err().to_string();
        assert_eq!(error, "labels: 2 labels for 3 faces; give one label per face, in the order of the mesh file");
        assert!(contingency(&[1], &[1], Some(&[1., 1.])).is_err());
        assert_eq!(contingency(&[], &[], None).unwrap().cells, []);
    }

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
