//! Opening the mesh that a command is given: a file, or standard input.
//!
//! Standard input is spooled into the work directory, since a mesh is mapped. A lasting work directory keeps to its mesh.

use super::options::ForceArgs;
use nystrom_stream::base::Error;
use nystrom_stream::mesh;
use nystrom_stream::pipeline::input;
use nystrom_stream::store::{Context, workdir};
use serde_json::{Value, json};
use std::path::Path;

/// What standard input is spooled to in a work directory.
const SPOOLED: &str = "input";

/// Opens the mesh at `path`, or that on standard input, and tells which it is. A work directory of another mesh is refused without
/// `force`, before anything in it changes.
pub fn read(path: &Path, force: ForceArgs, context: Context<'_>) -> Result<(mesh::Mesh, Value), Error> {
    let Context { work, run } = context;
    let lasting = !work.is_temporary() && !force.force;
    if path.as_os_str() == "-" {
        return piped(lasting, context);
    }
    let identity = input::identity(path)?;
    if lasting {
        input::admit(path, &identity, work)?;
    }
    let (opened, _) = run.stage("read", "bytes", 0, || mesh::open(path, work.path(), run))?;
    Ok((opened, identity))
}

/// The mesh on standard input, which is spooled into the work directory. Which mesh it is shows only then, so the one that is
/// there steps aside until the other is `admitted`.
fn piped(admitted: bool, context: Context<'_>) -> Result<(mesh::Mesh, Value), Error> {
    let Context { work, run } = context;
    let (input, aside) = (work.file(SPOOLED), work.file("input.before.tmp"));
    let kept = admitted && std::fs::rename(&input, &aside).is_ok();
    let read = || mesh::open_reader(std::io::stdin().lock(), "<stdin>", work.path(), run);
    let result = run.stage("read", "bytes", 0, read).map(|(opened, _)| opened).and_then(|opened| {
        let identity = json!({"stdin": workdir::checksum(&input)?});
        if admitted {
            input::admit(Path::new("-"), &identity, work)?;
        }
        Ok((opened, identity))
    });
    match &result {
        Err(_) if kept => drop(std::fs::rename(&aside, &input)),
        _ => work.remove("input.before.tmp"),
    }
    result
}
