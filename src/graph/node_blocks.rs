//! Blocks of consecutive nodes, and the vertices shared by several blocks.
//!
//! In a good order nearly all neighbours of a face are close to it in number. Half-edges are then matched block by
//! block in place, in a processor's cache, and only those between two vertices that several blocks use, a few in a
//! hundred, have to be brought together from all over the mesh. The only data of the size of the mesh are two bytes per
//! vertex: the block that uses it. If faces are scattered, most vertices belong to several blocks; such a mesh is not
//! divided.
//!
//! Cost: one pass over the faces on one thread, about 5 ns per face, in parallel with the pass that computes node
//! geometry.

use super::nodes::CHUNK;
use crate::base::Result;
use crate::mesh::Mesh;
use crate::store::{Context, MappedSlice, WorkDir};
use std::ops::Range;

/// Corners per block where there is room: including the memory for sorting, they fit a core's cache.
const CORNERS: u64 = 3 << 15;
/// Bytes per corner and thread while a block is matched: half-edges far apart, sorted, counts, and matches.
const PER_CORNER: u64 = 12 + 12 + 16 + 8;
/// Marks a vertex used by several blocks.
const SEVERAL: u16 = u16::MAX;
/// The file of the blocks that use each vertex.
const FILE: &str = "vertex_blocks.tmp";

/// Corners per block for a mesh of `corners` corners, if matching may use `room` bytes on each of `threads` threads. Up
/// to four finished blocks per thread also wait as rows.
pub(super) fn corners_a_block(corners: u64, threads: u64, room: u64) -> u64 {
    // Blocks are numbered in 16 bits.
    let least = corners.div_ceil(u64::from(SEVERAL) - 2).max(3 << 10);
    (room / threads.max(1).saturating_mul(PER_CORNER + 4 * 12)).clamp(least, CORNERS.max(least))
}

/// Bytes needed for matching blocks of `corners` corners.
pub(super) fn bytes(corners: u64, threads: u64) -> u64 {
    PER_CORNER * corners * threads
}

/// Blocks of nodes.
pub(super) struct NodeBlocks<'a> {
    nodes: usize,
    /// Nodes per block.
    size: usize,
    /// Corners per block, approximately.
    corners: usize,
    /// The block of each vertex, from 1 on, or [`SEVERAL`]; `None` if there is only one block.
    block_of: Option<MappedSlice<u16>>,
    shared: u64,
    work: &'a WorkDir,
}

impl<'a> NodeBlocks<'a> {
    /// The blocks of `mesh`; `None` if more than half of the vertices are shared by several.
    ///
    /// # Errors
    /// [`crate::base::Error::Io`], [`crate::base::Error::Cancelled`].
    pub fn of(mesh: &Mesh, context: Context<'a>) -> Result<Option<Self>> {
        let Context { work, run } = context;
        let (nodes, all) = (mesh.faces.len(), mesh.faces.corner_count() as u64);
        let corners = corners_a_block(all, run.threads as u64, run.budget.left() / 4);
        let mut size = ((corners as u128 * nodes as u128 / u128::from(all.max(1))) as usize).max(1);
        // Whole chunks of nodes, unless that makes too many blocks.
        let whole = size / CHUNK * CHUNK;
        if whole > 0 && nodes.div_ceil(whole) < usize::from(SEVERAL) {
            size = whole;
        }
        let mut blocks = Self { nodes, size, corners: corners as usize, block_of: None, shared: 0, work };
        if blocks.len() >= usize::from(SEVERAL) {
            return Ok(None);
        }
        if blocks.len() > 1 {
            let vertices = mesh.positions.len();
            let mut array = work.array::<u16>(FILE, &[vertices])?;
            let block_of = &mut array.data()[..];
            let (mut used, mut shared) = (0u64, 0u64);
            for block in 0..blocks.len() {
                run.cancel.check()?;
                let own = block as u16 + 1;
                mesh.faces.for_each(blocks.nodes_of(block), |_, corners| {
                    for &v in corners {
                        let of = &mut block_of[v as usize];
                        if *of != own {
                            used += u64::from(*of == 0);
                            shared += u64::from(*of != 0 && *of != SEVERAL);
                            *of = if *of == 0 { own } else { SEVERAL };
                        }
                    }
                });
                // A bad order is recognised early.
                if block % 64 == 63 && 4 * shared > 3 * used {
                    break;
                }
            }
            blocks.block_of = Some(array.finish(false)?);
            blocks.shared = shared;
            if 2 * shared > used {
                return Ok(None);
            }
        }
        Ok(Some(blocks))
    }

    /// Number of blocks.
    pub fn len(&self) -> usize {
        self.nodes.div_ceil(self.size)
    }

    /// Corners per block, approximately.
    pub fn corners(&self) -> usize {
        self.corners
    }

    /// Estimated upper bound on the number of half-edges between two shared vertices.
    pub fn shared_half_edges(&self) -> u64 {
        6 * self.shared
    }

    /// The nodes of a block.
    pub fn nodes_of(&self, block: usize) -> Range<usize> {
        block * self.size..((block + 1) * self.size).min(self.nodes)
    }

    /// The vertices shared by several blocks; `None` if there is only one block.
    pub fn shared(&self) -> Option<SharedVertices<'_>> {
        self.block_of.as_ref().map(|of| SharedVertices(of))
    }
}

/// The vertices shared by several blocks.
#[derive(Clone, Copy)]
pub(super) struct SharedVertices<'a>(&'a [u16]);

impl SharedVertices<'_> {
    /// Whether `v` is one of them.
    #[inline(always)]
    pub fn has(self, v: u32) -> bool {
        self.0[v as usize] == SEVERAL
    }
}

impl Drop for NodeBlocks<'_> {
    fn drop(&mut self) {
        if self.block_of.take().is_some() {
            self.work.remove(FILE);
        }
    }
}

impl std::fmt::Debug for NodeBlocks<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} blocks of {} nodes", self.len(), self.size)
    }
}
