//! The command `nystrom-stream`: all of it is in the library and in `cli`.

mod cli;

/// Counts allocated bytes, for the report and to check that the budget is kept.
#[global_allocator]
static ALLOCATOR: cap::Cap<mimalloc::MiMalloc> = cap::Cap::new(mimalloc::MiMalloc, usize::MAX);

/// An environment variable with the name of a file that receives the peak of allocated bytes; `tools/trials budget`
/// compares them.
const PEAK: &str = "NYSTROM_STREAM_PEAK";

fn main() -> std::process::ExitCode {
    let peak = || ALLOCATOR.max_allocated() as u64;
    let end = cli::main(peak);
    if let Some(path) = std::env::var_os(PEAK) {
        // A failure needs no message: whoever set the variable notices that the file is missing.
        let _ = std::fs::write(path, peak().to_string());
    }
    end.code()
}
