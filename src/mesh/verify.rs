//! Checks a binary file of triangles where it lies: every count is 3, every index in range.
//!
//! One parallel pass at the speed of memory, about 1 ns a face; nothing is written. After it the
//! faces may be read straight from the mapping.

use super::cursor::Cursor;
use super::decode::Task;
use super::model::{Element, Encoding, Kind, Scalar};
use super::surface::Faces;
use crate::base::Result;
use crate::base::parallel::map_ranges;
use crate::store::Run;

/// Faces that a thread takes at a time.
const CHUNK: usize = 1 << 16;
/// Faces after which the verdict is looked at; a branch a face would double the time.
const BLOCK: usize = 256;

impl<'a> Task<'a> {
    /// The fast path: little-endian triangles with 4-byte indices, verified where they lie.
    pub(super) fn triangles_in_place<C: Cursor<'a>>(
        &self,
        cursor: &mut C,
        element: &Element,
    ) -> Result<Option<(Faces, Option<usize>)>> {
        let before = element.properties[..self.list].iter();
        let after = element.properties[self.list + 1..].iter();
        let scalars = before.clone().chain(after).all(|property| matches!(property.kind, Kind::One(_)));
        let (Kind::List { count, item: item @ (Scalar::I32 | Scalar::U32) }, Encoding::Little, true, false) =
            (element.properties[self.list].kind, self.header.encoding, scalars, self.strips)
        else {
            return Ok(None);
        };
        let layout = Layout {
            stride: element.least_size() + 12,
            at: before.map(|property| property.kind.least_size()).sum(),
            count: count.size(),
        };
        let start = cursor.at();
        let end = element.count.checked_mul(layout.stride).and_then(|bytes| bytes.checked_add(start));
        let Some(records) = end.and_then(|end| self.bytes.get(start..end)) else { return Ok(None) };
        let most = if item == Scalar::I32 { 1 << 31 } else { u32::MAX };
        let limit = u32::try_from(self.header.elements[self.vertex].count).unwrap_or(u32::MAX).min(most);
        if let Some(odd) = first_odd(self.run, records, layout, limit)? {
            let mut list = C::new(self.bytes, start + odd * layout.stride + layout.at);
            let size = list.length(count).map_err(|fault| self.error(element, odd, fault))?;
            // Another polygon: from here on the records lie elsewhere, so what looked odd may be right.
            if size != 3 {
                return Ok(None);
            }
            for _ in 0..3 {
                let vertex = list.integer(item).map_err(|fault| self.error(element, odd, fault))?;
                if vertex < 0 || vertex >= i64::from(limit) {
                    return Err(self.out_of_range(element, odd, vertex));
                }
            }
            return Ok(None);
        }
        *cursor = C::new(self.bytes, start + records.len());
        let first = start + layout.at + layout.count;
        let faces = Faces::triangles(self.path, self.bytes.clone(), first, layout.stride, element.count)?;
        Ok(Some((faces, Some(layout.stride))))
    }
}

/// Where triangles of equal size lie.
#[derive(Clone, Copy, Debug)]
struct Layout {
    /// Bytes from record to record.
    stride: usize,
    /// Bytes from a record's start to the list's count.
    at: usize,
    /// Bytes of the count: 1, 2 or 4; the indices are 4 bytes each.
    count: usize,
}

/// The first record of `records` whose count is not 3 or that has an index not below `limit`.
///
/// # Errors
/// [`crate::base::Error::Cancelled`].
fn first_odd(run: &Run, records: &[u8], layout: Layout, limit: u32) -> Result<Option<usize>> {
    let faces = records.len() / layout.stride.max(1);
    let found = map_ranges(run.threads, &run.cancel, faces, CHUNK, |range| {
        let piece = &records[range.start * layout.stride..range.end * layout.stride];
        let odd = match (layout.count, layout.stride) {
            // The layout of nearly all files gets a loop of its own.
            (1, 13) => scan::<1>(piece, 13, 0, limit),
            (1, stride) => scan::<1>(piece, stride, layout.at, limit),
            (2, stride) => scan::<2>(piece, stride, layout.at, limit),
            (_, stride) => scan::<4>(piece, stride, layout.at, limit),
        };
        // Faces that the decoder will read again are told then.
        if odd.is_none() {
            run.progress.advance("read", range.len() as u64);
        }
        Ok(odd.map(|odd| range.start + odd))
    })?;
    Ok(found.into_iter().flatten().next())
}

#[inline(always)]
fn scan<const W: usize>(records: &[u8], stride: usize, at: usize, limit: u32) -> Option<usize> {
    let is_odd = |record: &[u8]| {
        let Some((count, corners)) = record.get(at..).and_then(<[u8]>::split_first_chunk::<W>) else { return true };
        let Some(corners) = corners.first_chunk::<12>() else { return true };
        let count = count.iter().rev().fold(0u32, |value, &byte| value << 8 | u32::from(byte));
        let corner = |k: usize| u32::from_le_bytes([corners[k], corners[k + 1], corners[k + 2], corners[k + 3]]);
        (count != 3) | (corner(0) >= limit) | (corner(4) >= limit) | (corner(8) >= limit)
    };
    for (number, block) in records.chunks(BLOCK * stride).enumerate() {
        let odd = block.chunks_exact(stride).fold(false, |odd, record| odd | is_odd(record));
        if odd {
            return block.chunks_exact(stride).position(is_odd).map(|place| number * BLOCK + place);
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_odd_record_is_found_in_any_layout() {
        for (count, at, after) in [(1, 0, 0), (1, 4, 3), (2, 1, 0), (4, 0, 5)] {
            let layout = Layout { stride: at + count + 12 + after, at, count };
            let faces = CHUNK * 2 + 77;
            let mut records = vec![0u8; faces * layout.stride];
            for record in records.chunks_exact_mut(layout.stride) {
                record[at] = 3;
                record[at + count + 4] = 9;
            }
            let run = Run { threads: 2, ..Run::new(&()) };
            assert_eq!(first_odd(&run, &records, layout, 10).unwrap(), None);
            assert_eq!(first_odd(&run, &records, layout, 9).unwrap(), Some(0));
            records[(CHUNK + 300) * layout.stride + at + count + 8] = 10;
            assert_eq!(first_odd(&run, &records, layout, 10).unwrap(), Some(CHUNK + 300));
            records[5 * layout.stride + at] = 4;
            assert_eq!(first_odd(&run, &records, layout, 10).unwrap(), Some(5));
        }
    }
}
