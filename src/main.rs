//! The command `nystrom-stream`: everything behind it is in the library and in `cli`.

mod cli;

/// Counts what is allocated, for the report and for holding the budget to its word.
#[global_allocator]
static ALLOCATOR: cap::Cap<mimalloc::MiMalloc> = cap::Cap::new(mimalloc::MiMalloc, usize::MAX);

fn main() -> std::process::ExitCode {
    cli::main(|| ALLOCATOR.max_allocated() as u64)
}
