//! How fast the disk under a folder reads and writes, so that a run can estimate how long it will wait for it.
//!
//! A file of [`BYTES`] random bytes is written and synced, dropped from the page cache, and read again from beginning
//! to end, nearly as stages do with large arrays. Virtual disks may keep recent writes in a cache of their host; they
//! then read these faster than older data.
//!
//! Cost: a tenth of a second on a fast disk, two seconds on one of 150 MB/s; a buffer of one mebibyte.

use super::private_folder;
use crate::base::random::{splitmix_finalise, stream};
use crate::base::{Error, Result};
use rand_xoshiro::rand_core::Rng;
use rustix::fs::{Advice, fadvise};
use std::io::{Read, Seek, Write};
use std::path::Path;
use std::time::Instant;

/// Size of the file.
const BYTES: usize = 128 << 20;
/// Bytes written and read at a time.
const BLOCK: usize = 1 << 20;
/// Size of a page; equal pages might be deduplicated by the disk.
const PAGE: usize = 4096;

/// Bytes per second.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DiskSpeed {
    /// From the disk.
    pub read: f64,
    /// To the disk.
    pub write: f64,
}

impl DiskSpeed {
    /// Measures the disk under `folder`, in a temporary folder there.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn measure(folder: &Path) -> Result<Self> {
        let own = private_folder(folder)?;
        let path = own.path().join("disk-speed");
        let wrong = |what| Error::io(&path, what);
        let mut file = super::new_file::create(&path)?;
        let mut block = vec![0; BLOCK];
        stream(0, "disk speed").fill_bytes(&mut block);
        let begun = Instant::now();
        for k in 0..BYTES / BLOCK {
            // Every page differs, since disks may deduplicate equal ones.
            for (page, j) in block.chunks_mut(PAGE).zip(0..) {
                page[..8].copy_from_slice(&splitmix_finalise((k * BLOCK / PAGE + j) as u64).to_le_bytes());
            }
            file.write_all(&block).map_err(wrong("write"))?;
        }
        file.sync_all().map_err(wrong("bring to the disk"))?;
        let write = BYTES as f64 / begun.elapsed().as_secs_f64();
        fadvise(&file, 0, None, Advice::DontNeed).map_err(|error| wrong("drop from memory")(error.into()))?;
        file.rewind().map_err(wrong("read"))?;
        let begun = Instant::now();
        while file.read(&mut block).map_err(wrong("read"))? > 0 {}
        let read = BYTES as f64 / begun.elapsed().as_secs_f64();
        Ok(Self { read, write })
    }

    /// Seconds for `read` bytes read and `written` bytes written.
    pub fn seconds(self, read: f64, written: f64) -> f64 {
        read / self.read + written / self.write
    }
}
