//! Embeddings of the study: three extrapolations, three scalings, as linear maps of a column of `[A B]`.
//!
//! - [`Extrapolation::Plain`]: eq. 1–2, ȳ_j = Λ⁻¹ Uᵀ B_j on the kept eigenpairs of A.
//! - [`Extrapolation::Kpca`]: the features of kernel PCA, eq. 4, ỹ_j = Λ^-½ Uᵀ B_j: eq. 2 times λ^½.
//! - [`Extrapolation::Orthogonal`]: one-shot orthogonalisation. With F = WᵣᵀUΛ^-½ over all nodes and node weights m
//!   (areas, or 1), M = Fᵀ diag(m) F = QμQᵀ, E = FQ: μ and E are the exact eigenpairs of the approximated W̄ = FFᵀ in
//!   the inner product of m. Plain vectors are not orthogonal beyond the sample, and stop converging near l = 50.
//!   Needs small eigenvalues damped ([`Kept::damped`]): with all of them it is worse than plain.
//!
//! Cost: a pass over the columns for [`Extrapolation::Orthogonal`], O(n l r); O(l d) a node to embed.

use super::block::{Block, CHUNK};
use super::measures::Kept;
use crate::base::parallel::{chunk_count, chunk_range, in_order};
use crate::base::{Result, eigen};
use crate::store::Run;
use nalgebra::{DMatrix, DMatrixView};

/// How coordinates are extended from the sample.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Extrapolation {
    /// Eq. 1–2.
    #[default]
    Plain,
    /// Eq. 4.
    Kpca,
    /// Orthogonalised over all nodes.
    Orthogonal,
}

/// What eigenvectors are multiplied by, beside what the extrapolation does. For [`Extrapolation::Kpca`] the features
/// count as they are: [`Scaling::None`] is eq. 4.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Scaling {
    /// λ^½: distances in the embedding are those of the feature space.
    Root,
    /// λ^-½.
    InverseRoot,
    /// Nothing.
    #[default]
    None,
}

impl Scaling {
    fn of(self, value: f64) -> f64 {
        match self {
            Self::Root => value.sqrt(),
            Self::InverseRoot => 1. / value.sqrt(),
            Self::None => 1.,
        }
    }
}

/// A fitted embedding: y_j = mapᵀ B_j.
#[derive(Clone, Debug)]
pub struct Extension {
    /// l × d.
    pub map: DMatrix<f64>,
    /// The eigenvalues of the d coordinates, descending: of A, or of the approximated W̄.
    pub values: Vec<f64>,
    /// Eigenpairs of A that were dropped, or damped to less than half.
    pub dropped: usize,
}

/// The weight of a node, by its number.
pub type Weigh<'a> = &'a (dyn Fn(usize) -> f64 + Sync);

impl Extension {
    /// Fits at most `d` coordinates on `block`. `weights` are the nodes' for [`Extrapolation::Orthogonal`], 1 where
    /// not given; `tolerance`: see [`Kept::of`] and [`Kept::damped`].
    ///
    /// # Errors
    /// [`crate::base::Error::Cancelled`].
    pub fn fit(
        block: &dyn Block,
        how: Extrapolation,
        scaling: Scaling,
        d: usize,
        weights: Option<Weigh<'_>>,
        tolerance: f64,
        run: &Run,
    ) -> Result<Self> {
        let kept = Kept::of(block.sampled(), tolerance);
        let dropped = kept.dropped();
        let (mut map, values) = match how {
            Extrapolation::Plain | Extrapolation::Kpca => (kept.roots(), kept.values),
            Extrapolation::Orthogonal => {
                let roots = Kept::damped(block.sampled(), tolerance);
                let (values, q) = eigen::symmetric(moments(block, &roots, weights, run)?);
                (roots * q, values)
            }
        };
        let d = d.min(values.len());
        map = map.columns(0, d).into_owned();
        for (mut column, &value) in map.column_iter_mut().zip(&values) {
            let value = value.max(1e-300);
            // The map so far is that of coordinates times λ^½.
            let features = if how == Extrapolation::Kpca { 1. } else { 1. / value.sqrt() };
            column *= features * scaling.of(value);
        }
        Ok(Self { map, values: values[..d].to_vec(), dropped })
    }

    /// Coordinates of all nodes (n × d): for sets that fit in memory.
    pub fn embed(&self, block: &dyn Block) -> DMatrix<f64> {
        let (n, d) = (block.nodes(), self.map.ncols());
        let mut out = DMatrix::zeros(n, d);
        for k in 0..chunk_count(n, CHUNK) {
            let range = chunk_range(n, CHUNK, k);
            out.rows_mut(range.start, range.len()).copy_from(&self.chunk(block, range));
        }
        out
    }

    /// Coordinates of the nodes in `range` (m × d).
    pub fn chunk(&self, block: &dyn Block, range: std::ops::Range<usize>) -> DMatrix<f64> {
        let mut columns = vec![0.; block.len() * range.len()];
        block.columns(range.clone(), &mut columns);
        let mut y = DMatrix::from_vec(range.len(), block.len(), columns) * &self.map;
        if let Some(scale) = block.scale(range) {
            for (mut row, scale) in y.row_iter_mut().zip(scale) {
                row *= scale;
            }
        }
        y
    }
}

/// M = Fᵀ diag(m) F, F = Wᵣᵀ `map` (r × r), for a map of l × r.
///
/// # Errors
/// [`crate::base::Error::Cancelled`].
pub fn moments(block: &dyn Block, map: &DMatrix<f64>, weights: Option<Weigh<'_>>, run: &Run) -> Result<DMatrix<f64>> {
    let (l, n, r) = (block.len(), block.nodes(), map.ncols());
    let chunk = |k: usize, columns: &mut Vec<f64>| {
        let range = chunk_range(n, CHUNK, k);
        columns.resize(l * range.len(), 0.);
        block.columns(range.clone(), columns);
        let f = DMatrixView::from_slice(columns, range.len(), l) * map;
        let mut weighted = f.clone();
        if let Some(weight) = weights {
            for (mut row, node) in weighted.row_iter_mut().zip(range) {
                row *= weight(node);
            }
        }
        Ok(f.tr_mul(&weighted))
    };
    let mut sum = DMatrix::zeros(r, r);
    in_order(run.threads, &run.cancel, chunk_count(n, CHUNK), Vec::new, chunk, |_, part| {
        sum += part;
        Ok(())
    })?;
    Ok(sum)
}
