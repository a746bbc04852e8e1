//! Races the front against a binary-heap Dijkstra on the same graph, and rows on one thread against two.
//!
//! `cargo run --release -p nystrom-stream-tools --bin race -- MESH [-l 10] [--repeat 5]`: prints medians, one line each, for
//! the records in `benches/records`. Both sides run in the same process, by turns, since a machine's speed wanders.

#[path = "../tests/common/oracle.rs"]
mod oracle;

use clap::Parser;
use nystrom_stream::base::Result;
use nystrom_stream::distance::front::mean_weight;
use nystrom_stream::distance::rows::RowParams;
use nystrom_stream::distance::{DistanceRows, Front};
use nystrom_stream::graph::Csr;
use nystrom_stream::graph::csr::TriangleAdjacency;
use nystrom_stream::graph::{DualGraph, Metric};
use nystrom_stream::mesh;
use nystrom_stream::store::{Context, Run, WorkDir};
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Instant;

/// Race the front against a binary heap, and two threads against one.
#[derive(Parser)]
struct Arguments {
    /// A mesh.
    mesh: PathBuf,
    /// Rows.
    #[arg(short, default_value_t = 10)]
    l: usize,
    /// Runs, of which the median counts.
    #[arg(long, default_value_t = 5)]
    repeat: usize,
    /// Race the front alone, and keep the graph, the row and its times here for other programs (benches/peer_rows.py).
    #[arg(long, value_name = "DIR")]
    keep: Option<PathBuf>,
}

/// The seconds that `work` takes.
fn seconds(work: impl FnOnce() -> Result<()>) -> Result<f64> {
    let start = Instant::now();
    work()?;
    Ok(start.elapsed().as_secs_f64())
}

fn median(mut of: Vec<f64>) -> f64 {
    of.sort_by(f64::total_cmp);
    of[of.len() / 2]
}

fn race(arguments: &Arguments) -> Result<()> {
    let mut run = Run::new(&());
    let work = match &arguments.keep {
        Some(folder) => WorkDir::open(folder)?,
        None => WorkDir::temporary(&std::env::temp_dir())?.holding(&run.budget),
    };
    let opened = mesh::open(&arguments.mesh, work.path(), &run)?;
    let graph = DualGraph::build(&opened, &arguments.mesh, &serde_json::Value::Null, Context::new(&work, &run))?;
    let n = graph.nodes.len();
    for (name, metric) in [("scale-free", Metric::default()), ("paper", Metric::paper())] {
        let weighted = graph.weighted(metric, Context::new(&work, &run))?;
        let triangles = TriangleAdjacency::of(weighted.csr(), &run)?;
        let csr = Csr { triangles: triangles.as_ref().map_or(&[], TriangleAdjacency::all), ..weighted.csr() };
        let mut front = Front::new(mean_weight(csr));
        let mut field = vec![0f32; n];
        let source = (n / 3) as u32;
        let (mut front_times, mut heap_times, mut slow) = (Vec::new(), Vec::new(), Vec::new());
        for _ in 0..arguments.repeat.max(1) {
            front_times.push(seconds(|| front.full(csr, source, &mut field, &run.cancel).map(drop))?);
            heap_times.push(seconds(|| {
                slow = oracle::dijkstra(csr, source);
                Ok(())
            })?);
        }
        let (ours, heap) = (median(front_times), median(heap_times));
        println!(
            "{name:10} {n} faces: front {:.1} ms ({:.1} ns a face), binary heap {:.1} ms, {:.2} x; same bits: {}",
            ours * 1e3,
            ours * 1e9 / n as f64,
            heap * 1e3,
            heap / ours,
            slow == field
        );
        if arguments.keep.is_some() {
            let mut row = work.array::<f32>("front.npy", &[n])?;
            row.data().copy_from_slice(&field);
            row.finish(true)?;
            return work.write_json("front.json", &serde_json::json!({ "source": source, "seconds": ours }));
        }
        let mut times = [Vec::new(), Vec::new()];
        for _ in 0..arguments.repeat.max(1) {
            for threads in [1, 2] {
                run.threads = threads;
                // A work directory of its own, or the rows would be reused; arrays in memory, as `segment` has them.
                let scratch = WorkDir::temporary(&std::env::temp_dir())?.holding(&run.budget);
                let params = RowParams { l: arguments.l, sampling: nystrom_stream::landmarks::Sampling::default() };
                let rows = || {
                    DistanceRows::build(&weighted, graph.nodes.view(), params, Context::new(&scratch, &run)).map(drop)
                };
                times[threads - 1].push(seconds(rows)?);
            }
        }
        let [one, two] = times.map(median);
        println!(
            "{name:10} {} rows: one thread {:.0} ms, two {:.0} ms, {:.2} x",
            arguments.l,
            one * 1e3,
            two * 1e3,
            one / two
        );
    }
    Ok(())
}

fn main() -> ExitCode {
    match race(&Arguments::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("race: {error}");
            ExitCode::FAILURE
        }
    }
}
