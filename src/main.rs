//! The command `nystrom-stream`: everything behind it is in the library and in `cli`.

mod cli;

/// Counts what is allocated, for the report and for holding the budget to its word.
#[global_allocator]
static ALLOCATOR: cap::Cap<mimalloc::MiMalloc> = cap::Cap::new(mimalloc::MiMalloc, usize::MAX);

/// Names a file that receives the most bytes that were allocated at once; `tools/trials budget` compares them.
const PEAK: &str = "NYSTROM_STREAM_PEAK";

fn main() -> std::process::ExitCode {
    let peak = || ALLOCATOR.max_allocated() as u64;
    let end = cli::main(peak);
    if let Some(path) = std::env::var_os(PEAK) {
        // Whoever asks notices that the file is missing.
        let _ = std::fs::write(path, peak().to_string());
    }
    end.code()
}
