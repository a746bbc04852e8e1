//! Anchors of a map of the surface onto itself: cells whose images are known, with their distances to all cells.
//!
//! The nearest anchors determine where another cell goes: its image is as far from their images as the cell is from
//! them. The image of an anchor is an anchor too, so maps work in both directions. Cost: rows are shared between maps,
//! 8 kB each for 2,000 cells.

use super::cell_paths::{Row, UNREACHED};

/// Cells with known images, and the rows of both.
#[derive(Clone, Debug, Default)]
pub struct Anchors {
    /// The cell of each anchor.
    pub cell: Vec<u32>,
    /// Its distances to all cells.
    pub row: Vec<Row>,
    /// The number of the anchor that is its image.
    pub image: Vec<usize>,
}

impl Anchors {
    /// Adds two cells that are images of each other, or one that is its own.
    pub fn add(&mut self, [a, b]: [u32; 2], [from_a, from_b]: [&Row; 2]) {
        let at = self.cell.len();
        self.cell.push(a);
        self.row.push(from_a.clone());
        if a == b {
            self.image.push(at);
            return;
        }
        self.cell.push(b);
        self.row.push(from_b.clone());
        self.image.extend([at + 1, at]);
    }

    /// The distance to the nearest anchor.
    pub fn distance(&self, cell: u32) -> f32 {
        self.row.iter().map(|row| row[cell as usize]).fold(UNREACHED, f32::min)
    }

    /// The distances and numbers of the anchors nearest to a cell, except anchor `except` and its image.
    pub fn nearest(&self, cell: u32, count: usize, except: Option<usize>) -> Vec<(f32, usize)> {
        let others =
            (0..self.cell.len()).filter(|&k| except.is_none_or(|except| k != except && self.image[k] != except));
        let mut all: Vec<(f32, usize)> = others.map(|k| (self.row[k][cell as usize], k)).collect();
        let nearer = |a: &(f32, usize), b: &(f32, usize)| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1));
        if count < all.len() {
            all.select_nth_unstable_by(count, nearer);
            all.truncate(count);
        }
        all.sort_by(nearer);
        all
    }

    /// Mean difference between the distances of anchors and the distances of their images.
    pub fn error(&self) -> f64 {
        let all = 0..self.cell.len();
        let d = |a: usize, b: usize| self.row[a][self.cell[b] as usize];
        let differences = all
            .clone()
            .flat_map(|a| all.clone().map(move |b| f64::from((d(a, b) - d(self.image[a], self.image[b])).abs())));
        differences.sum::<f64>() / (self.cell.len().max(1) as f64).powi(2)
    }

    /// Mean distance between the images of this map's anchors and the positions that `other` predicts from its nearest
    /// anchors.
    pub fn apart(&self, other: &Anchors) -> f32 {
        let far = |(k, &cell): (usize, &u32)| {
            let (d, nearest) = other.nearest(cell, 1, None).first().copied().unwrap_or((UNREACHED, 0));
            (other.row[other.image[nearest]][self.cell[self.image[k]] as usize] - d).abs()
        };
        self.cell.iter().enumerate().map(far).sum::<f32>() / self.cell.len().max(1) as f32
    }
}
