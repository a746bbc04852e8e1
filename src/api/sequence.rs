//! Finds an order for streaming a mesh, such that a reader holds few vertices at a time.

use super::mesh::{admitted, checked};
use super::run::{RunOptions, run_options, work_options};
use crate::apps::sequence::{SequenceOrder, StreamMeasures};
use crate::base::{Error, Result};
use crate::mesh::ply::rearranged::{self, Rearrangement};
use crate::mesh::{Mesh, PlyForm, ends_with};
use crate::pipeline::sequence::{self as recipe, SequenceParams};
use crate::store::npy;
use std::path::Path;

/// Orders the faces of meshes for streaming.
///
/// ```
/// # fn main() -> nystrom_stream::Result<()> {
/// use nystrom_stream::{Mesh, Sequencer};
/// let mesh = Mesh::creature(2_000)?;
/// let sequence = Sequencer::new().run(&mesh)?;
/// assert_eq!(sequence.places().len(), mesh.faces.len());
/// assert!(sequence.measures().mean_width < 0.2 * mesh.positions.len() as f64);
/// # Ok(())
/// # }
/// ```
#[derive(Clone, Debug, Default)]
pub struct Sequencer {
    params: SequenceParams,
    pub(super) options: RunOptions,
}

run_options!(Sequencer);
work_options!(Sequencer);

impl Sequencer {
    /// The spectral order with 10 landmarks.
    pub fn new() -> Self {
        Self::default()
    }

    /// The criterion of the order.
    #[must_use]
    pub fn order(mut self, order: SequenceOrder) -> Self {
        self.params.order = order;
        self
    }

    /// Number of sweeps over all vertices that improve spectral coordinates; none by default. Other orders ignore it.
    #[must_use]
    pub fn sweeps(mut self, sweeps: usize) -> Self {
        self.params.sweeps = sweeps;
        self
    }

    /// The number of landmarks of spectral orders, 3 to 4096; by default 10. Other orders ignore it.
    #[must_use]
    pub fn landmarks(mut self, count: usize) -> Self {
        self.params.landmarks = Some(count);
        self
    }

    /// Orders `mesh`.
    ///
    /// # Errors
    /// [`crate::Error::Parameter`] for landmarks out of range, [`crate::Error::WorkDir`], [`crate::Error::Memory`],
    /// [`crate::Error::Io`], [`crate::Error::Cancelled`].
    pub fn run(&self, mesh: &Mesh) -> Result<Sequence> {
        self.options.with(|context, _| {
            checked(mesh)?;
            let identity = admitted(mesh, self.options.force, context)?;
            let sequencer = recipe::Sequencer::new(mesh, &identity, context)?;
            let order = sequencer.sequence(&self.params)?;
            let measures = sequencer.measures(&order)?;
            Ok(Sequence { mesh: mesh.clone(), order, measures, options: self.options.afterwards() })
        })
    }
}

/// An order of the faces of a mesh, and of its vertices by first use.
#[derive(Clone, Debug)]
pub struct Sequence {
    mesh: Mesh,
    order: recipe::Sequence,
    measures: StreamMeasures,
    options: RunOptions,
}

impl Sequence {
    /// The position of each face in the new order, from 0 (faces).
    pub fn places(&self) -> &[u32] {
        &self.order.places
    }

    /// The new number of each vertex, from 0 (vertices).
    pub fn vertex_numbers(&self) -> &[u32] {
        &self.order.uses.rank
    }

    /// How well the order streams.
    pub fn measures(&self) -> &StreamMeasures {
        &self.measures
    }

    /// Writes the mesh file in its new order as `.ply`, or [`Sequence::places`] as `.npy`.
    ///
    /// # Errors
    /// [`crate::Error::Parameter`] for another file extension; [`crate::Error::Unusable`] for a `.ply` of a mesh from
    /// arrays, which has no file; [`crate::Error::Memory`], [`crate::Error::Io`].
    pub fn save(&self, path: impl AsRef<Path>) -> Result<()> {
        let path = path.as_ref();
        if ends_with(path, "npy") {
            return npy::write(path, &self.order.places, 1, true).map(drop);
        }
        if !ends_with(path, "ply") {
            return Err(Error::extension("path", path, "use .ply or .npy"));
        }
        let order = Rearrangement { places: &self.order.places, numbers: &self.order.uses.rank, original: false };
        self.options.with(|context, _| rearranged::write(&self.mesh, path, &order, PlyForm::Same, context))
    }
}
