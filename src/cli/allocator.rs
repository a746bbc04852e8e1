//! Makes the allocator return memory at once where the budget is small.
//!
//! mimalloc keeps freed memory for a second and hands out pages of 2 MiB, which is faster: by a sixth at 1.3 million
//! faces. But what it keeps is no part of the budget. With 64 MiB, 10 million faces took 116 MB instead of 67, and were
//! killed in a control group of 128 MiB. mimalloc reads its options from the environment while the process starts,
//! before `main`. So the program replaces itself, before it has read anything; this takes some 2 ms.

use clap::ArgMatches;
use nystrom_stream::store::Budget;
use std::os::unix::process::CommandExt;
use std::process::Command;

/// Budgets from this one on leave room for what the allocator keeps: 100 million faces took 754 MB with 512 MiB, half
/// of what the group of a default budget may hold, and 524 MB with 256 MiB.
const SMALL: u64 = 512 << 20;

/// mimalloc's options that return memory at once.
const OPTIONS: [(&str, &str); 2] = [("MIMALLOC_PURGE_DELAY", "0"), ("MIMALLOC_ALLOW_THP", "0")];

/// Starts the program again with [`OPTIONS`] if its budget is small and the environment does not set them. If that
/// fails, such as under an emulator, the run continues as it is.
pub fn return_memory_at_once(matches: &ArgMatches) {
    let Some((_, command)) = matches.subcommand() else { return };
    // Commands without a budget have no such argument.
    let Ok(given) = command.try_get_one::<u64>("max_memory") else { return };
    let budget = given.copied().unwrap_or_else(|| Budget::of_machine().total());
    let mut unset = OPTIONS.into_iter().filter(|(name, _)| std::env::var_os(name).is_none()).peekable();
    if budget >= SMALL || unset.peek().is_none() {
        return;
    }
    let Ok(program) = std::env::current_exe() else { return };
    let mut arguments = std::env::args_os();
    let name = arguments.next().unwrap_or_default();
    let _ = Command::new(program).arg0(name).args(arguments).envs(unset).exec();
}
