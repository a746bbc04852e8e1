//! From the order of the nodes back to the file's.
//!
//! Values are scattered into the mapped output where that fits memory, else shuffled by face, a bucket at a
//! time. Cost: one pass over the nodes; 8 B a value on disk where memory does not hold them.

use super::NodeOrder;
use crate::base::Result;
use crate::base::parallel::{chunk_count, chunk_range, each_chunk};
use crate::store::npy::Item;
use crate::store::shuffle::BudgetedShuffle;
use crate::store::shuffle::Producer;
use crate::store::{Context, MappedSlice};

const CHUNK: usize = 1 << 16;

impl NodeOrder {
    /// Puts `values` (n, one a node, 4 bytes each), which are the array `name` of `work`, in the order of the file's faces,
    /// under the same name; where the file's order was kept they stay as they are.
    ///
    /// # Errors
    /// [`crate::base::Error::Io`], [`crate::base::Error::Memory`], [`crate::base::Error::Cancelled`].
    pub fn restore<T: Item>(&self, name: &str, values: MappedSlice<T>, context: Context<'_>) -> Result<MappedSlice<T>> {
        let Some(order) = &self.order else { return Ok(values) };
        let n = values.len();
        let words: &[u32] = bytemuck::cast_slice(&values);
        let mut array = context.work.array::<T>(name, &[n])?;
        let out: &mut [u32] = bytemuck::cast_slice_mut(&mut array.data()[..]);
        let bytes = 4 * n as u64;
        let resident = context.run.budget.take("ordering results", 0, bytes)?;
        if resident.bytes() >= bytes {
            for (k, (&face, &word)) in order.iter().zip(words).enumerate() {
                if k % CHUNK == 0 {
                    context.run.cancel.check()?;
                }
                out[face as usize] = word;
            }
        } else {
            drop(resident);
            let pairs = BudgetedShuffle::<[u32; 2]>::new(
                &context.work.file("restore.tmp"),
                "ordering results",
                n as u64,
                1,
                1,
                context.run,
            )?;
            let buckets = pairs.shuffle.buckets();
            each_chunk(
                context.run.threads,
                &context.run.cancel,
                chunk_count(n, CHUNK),
                || pairs.shuffle.producer(),
                |k, producer| {
                    chunk_range(n, CHUNK, k).try_for_each(|i| {
                        let face = order[i];
                        producer.push((u64::from(face) * buckets as u64 / n as u64) as usize, [face, words[i]])
                    })
                },
                Producer::finish,
            )?;
            for bucket in 0..buckets {
                context.run.cancel.check()?;
                pairs.shuffle.take(bucket)?.into_iter().for_each(|[face, word]| out[face as usize] = word);
            }
        }
        // By rename: `values` stay mapped until they are dropped.
        array.finish(false)
    }
}
