//! Uses the floors below `segment`: the dual graph of a mesh, farthest-point landmarks, and the rows of
//! geodesic distances that everything else is made of.
//!
//! `cargo run --release --example distances -- mesh.ply [LANDMARKS]`

use nystrom_stream::base::Result;
use nystrom_stream::distance::DistanceRows;
use nystrom_stream::distance::rows::RowParams;
use nystrom_stream::graph::{DualGraph, Metric};
use nystrom_stream::landmarks::Sampling;
use nystrom_stream::mesh;
use nystrom_stream::pipeline::input;
use nystrom_stream::store::{Context, Run, WorkDir};
use std::path::Path;

fn distances(path: &Path, l: usize) -> Result<()> {
    let run = Run::new(&());
    let work = WorkDir::temporary(&std::env::temp_dir())?;
    let opened = mesh::open(path, work.path(), &run)?;
    let graph = DualGraph::build(&opened, path, &input::identity(path)?, Context::new(&work, &run))?;
    println!("{} faces, {} edges, {} components", graph.nodes.len(), graph.facts.edges, graph.facts.components);

    let weighted = graph.weighted(Metric::Geodesic, Context::new(&work, &run))?;
    let rows = DistanceRows::build(
        &weighted,
        graph.nodes.view(),
        RowParams { l, sampling: Sampling::Farthest },
        Context::new(&work, &run),
    )?;
    println!("landmarks: {:?}, mean distance {:.4}", rows.landmarks, rows.mean());
    // Row k is a mapped slice: any face's distance from landmark k.
    for (k, facts) in rows.facts.iter().enumerate() {
        println!(
            "from face {:9}: {:.4} to face 0, {:.4} to the farthest",
            rows.landmarks[k],
            rows.row(k)[0],
            facts.farthest
        );
    }
    Ok(())
}

fn main() -> std::process::ExitCode {
    let mut arguments = std::env::args().skip(1);
    let Some(path) = arguments.next() else {
        eprintln!("usage: distances MESH [LANDMARKS]");
        return 2.into();
    };
    match distances(Path::new(&path), arguments.next().and_then(|l| l.parse().ok()).unwrap_or(8)) {
        Ok(()) => 0.into(),
        Err(error) => {
            eprintln!("{error}");
            1.into()
        }
    }
}
