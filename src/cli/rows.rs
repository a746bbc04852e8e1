//! `rows` and `merge`: the distances from all landmarks, by one process or by several.

use super::method::MethodArgs;
use super::options::RunArgs;
use super::stages::read;
use super::{AppContext, Failure};
use nystrom_stream::distance::shard;
use nystrom_stream::pipeline::kept::Record;
use nystrom_stream::pipeline::{input, sharding};
use nystrom_stream::store::Context;
use nystrom_stream::store::WorkDir;
use std::path::PathBuf;

/// Arguments of `rows`.
#[derive(Clone, Debug, clap::Args)]
pub struct Args {
    /// A PLY, OBJ, OFF or STL file, .gz or not [default: the mesh that the work directory is of]
    #[arg(value_name = "MESH")]
    pub mesh: Option<PathBuf>,
    /// Where everything is kept, for later commands
    #[arg(long, value_name = "DIR")]
    pub work_dir: PathBuf,
    /// Only the i-th of n shares of the rows, counted from 0; processes may share the work directory
    #[arg(long, value_name = "I/N", value_parser = parse_shard)]
    pub shard: Option<(usize, usize)>,
    #[command(flatten)]
    pub method: MethodArgs,
    #[command(flatten)]
    pub run: RunArgs,
}

/// Arguments of `merge`.
#[derive(Clone, Debug, clap::Args)]
pub struct MergeArgs {
    /// The work directory that the shards were computed in
    #[arg(value_name = "WORK")]
    pub work_dir: PathBuf,
    #[command(flatten)]
    pub run: RunArgs,
}

/// Shard and number of shards from "0/3".
fn parse_shard(text: &str) -> Result<(usize, usize), String> {
    let wrong = || format!("{text:?} is no shard; write 0/3, 1/3 and 2/3");
    let (shard, of) = text.split_once('/').ok_or_else(wrong)?;
    match (shard.trim().parse(), of.trim().parse()) {
        (Ok(shard), Ok(of)) if shard < of => Ok((shard, of)),
        _ => Err(wrong()),
    }
}

pub fn run(args: &Args, app: &AppContext) -> Result<(), Failure> {
    let bars = args.run.bars();
    let mut run = args.run.run(&bars, app);
    let mut params = args.method.params()?;
    let path = match &args.mesh {
        Some(path) => path.clone(),
        None => {
            let record = Record::read(&WorkDir::open_existing(&args.work_dir)?)?;
            run.seed = args.run.seed.unwrap_or(record.seed);
            params.order = args.method.order.or(record.params.order);
            record.mesh
        }
    };
    if let Some(shard) = args.shard {
        let open = |work: &WorkDir| read(&path, Context::new(work, &run)).map(|(opened, _)| opened);
        return Ok(sharding::one(&args.work_dir, &input::identity(&path)?, &params, shard, open, &run)?);
    }
    let work = WorkDir::open(&args.work_dir)?;
    let (opened, identity) = read(&path, Context::new(&work, &run))?;
    sharding::all(&opened, &identity, &params, Context::new(&work, &run))?;
    Ok(())
}

pub fn merge(args: &MergeArgs, app: &AppContext) -> Result<(), Failure> {
    let bars = args.run.bars();
    let run = args.run.run(&bars, app);
    let work = WorkDir::open(&args.work_dir)?;
    shard::merge(Context::new(&work, &run))?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::parse_shard;

    #[test]
    fn shards() {
        assert_eq!(parse_shard("2/3"), Ok((2, 3)));
        for bad in ["3/3", "1", "0/0", "a/b", "-1/2"] {
            assert!(parse_shard(bad).is_err(), "{bad}");
        }
    }
}
