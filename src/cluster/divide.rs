//! More parts than cells: divides parts into pieces of faces.
//!
//! Parts are decided on some two thousand cells, so there can be no more of them. If more are requested, every cell is
//! a part, and the parts with most faces are divided further: each piece grows face by face along the graph, from the
//! first face without a piece to its share of the part's faces. Pieces are connected, except where other pieces leave
//! scattered faces. Beyond that they have no meaning: a surface has no two thousand natural parts.
//!
//! Cost: one pass over the faces and their neighbours on one thread; 8 bytes per face in files,
//! 16 bytes per part in memory.

use crate::base::Result;
use crate::graph::Csr;
use crate::store::{Context, MappedSlice};
use std::cmp::Reverse;
use std::collections::BinaryHeap;

const NONE: u32 = u32::MAX;
/// Faces between checks of the stop flag.
const STOP_CHECK: usize = 1 << 16;

/// Parts divided into pieces.
#[derive(Clone, Debug)]
pub struct Pieces {
    /// Piece of each node (n); the pieces of a part are numbered consecutively.
    pub labels: MappedSlice<u32>,
    /// First piece of each part, followed by the number of pieces (parts + 1).
    pub first: Vec<u32>,
}

impl Pieces {
    /// Number of pieces.
    pub fn count(&self) -> usize {
        self.first.last().map_or(0, |end| *end as usize)
    }
}

/// Divides the parts of `labels` (n) into `wanted` pieces in all, or one per node if there are fewer, in the array
/// `file`. The part `whole`, if given, is divided last.
///
/// # Errors
/// [`crate::base::Error::Io`], [`crate::base::Error::Cancelled`].
pub fn divide(
    graph: Csr<'_>,
    labels: &[u32],
    wanted: usize,
    whole: Option<u32>,
    file: &str,
    context: Context<'_>,
) -> Result<Pieces> {
    let n = labels.len();
    let parts = labels.iter().max().map_or(0, |top| *top as usize + 1);
    let mut faces = vec![0u64; parts];
    labels.iter().for_each(|&part| faces[part as usize] += 1);
    let pieces = shares(&faces, wanted, whole);
    let mut first = vec![0u32; parts + 1];
    (0..parts).for_each(|part| first[part + 1] = first[part] + pieces[part] as u32);
    // The piece that each part is filling, and the number of faces that it still takes.
    let room = |part: usize, piece: u64| {
        let end = |piece: u64| (u128::from(piece) * u128::from(faces[part]) / u128::from(pieces[part].max(1))) as u64;
        end(piece + 1) - end(piece)
    };
    let mut filling: Vec<(u64, u64)> = (0..parts).map(|part| (0, room(part, 0))).collect();
    let mut array = context.work.array::<u32>(file, &[n])?;
    let mut queue = context.work.array::<u32>("pieces.tmp", &[n])?;
    let (out, queue_slice) = (&mut array.data()[..], &mut queue.data()[..]);
    out.fill(NONE);
    for start in 0..n {
        if start % STOP_CHECK == 0 {
            context.run.cancel.check()?;
        }
        if out[start] != NONE {
            continue;
        }
        let part = labels[start] as usize;
        let (piece, mut left) = filling[part];
        let label = first[part] + piece as u32;
        let (mut head, mut end) = (0, 1);
        (queue_slice[0], out[start]) = (start as u32, label);
        left -= 1;
        while head < end && left > 0 {
            for (near, _) in graph.neighbours(queue_slice[head]) {
                if left > 0 && out[near as usize] == NONE && labels[near as usize] as usize == part {
                    (queue_slice[end], out[near as usize]) = (near, label);
                    (end, left) = (end + 1, left - 1);
                }
            }
            head += 1;
        }
        let is_full = left == 0 && piece + 1 < pieces[part];
        filling[part] = if is_full { (piece + 1, room(part, piece + 1)) } else { (piece, left) };
    }
    Ok(Pieces { labels: array.finish(false)?, first })
}

