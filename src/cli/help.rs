//! Examples of the long help; man pages and completions, made from the same definitions as the help.

use super::{Cli, Failure};
use clap::CommandFactory;
use clap_complete::Shell;
use nystrom_stream::base::Error;
use std::path::PathBuf;

/// After the program's own help.
pub const PROGRAM: &str = "\
Examples:
  nystrom-stream segment scan.ply                      parts found by themselves, in scan.segmented.ply
  nystrom-stream segment scan.ply -k 6 -o parts.seg    exactly six parts, a label a line
  nystrom-stream segment scans/ --jobs 2 --resume      a folder of meshes, what is done already left out
  nystrom-stream demo                                  a first look, without a mesh

Exit codes: 0 done; 1 a mesh or the system refused; 2 the command line makes no sense.";

/// After the help of `segment`.
pub const SEGMENT: &str = "\
Examples:
  nystrom-stream segment scan.ply --parts-range 4..12
  nystrom-stream segment scan.ply -o out.ply -o out.seg -o out.png --json=report.json
  nystrom-stream segment scan.ply -k 6 --cluster kmeans --metric paper --normalise none
  nystrom-stream segment scans/ -o 'labels/{}.seg' --jobs 2 --json-lines=all.jsonl --resume
  zcat scan.ply.gz | nystrom-stream segment - -k 6 > labelled.ply
  find scans -name '*.ply' -print0 | xargs -0 nystrom-stream segment";

/// After the help of `graph`, `rows`, `embed`, `cluster` and `export`.
pub const STAGES: &str = "\
Examples, the stages of `segment` one by one:
  nystrom-stream graph scan.ply --work-dir work
  nystrom-stream rows --work-dir work -l 40
  nystrom-stream cluster --work-dir work -k 9          another number of parts takes a moment
  nystrom-stream cluster --work-dir work --detail 0.5 -o finer.seg
  nystrom-stream export --work-dir work -o parts.ply --tree tree.json
  nystrom-stream embed --work-dir work -d 8            embedding.npy, for other programs";

/// After the help of `sequence`.
pub const SEQUENCE: &str = "\
Examples:
  nystrom-stream sequence scan.ply                     scan.sequenced.ply, few vertices live at a time
  nystrom-stream sequence scan.ply -o out.ply -o order.png --smooth 20 --original
  nystrom-stream sequence scan.ply --order bfs -o out.ply
  nystrom-stream sequence scan.ply --compare           a table of all orders, nothing written";

/// After the help of `transfer-labels`.
pub const TRANSFER: &str = "\
Examples:
  nystrom-stream transfer-labels scan.segmented.ply decimated.ply -o decimated.segmented.ply
  nystrom-stream transfer-labels scan.ply remeshed.obj --labels scan.seg -o remeshed.seg --json";

/// Arguments of `completions`.
#[derive(Clone, Debug, clap::Args)]
pub struct CompletionArgs {
    /// The shell
    #[arg(value_name = "SHELL")]
    pub shell: Shell,
}

/// Arguments of `man`.
#[derive(Clone, Debug, clap::Args)]
pub struct ManArgs {
    /// The folder that a page a subcommand goes to
    #[arg(value_name = "DIR")]
    pub folder: PathBuf,
}

/// Writes completions to standard output.
pub fn completions(args: &CompletionArgs) -> Result<(), Failure> {
    let mut text = Vec::new();
    clap_complete::generate(args.shell, &mut Cli::command(), "nystrom-stream", &mut text);
    super::output::print(&text)?;
    Ok(())
}

/// Writes man pages.
pub fn man(args: &ManArgs) -> Result<(), Failure> {
    std::fs::create_dir_all(&args.folder).map_err(Error::io(&args.folder, "create"))?;
    clap_mangen::generate_to(Cli::command(), &args.folder).map_err(Error::io(&args.folder, "write man pages to"))?;
    Ok(())
}
