//! How two labellings of the same faces overlap: the table that all region metrics are read from.
//!
//! Labels may be any `u32`: they are numbered by ascending value first. Cost: two passes over each
//! labelling, about 5 ns a face; memory a table of parts × parts, or a hash map of the cells that
//! occur where that table would be larger than the labels (then 200 ns a face).

use crate::base::{Error, Result};
use std::collections::HashMap;

/// Tables up to this many cells (16 MB), or as many as there are faces, are kept dense.
const DENSE_CELLS: usize = 1 << 20;

/// A part of a labelling: the faces that carry one label.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Part {
    /// Its label as given.
    pub label: u32,
    /// Number of its faces, at least 1.
    pub faces: u64,
    /// Their area, in squared units of the mesh.
    pub area: f64,
}

/// The overlap of a part of the one labelling with a part of the other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cell {
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
    /// Parts of the judged labelling, by ascending label. Their areas are the sums of their cells'.
    pub rows: Vec<Part>,
    /// Parts of the truth, by ascending label. Their areas are the sums of their cells'.
    pub columns: Vec<Part>,
    /// The overlaps that occur, by row, then column.
    pub cells: Vec<Cell>,
    /// Number of faces.
    pub faces: u64,
    /// Area of all faces.
    pub area: f64,
    /// Sum of the squared areas of single faces (what pairs of a face with itself would weigh).
    pub squares: f64,
}

/// Labels numbered from 0 by ascending value.
#[derive(Clone, Debug)]
pub(super) struct Numbering {
    labels: Vec<u32>,
    lookup: Lookup,
}

#[derive(Clone, Debug)]
enum Lookup {
    /// Number by label, for labels that are small.
    Direct(Vec<u32>),
    /// Number by label, for any.
    Hashed(HashMap<u32, u32>),
}

impl Numbering {
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

/// Counts the overlaps of `labels` (rows) with `truth` (columns), a label a face; `areas` an area
/// a face, 1 each where absent.
///
/// # Errors
/// [`Error::Parameter`] where the lengths differ.
pub fn contingency(labels: &[u32], truth: &[u32], areas: Option<&[f64]>) -> Result<Contingency> {
    let faces = areas.map_or(truth.len(), <[f64]>::len);
    check_count("labels", labels.len(), faces)?;
    check_count("truth", truth.len(), faces)?;
    Ok(count((labels, &Numbering::of(labels)), (truth, &Numbering::of(truth)), areas))
}

/// Refuses a labelling that is not one label a face.
pub(super) fn check_count(name: &str, labels: usize, faces: usize) -> Result<()> {
    if labels == faces {
        return Ok(());
    }
    Err(Error::parameter(
        name,
        format!("{labels} labels for {faces} faces"),
        "give one label a face, in the order of the mesh file",
    ))
}

/// [`contingency`] of labellings of equal length whose numbering is known.
pub(super) fn count(
    (labels, rows): (&[u32], &Numbering),
    (truth, columns): (&[u32], &Numbering),
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
        rows: rows.labels.iter().map(|&label| Part { label, faces: 0, area: 0. }).collect(),
        columns: columns.labels.iter().map(|&label| Part { label, faces: 0, area: 0. }).collect(),
        cells: Vec::with_capacity(tallies.len()),
        faces: labels.len() as u64,
        area: 0.,
        squares: areas.map_or(labels.len() as f64, |areas| areas.iter().map(|a| a * a).sum()),
    };
    for (key, (faces, area)) in tallies {
        let cell = Cell { row: (key / width) as u32, column: (key % width) as u32, faces, area };
        for part in [&mut table.rows[cell.row as usize], &mut table.columns[cell.column as usize]] {
            part.faces += faces;
            part.area += area;
        }
        table.area += area;
        table.cells.push(cell);
    }
    table
}

/// Faces and area a key, ascending by key; through a table where its size is given, which all keys
/// are below.
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
    let mut cells: Vec<_> = map.into_iter().collect();
    cells.sort_unstable_by_key(|(key, _)| *key);
    cells
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn overlaps_are_counted_and_weighed() {
        let table = contingency(&[7, 7, 2, 2], &[0, 9, 9, 9], Some(&[1., 2., 3., 4.])).unwrap();
        let part = |label, faces, area| Part { label, faces, area };
        assert_eq!(table.rows, [part(2, 2, 7.), part(7, 2, 3.)]);
        assert_eq!(table.columns, [part(0, 1, 1.), part(9, 3, 9.)]);
        let cell = |row, column, faces, area| Cell { row, column, faces, area };
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
        assert_eq!(error, "labels: 2 labels for 3 faces; give one label a face, in the order of the mesh file");
        assert!(contingency(&[1], &[1], Some(&[1., 1.])).is_err());
        assert_eq!(contingency(&[], &[], None).unwrap().cells, []);
    }
}