/// Number of pieces of each part, `wanted` in all if there are as many faces. One more piece goes to the part with most
/// faces per piece, repeatedly; to `whole` only when no other can be divided.
fn shares(faces: &[u64], wanted: usize, whole: Option<u32>) -> Vec<u64> {
    let mut pieces: Vec<u64> = faces.iter().map(|&faces| faces.min(1)).collect();
    // Faces per piece, in thousandths: integers have a total order.
    let rank = |part: usize, pieces: u64| (whole != Some(part as u32), faces[part] * 1000 / pieces, Reverse(part));
    let mut heap: BinaryHeap<_> = (0..faces.len()).filter(|&k| faces[k] > 1).map(|k| rank(k, 1)).collect();
    for _ in pieces.iter().sum::<u64>()..wanted as u64 {
        let Some((.., Reverse(part))) = heap.pop() else { break };
        pieces[part] += 1;
        if pieces[part] < faces[part] {
            heap.push(rank(part, pieces[part]));
        }
    }
    pieces
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::graph::OwnedRowStarts;
    use crate::store::{Run, WorkDir};

    /// A chain of `n` nodes, cut into pieces.
    fn chain(labels: &[u32], wanted: usize, whole: Option<u32>) -> (Vec<u32>, Vec<u32>) {
        let n = labels.len() as u32;
        let near = |i: u32| [i.checked_sub(1), Some(i + 1).filter(|&j| j < n)];
        let indices: Vec<u32> = (0..n).flat_map(|i| near(i).into_iter().flatten()).collect();
        let starts = OwnedRowStarts::of((0..n).map(|i| near(i).iter().flatten().count()));
        let weights = vec![1f32; indices.len()];
        let (run, work) = (Run::new(&()), WorkDir::temporary(&std::env::temp_dir()).unwrap());
        let graph = Csr::new(starts.view(), &indices, &weights);
        let pieces = divide(graph, labels, wanted, whole, "labels.npy", Context::new(&work, &run)).unwrap();
        (pieces.labels.to_vec(), pieces.first)
    }

    #[test]
    fn every_number_of_pieces_is_had_exactly() {
        // Two parts, one of them in two places.
        let labels: Vec<u32> = (0..60).map(|i| u32::from((10..45).contains(&i))).collect();
        for wanted in 2..=60 {
            let (pieces, first) = chain(&labels, wanted, None);
            let mut sizes = vec![0; wanted];
            pieces.iter().for_each(|&piece| sizes[piece as usize] += 1);
            assert!(sizes.iter().all(|size| *size > 0), "{wanted}: {sizes:?}");
            assert_eq!((first[0], first[2]), (0, wanted as u32));
            assert!(
                labels
                    .iter()
                    .zip(&pieces)
                    .all(|(&part, piece)| (first[part as usize]..first[part as usize + 1]).contains(piece))
            );
            // As even as the parts allow: no piece has more than two faces above its share of the larger part.
            assert!(sizes.iter().all(|size| *size <= 60 / wanted + 9), "{wanted}: {sizes:?}");
        }
        assert_eq!(chain(&labels, 90, None).1[2], 60, "no more than there are faces");
    }

    #[test]
    fn pieces_are_connected_where_they_can_be() {
        let (pieces, _) = chain(&[0; 64], 7, None);
        assert!(pieces.is_sorted(), "runs of a chain: {pieces:?}");
    }

    #[test]
    fn one_part_may_be_left_whole() {
        let labels: Vec<u32> = (0..60).map(|i| u32::from(i >= 20)).collect();
        let (pieces, first) = chain(&labels, 11, Some(1));
        assert_eq!(first, [0, 10, 11]);
        assert!(pieces[20..].iter().all(|&piece| piece == 10));
        assert_eq!(chain(&labels, 31, Some(1)).1, [0, 20, 31], "unless there is no other way");
    }
}
