//! Makes the allocator return memory at once where the budget is small.
//!
//! mimalloc keeps freed memory for a second and hands out pages of 2 MiB, which is faster: by a sixth at 1.3 million
//! faces. But what it keeps is no part of the budget. With 64 MiB, 10 million faces took 116 MB instead of 64, and were
//! killed in a control group of 128 MiB. mimalloc reads its options from the environment while the process starts,
//! before `main`. So the program replaces itself, before it has read anything; this takes some 2 ms. Process number,
//! arguments, open files and ignored signals stay the same.
//!
//! An emulator or a checker that does not follow a process through `exec` (Valgrind without `--trace-children=yes`,
//! QEMU) loses it here, unless both variables of [`OPTIONS`] are set.

use clap::ArgMatches;
use nystrom_stream::store::Budget;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::Command;

/// Budgets from this one on have room for what the allocator keeps: 100 million faces took 202 MB with 256 MiB. With
/// 128 MiB, 10 million took 172 MB.
const SMALL: u64 = 256 << 20;

/// mimalloc's options that return memory at once.
const OPTIONS: [(&str, &str); 2] = [("MIMALLOC_PURGE_DELAY", "0"), ("MIMALLOC_ALLOW_THP", "0")];

/// Starts the program again with [`OPTIONS`] if its budget is small and the environment does not set them. If that is
/// not possible, such as if its file has been deleted, the run continues as it is.
pub fn return_memory_at_once(matches: &ArgMatches) {
    let Some((_, command)) = matches.subcommand() else { return };
    // Commands without a budget have no such argument.
    let Ok(given) = command.try_get_one::<u64>("max_memory") else { return };
    let budget = given.copied().unwrap_or_else(|| Budget::of_machine().total());
    let mut unset = OPTIONS.into_iter().filter(|(name, _)| std::env::var_os(name).is_none()).peekable();
    if budget >= SMALL || unset.peek().is_none() {
        return;
    }
    let Some(program) = file_of_program() else { return };
    let mut arguments = std::env::args_os();
    let name = arguments.next().unwrap_or_default();
    let _ = Command::new(program).arg0(name).args(arguments).envs(unset).exec();
}

/// The file of this program. None if the process was made from another file: the dynamic loader's, if the program was
/// called as `ld-linux-x86-64.so.2 nystrom-stream`. The loader would take the subcommand for a program.
fn file_of_program() -> Option<PathBuf> {
    let file = std::env::current_exe().ok()?;
    // Other systems have no such list.
    let Ok(mapped) = std::fs::read("/proc/self/maps") else { return Some(file) };
    let here = file_of_program as fn() -> Option<PathBuf> as usize;
    let holds = |line: &&[u8]| addresses(line).is_some_and(|(start, end)| (start..end).contains(&here));
    let line = mapped.split(|byte| *byte == b'\n').find(holds)?;
    line.ends_with(file.as_os_str().as_bytes()).then_some(file)
}

/// The first address of a mapping and the one after its last, from a line such as `55d0-55e0 r-xp …`.
fn addresses(line: &[u8]) -> Option<(usize, usize)> {
    let word = line.split(|byte| *byte == b' ').next()?;
    let (start, end) = std::str::from_utf8(word).ok()?.split_once('-')?;
    Some((usize::from_str_radix(start, 16).ok()?, usize::from_str_radix(end, 16).ok()?))
}
