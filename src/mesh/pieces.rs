//! Records of any size brought to their places by an external sort.
//!
//! A record is cut into pieces of [`PIECE`] bytes, each with its record's place and its own number, so that the sort sees
//! items of one size. 24 B a piece, written and read once where memory does not hold them.

use super::output::Gather;
use crate::base::Result;
use crate::base::parallel::in_order;
use crate::store::Context;
use crate::store::shuffle::BudgetedShuffle;
use crate::store::shuffle::Producer;

/// Bytes of a record in a piece.
const PIECE: usize = 16;

/// Place, number of the piece · 32 + bytes, and the bytes.
type Piece = [u32; 2 + PIECE / 4];

/// Where records go as they are made: number and bytes.
pub(super) type Push<'a> = &'a mut dyn FnMut(usize, &[u8]) -> Result<()>;

/// Has `produce` make records, about `bytes` in all, record r of place `places[r]`, and writes them by place.
pub(super) fn sorted(
    places: &[u32],
    bytes: usize,
    out: &mut Gather,
    Context { work, run }: Context<'_>,
    produce: impl FnOnce(Push<'_>) -> Result<()>,
) -> Result<()> {
    let n = places.len().max(1);
    // A bucket waits as its bytes, four a thread, while one is sorted.
    let (pieces, copies) = ((bytes / PIECE + n) as u64, 6 * run.threads as u64);
    let sized = BudgetedShuffle::<Piece>::new(&work.file("pieces.tmp"), "records", pieces, copies, 1, run)?;
    let shuffle = &sized.shuffle;
    let mut producer: Producer<'_, Piece> = shuffle.producer();
    produce(&mut |record, bytes| {
        let place = places[record];
        let bucket = (u64::from(place) * shuffle.buckets() as u64 / n as u64) as usize;
        for (k, part) in bytes.chunks(PIECE).enumerate() {
            let mut piece: Piece = [0; 2 + PIECE / 4];
            piece[..2].copy_from_slice(&[place, (k as u32) << 5 | part.len() as u32]);
            bytemuck::cast_slice_mut::<u32, u8>(&mut piece[2..])[..part.len()].copy_from_slice(part);
            producer.push(bucket, piece)?;
        }
        Ok(())
    })?;
    producer.finish()?;
    let sort = |bucket: usize, (): &mut ()| {
        let mut pieces = shuffle.take(bucket)?;
        pieces.sort_unstable_by_key(|piece| (piece[0], piece[1]));
        let mut bytes = Vec::with_capacity(PIECE * pieces.len());
        for piece in &pieces {
            bytes.extend_from_slice(&bytemuck::cast_slice::<u32, u8>(&piece[2..])[..piece[1] as usize & 31]);
        }
        Ok(bytes)
    };
    in_order(run.threads, &run.cancel, shuffle.buckets(), || (), sort, |_, bytes| out.pass(&bytes))
}
