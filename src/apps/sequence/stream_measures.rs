//! How well an order streams: the measures of *Streaming Meshes* (Isenburg, Lindstrom 2005), in our interpretation.
//!
//! A reader receives a vertex with the first face that uses it and releases it after the last: in between, it is
//! *active*. Faces are counted from 0 in their order, vertices as they become active.
//! - *front width*: number of active vertices while a face is read, including its own; what a reader holds.
//! - *vertex span*: faces from a vertex's first use to its last; how long a reader holds it.
//! - *face span*: difference between the greatest and the least vertex number of a face.
//! - *bandwidth*: the greatest difference along an edge; *profile*: the sum over vertices of the distance down to the
//!   least neighbour, as of the sparse matrix with that numbering.
//!
//! Cost: three passes, one thread; 8 bytes per vertex and 4 per face in mapped files.

use super::vertex_use::VertexUse;
use crate::base::Result;
use crate::mesh::Mesh;
use crate::store::{Context, Run};
use serde::Serialize;
use std::fmt::Write;

/// Items between checks of the stop flag.
const CHUNK: usize = 1 << 16;

/// The measures of an order; see the module documentation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct StreamMeasures {
    /// Largest front width, in vertices.
    pub largest_width: u64,
    /// Mean front width over faces.
    pub mean_width: f64,
    /// Largest vertex span, in faces.
    pub largest_vertex_span: u64,
    /// Mean vertex span over the vertices in use.
    pub mean_vertex_span: f64,
    /// Largest face span, in vertices.
    pub largest_face_span: u64,
    /// Mean face span.
    pub mean_face_span: f64,
    /// Bandwidth.
    pub bandwidth: u64,
    /// Profile.
    pub profile: u64,
}

impl StreamMeasures {
    /// Measures the order of `mesh`; `uses` gives the first and last use of each vertex.
    ///
    /// ```
    /// use nystrom_stream::apps::sequence::{StreamMeasures, VertexUse};
    /// use nystrom_stream::mesh::Mesh;
    /// use nystrom_stream::store::{Context, Run, WorkDir};
    /// let corners = [[0., 0., 0.], [1., 0., 0.], [1., 1., 0.], [0., 1., 0.]];
    /// let mesh = Mesh::from_slices(&corners, &[[0, 1, 2], [0, 2, 3]])?;
    /// let (work, run) = (WorkDir::temporary(&std::env::temp_dir())?, Run::new(&()));
    /// let context = Context::new(&work, &run);
    /// // The second face first.
    /// let uses = VertexUse::of(&mesh, &[1, 0], context)?;
    /// let measures = StreamMeasures::of(&mesh, &uses, context)?;
    /// assert_eq!((measures.largest_width, measures.largest_vertex_span), (3, 1));
    /// # Ok::<(), nystrom_stream::base::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`crate::base::Error::Io`], [`crate::base::Error::Cancelled`].
    pub fn of(mesh: &Mesh, uses: &VertexUse, context: Context<'_>) -> Result<Self> {
        let mut measures = Self::default();
        measures.spans(uses, context.run)?;
        measures.widths(mesh.faces.len(), uses, context)?;
        measures.numbers(mesh, uses, context)?;
        Ok(measures)
    }

    fn spans(&mut self, uses: &VertexUse, run: &Run) -> Result<()> {
        let (mut sum, mut count) = (0u64, 0u64);
        for (v, (&first, &last)) in uses.first.iter().zip(uses.last.iter()).enumerate() {
            if v % CHUNK == 0 {
                run.cancel.check()?;
            }
            if first != u32::MAX {
                let span = u64::from(last - first);
                self.largest_vertex_span = self.largest_vertex_span.max(span);
                (sum, count) = (sum + span, count + 1);
            }
        }
        self.mean_vertex_span = sum as f64 / count.max(1) as f64;
        Ok(())
    }

    fn widths(&mut self, faces: usize, uses: &VertexUse, context: Context<'_>) -> Result<()> {
        // Each face activates vertices and releases others: the change of the width after it, and the number released.
        let mut array = context.work.array::<u32>("front.tmp", &[2 * faces])?;
        let events = &mut array.data()[..];
        for (v, (&first, &last)) in uses.first.iter().zip(uses.last.iter()).enumerate() {
            if v % CHUNK == 0 {
                context.run.cancel.check()?;
            }
            if first != u32::MAX {
                events[2 * first as usize] += 1;
                events[2 * last as usize + 1] += 1;
            }
        }
        let (mut active, mut sum) = (0u64, 0u64);
        for pair in events.chunks_exact(2) {
            active += u64::from(pair[0]);
            self.largest_width = self.largest_width.max(active);
            sum += active;
            active -= u64::from(pair[1]);
        }
        self.mean_width = sum as f64 / faces.max(1) as f64;
        Ok(())
    }

    fn numbers(&mut self, mesh: &Mesh, uses: &VertexUse, context: Context<'_>) -> Result<()> {
        let (faces, rank) = (mesh.faces.len(), &uses.rank[..]);
        let mut array = context.work.array::<u32>("least.tmp", &[rank.len()])?;
        let least = &mut array.data()[..];
        least.copy_from_slice(rank);
        let mut sum = 0u64;
        for start in (0..faces).step_by(CHUNK) {
            context.run.cancel.check()?;
            mesh.faces.for_each(start..faces.min(start + CHUNK), |_, corners| {
                let (mut low, mut high) = (u32::MAX, 0);
                for (slot, &v) in corners.iter().enumerate() {
                    let (a, w) = (rank[v as usize], corners[(slot + 1) % corners.len()]);
                    let b = rank[w as usize];
                    (low, high) = (low.min(a), high.max(a));
                    self.bandwidth = self.bandwidth.max(u64::from(a.abs_diff(b)));
                    least[v as usize] = least[v as usize].min(b);
                    least[w as usize] = least[w as usize].min(a);
                }
                let span = u64::from(high.saturating_sub(low));
                self.largest_face_span = self.largest_face_span.max(span);
                sum += span;
            });
        }
        self.mean_face_span = sum as f64 / faces.max(1) as f64;
        self.profile = rank.iter().zip(least.iter()).map(|(&rank, &least)| u64::from(rank - least)).sum();
        Ok(())
    }
}

/// An order and its measures.
#[derive(Clone, Debug, Serialize)]
pub struct ComparedOrder {
    /// Its name.
    pub order: String,
    /// How well it streams.
    #[serde(flatten)]
    pub measures: StreamMeasures,
}

/// A table, one line per order.
pub fn table(orders: &[ComparedOrder]) -> String {
    let name = orders.iter().map(|one| one.order.chars().count()).max().unwrap_or(0).max(5);
    let mut out = format!(
        "{:name$}  {:>10} {:>10}  {:>10} {:>10}  {:>10} {:>10}  {:>10} {:>14}\n",
        "", "width", "", "vertex", "span", "face", "span", "", ""
    );
    let _ = writeln!(
        out,
        "{:name$}  {:>10} {:>10}  {:>10} {:>10}  {:>10} {:>10}  {:>10} {:>14}",
        "order", "largest", "mean", "largest", "mean", "largest", "mean", "bandwidth", "profile"
    );
    for ComparedOrder { order, measures: m } in orders {
        let _ = writeln!(
            out,
            "{order:name$}  {:>10} {:>10.1}  {:>10} {:>10.1}  {:>10} {:>10.1}  {:>10} {:>14}",
            m.largest_width,
            m.mean_width,
            m.largest_vertex_span,
            m.mean_vertex_span,
            m.largest_face_span,
            m.mean_face_span,
            m.bandwidth,
            m.profile
        );
    }
    out
}
