//! The memory budget: how much may be allocated, as opposed to mapped.
//!
//! One budget serves a run. A stage requests what it would like and gets what is left, or an error when not even its
//! minimum fits; a grant is returned when dropped. The caller promises to keep to its grant; tests check this with a
//! counting allocator.

use crate::base::error::FEWER_THREADS;
use crate::base::{Error, Result};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// A pool of bytes, shared by clones.
#[derive(Clone, Debug)]
pub struct Budget {
    total: u64,
    used: Arc<AtomicU64>,
}

/// Bytes granted by a [`Budget`], returned on drop.
#[derive(Debug)]
pub struct Grant {
    budget: Budget,
    bytes: u64,
}

impl Budget {
    /// A budget of `total` bytes.
    pub fn new(total: u64) -> Self {
        Self { total, used: Arc::default() }
    }

    /// Half of what this process may use: the least of the machine's free memory, the limit of its control group and
    /// half the limits of the process (`ulimit -v`, `ulimit -d`); 1 GiB where none can be read.
    pub fn of_machine() -> Self {
        let limit = [Self::machine_limit(), process_limit()].into_iter().flatten().min();
        Self::new(limit.map_or(1 << 30, |bytes| bytes / 2))
    }

    /// What may lie in memory including the page cache, to which process limits do not apply: the machine's free memory
    /// or the control group's limit, whichever is less.
    pub fn machine_limit() -> Option<u64> {
        [available_memory(), control_group_limit()].into_iter().flatten().min()
    }

    /// What arrays in memory leave of a budget of `total` bytes to the stages: half, but no more than 3 GiB, since no
    /// stage needs more. A gigabyte more of arrays then needs a gigabyte more of budget, not two.
    pub fn left_to_stages(total: u64) -> u64 {
        (total / 2).min(3 << 30)
    }

    /// The size of the whole budget.
    pub fn total(&self) -> u64 {
        self.total
    }

    /// What is not granted at present.
    pub fn left(&self) -> u64 {
        self.total.saturating_sub(self.used.load(Ordering::Relaxed))
    }

    /// Takes `wanted` bytes, or what is left if that is less, but at least `minimum`.
    ///
    /// # Errors
    /// [`Error::Memory`] when less than `minimum` is left; `what` names the purpose.
    pub fn take(&self, what: &'static str, minimum: u64, wanted: u64) -> Result<Grant> {
        self.granted(minimum, wanted.max(minimum)).map_err(|available| Error::Memory {
            what,
            needed: minimum,
            available,
            remedy: FEWER_THREADS,
        })
    }

    /// Takes `bytes` bytes; `remedy` is what would help besides more memory.
    ///
    /// # Errors
    /// [`Error::Memory`] when less is left; `what` names the purpose.
    pub fn take_or(&self, what: &'static str, bytes: u64, remedy: &'static str) -> Result<Grant> {
        self.granted(bytes, bytes).map_err(|available| Error::Memory { what, needed: bytes, available, remedy })
    }

    /// Takes `wanted` bytes, or what is left if that is less.
    pub fn take_up_to(&self, wanted: u64) -> Grant {
        self.granted(0, wanted).unwrap_or_else(|_| Grant { budget: self.clone(), bytes: 0 })
    }

    /// Takes `wanted` bytes, or what is left unless that is less than `minimum`; the error value is what is left.
    fn granted(&self, minimum: u64, wanted: u64) -> std::result::Result<Grant, u64> {
        let left = |used: u64| self.total.saturating_sub(used);
        let more = |used: u64| (left(used) >= minimum).then(|| used + wanted.min(left(used)));
        match self.used.fetch_update(Ordering::Relaxed, Ordering::Relaxed, more) {
            Ok(used) => Ok(Grant { budget: self.clone(), bytes: wanted.min(left(used)) }),
            Err(used) => Err(left(used)),
        }
    }
}

impl Grant {
    /// The bytes granted.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }
}

impl Drop for Grant {
    fn drop(&mut self) {
        self.budget.used.fetch_sub(self.bytes, Ordering::Relaxed);
    }
}

/// `MemAvailable` of the kernel, in bytes.
fn available_memory() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = text.lines().find(|line| line.starts_with("MemAvailable:"))?;
    Some(line.split_whitespace().nth(1)?.parse::<u64>().ok()? * 1024)
}

/// Half the soft limit of this process's address space or data segment, whichever is less. Half, because mapped files,
/// stacks and the program count too.
fn process_limit() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/self/limits").ok()?;
    let limits = ["Max address space", "Max data size"].into_iter();
    let soft = |name| text.lines().find_map(|line| line.strip_prefix(name)?.split_whitespace().next()?.parse().ok());
    limits.filter_map(soft).min().map(|bytes: u64| bytes / 2)
}

/// The tightest memory limit among this process's control group and its ancestors, version 2 or 1.
fn control_group_limit() -> Option<u64> {
    let groups = std::fs::read_to_string("/proc/self/cgroup").ok()?;
    let mut least: Option<u64> = None;
    for line in groups.lines() {
        let mut fields = line.splitn(3, ':');
        let (_, controllers, path) = (fields.next()?, fields.next()?, fields.next()?);
        let (root, file) = match controllers {
            "" => ("/sys/fs/cgroup", "memory.max"),
            list if list.split(',').any(|name| name == "memory") => ("/sys/fs/cgroup/memory", "memory.limit_in_bytes"),
            _ => continue,
        };
        let mut folder = std::path::PathBuf::from(root).join(path.trim_start_matches('/'));
        loop {
            if let Ok(text) = std::fs::read_to_string(folder.join(file))
                && let Ok(bytes) = text.trim().parse::<u64>()
                && bytes < 1 << 60
            {
                least = Some(least.map_or(bytes, |least| least.min(bytes)));
            }
            if !folder.pop() || !folder.starts_with(root) {
                break;
            }
        }
    }
    least
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn grants_come_back() {
        let budget = Budget::new(100);
        let first = budget.take("a", 10, 80).unwrap();
        assert_eq!((first.bytes(), budget.total(), budget.left()), (80, 100, 20));
        let second = budget.take("b", 10, 80).unwrap();
        assert_eq!(second.bytes(), 20);
        assert!(matches!(budget.take("c", 1, 1), Err(Error::Memory { needed: 1, available: 0, .. })));
        drop(first);
        assert_eq!(budget.left(), 80);
        let rest = budget.take_up_to(100);
        assert_eq!((rest.bytes(), budget.take_up_to(1).bytes()), (80, 0));
    }
}
