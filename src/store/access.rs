//! How mapped files are read: what the kernel is told to expect, and in pages of which size.
//!
//! Memory and disk pass files on in pages of 4 KiB, unless a mapping asks for larger ones. Each page costs the kernel
//! time when it is read, mapped and given up again: some .55 s per GB where memory is short, half as much as the disk
//! takes. So mappings of large files ask for pages of 2 MiB, which cost .02 s per GB. A front or a sample that needs
//! single pages here and there must not read 2 MiB for each: it says so ([`Access::Random`]) and requests what it
//! needs.
//!
//! Arrays that are written through their mapping keep small pages: a large one is written as a whole wherever a byte of
//! it changes, which a front does again and again (rows of 10 million faces in 128 MiB took four times as long).
//!
//! Kernels before 5.18 and other systems know only small pages; they are asked for the next chunks of a pass instead
//! (`Run::will_need`).

/// The expected access pattern of a mapping; passed on to the kernel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Access {
    /// Nearby pages soon: large pages, the kernel's default read-ahead.
    Local,
    /// Once from start to end: aggressive read-ahead, early reclaim. The size of pages stays as it is.
    Sequential,
    /// Anywhere: single pages, no read-ahead.
    Random,
}

impl Access {
    /// What the kernel is told of `bytes` mapped bytes.
    pub(super) fn advice(self, bytes: usize) -> impl Iterator<Item = libc::c_int> {
        let reading = match self {
            Self::Local => libc::MADV_NORMAL,
            Self::Sequential => libc::MADV_SEQUENTIAL,
            Self::Random => libc::MADV_RANDOM,
        };
        [Some(reading), self.page_size(bytes)].into_iter().flatten()
    }

    #[cfg(target_os = "linux")]
    fn page_size(self, bytes: usize) -> Option<libc::c_int> {
        let size = match self {
            Self::Local => Some(libc::MADV_HUGEPAGE),
            Self::Sequential => None,
            Self::Random => Some(libc::MADV_NOHUGEPAGE),
        };
        size.filter(|_| bytes >= LARGE && reads_large_pages())
    }

    #[cfg(not(target_os = "linux"))]
    fn page_size(self, _: usize) -> Option<libc::c_int> {
        None
    }
}

/// Smallest mapping that is read in pages of 2 MiB.
const LARGE: usize = 8 << 20;

/// Whether the kernel reads a file in pages of 2 MiB where its mapping asks for that: Linux from 5.18 on. File systems
/// that know only pages of 4 KiB then read as many of them at a time.
pub fn reads_large_pages() -> bool {
    #[cfg(target_os = "linux")]
    {
        static READS: std::sync::OnceLock<bool> = std::sync::OnceLock::new();
        *READS.get_or_init(|| {
            let name = rustix::system::uname();
            let mut numbers = name.release().to_str().unwrap_or("").split(|c: char| !c.is_ascii_digit());
            let mut next = || numbers.next().and_then(|number| number.parse::<u32>().ok());
            (next(), next()) >= (Some(5), Some(18))
                && std::path::Path::new("/sys/kernel/mm/transparent_hugepage").exists()
        })
    }
    #[cfg(not(target_os = "linux"))]
    false
}
