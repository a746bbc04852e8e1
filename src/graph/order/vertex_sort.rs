//! Sorts vertices along the curve: an external sort that carries the positions with it.
//!
//! A record is an array of 32-bit words (position on the curve, old number, bits of the coordinates), so its
//! lexicographic order is the order wanted, total even if vertices coincide. Writes the positions in curve order
//! (`curve_vertices.npy`) and each old vertex's new number (`vertex_rank.tmp`). Disk: 24 B per vertex of 32-bit
//! coordinates (36 B of 64-bit ones), written and read once where memory does not hold them.

use super::hilbert::place_of;
use crate::base::Result;
use crate::base::parallel::{chunk_count, chunk_range};
use crate::graph::frame::Frame;
use crate::mesh::{Positions, StridedLayout};
use crate::store::npy::{ArrayMut, ArrayWriter, Item};
use crate::store::shuffle::{BudgetedShuffle, Producer, RangeBuckets, Splitters};
use crate::store::{Context, MappedSlice, WorkDir};

/// The sorted positions.
pub(super) const VERTICES: &str = "curve_vertices.npy";
const CHUNK: usize = 1 << 14;

/// Opens the sorted positions of an earlier run; `double` as in the input.
pub(super) fn open(work: &WorkDir, double: bool, len: usize) -> Result<Positions> {
    let (bytes, start) = work.array_bytes(VERTICES)?;
    Positions::strided(&work.place(VERTICES), bytes, StridedLayout::packed(start, double, len))
}

/// Sorts the vertices along the curve; returns the new number of each old one. If these fit memory (`in_memory`) they
/// are scattered, else shuffled.
pub(super) fn sort(
    positions: &Positions,
    frame: &Frame,
    in_memory: bool,
    context: Context<'_>,
) -> Result<MappedSlice<u32>> {
    let job = VertexSort { positions, frame, in_memory, context };
    if positions.is_double() {
        job.sort::<f64, 9>(|x, words| {
            words.copy_from_slice(&[x.to_bits() as u32, (x.to_bits() >> 32) as u32]);
        })
    } else {
        job.sort::<f32, 6>(|x, words| words[0] = (x as f32).to_bits())
    }
}

struct VertexSort<'a> {
    positions: &'a Positions,
    frame: &'a Frame,
    in_memory: bool,
    context: Context<'a>,
}

impl VertexSort<'_> {
    fn key(&self, vertex: usize) -> ([u32; 3], [f64; 3]) {
        let position = self.positions.get(vertex as u32);
        let place = place_of(self.frame.place(position));
        ([(place >> 32) as u32, place as u32, vertex as u32], position)
    }

    /// Sorts records of W words, which include coordinates of type `T` as `words` encodes them; returns the ranks.
    fn sort<T: Item, const W: usize>(&self, words: impl Fn(f64, &mut [u32]) + Sync) -> Result<MappedSlice<u32>> {
        let (n, Context { work, run }) = (self.positions.len(), self.context);
        // Sorted buckets wait for the writer: `in_order` holds four per thread, and one is being sorted.
        let copies = 6 * run.threads as u64;
        let sorting =
            BudgetedShuffle::<[u32; W]>::new(work.spill("vertices.tmp"), "sorting vertices", n as u64, copies, 2, run)?;
        let shuffle = &sorting.shuffle;
        let step = (n / (shuffle.buckets() * Splitters::<3>::SAMPLES)).max(1);
        let splitters = Splitters::new((0..n).step_by(step).map(|v| self.key(v).0).collect(), shuffle.buckets());
        run.each_chunk(
            chunk_count(n, CHUNK),
            || shuffle.producer(),
            |k, out| {
                for v in chunk_range(n, CHUNK, k) {
                    let (key, at) = self.key(v);
                    let mut record = [0u32; W];
                    record[..3].copy_from_slice(&key);
                    for (coordinate, slot) in at.into_iter().zip(record[3..].chunks_exact_mut((W - 3) / 3)) {
                        words(coordinate, slot);
                    }
                    out.push(splitters.bucket(key), record)?;
                }
                Ok(())
            },
            Producer::finish,
        )?;
        let mut writer: ArrayWriter<T> = work.writer(VERTICES, 3)?;
        let mut array: ArrayMut<u32> = work.array("vertex_rank.tmp", &[n])?;
        let ranks = &mut array.data()[..];
        let pairs = match self.in_memory {
            true => None,
            false => Some(BudgetedShuffle::<[u32; 2]>::new(
                work.spill("ranks.tmp"),
                "ranking vertices",
                n as u64,
                1,
                2,
                run,
            )?),
        };
        let mut out = pairs.as_ref().map(|pairs| pairs.shuffle.producer());
        let buckets = pairs.as_ref().map_or(1, |pairs| pairs.shuffle.buckets());
        let by_vertex = RangeBuckets::new(n, buckets);
        let mut block: Vec<u32> = Vec::with_capacity(CHUNK * (W - 3));
        let mut next = 0u32;
        shuffle.sorted(run, |records| {
            for part in records.chunks(CHUNK) {
                block.clear();
                part.iter().for_each(|record| block.extend_from_slice(&record[3..]));
                writer.push_bytes(bytemuck::cast_slice(&block))?;
                for record in part {
                    let old = record[2];
                    match &mut out {
                        Some(out) => out.push(by_vertex.bucket_of(old), [old, next])?,
                        None => ranks[old as usize] = next,
                    }
                    next += 1;
                }
            }
            Ok(())
        })?;
        writer.finish(false)?;
        if let (Some(out), Some(pairs)) = (out, &pairs) {
            out.finish()?;
            for bucket in 0..buckets {
                run.cancel.check()?;
                pairs.shuffle.take(bucket)?.into_iter().for_each(|[old, new]| ranks[old as usize] = new);
            }
        }
        array.finish(false)
    }
}
