//! The decisions over cells against numbers from the reference prototype.
//!
//! `tools/parts_reference.py dump` writes a folder a model; `PARTS_DUMP` names the folder of
//! these. Without it the tests say so and pass: the dumps are made of meshes that are not ours to
//! ship.

use nystrom_stream::base::random::stream;
use nystrom_stream::cluster::parts::anchor::{Embedding, Rows, anchor_embedding};
use nystrom_stream::cluster::parts::cells::{connected_pieces, join_small};
use nystrom_stream::cluster::parts::convexity::{PairSums, convexity};
use nystrom_stream::cluster::parts::cost::Model;
use nystrom_stream::cluster::parts::labelling::{HALF, Pull};
use nystrom_stream::cluster::parts::matrix::Square;
use nystrom_stream::cluster::parts::members::{Atoms, co_association, draw_members};
use nystrom_stream::cluster::parts::over_segment::Recipe;
use nystrom_stream::cluster::parts::refinement::soft_hierarchy;
use nystrom_stream::cluster::parts::regions::{COLUMNS, EMBEDDED, Regions, cell_columns};
use nystrom_stream::cluster::parts::thickness::log_thickness;
use nystrom_stream::cluster::parts::{CellGraph, Decision, PartCount, PartsParams, parts};
use nystrom_stream::store::run::Run;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Instant;

type Anything<T> = Result<T, Box<dyn std::error::Error>>;

/// The dumped models, lowest number first; none without `PARTS_DUMP`.
fn dumps() -> Vec<PathBuf> {
    let Some(folder) = std::env::var_os("PARTS_DUMP") else {
        eprintln!("skipped: PARTS_DUMP does not name a folder of tools/parts_reference.py");
        return Vec::new();
    };
    let mut found: Vec<PathBuf> = fs::read_dir(folder)
        .map(|list| list.flatten().map(|e| e.path()).filter(|p| p.join("info.json").exists()).collect())
        .unwrap_or_default();
    found.sort_by_key(|p| number(p));
    found
}

fn number(folder: &Path) -> usize {
    folder.file_name().and_then(|n| n.to_str()).and_then(|n| n.parse().ok()).unwrap_or(usize::MAX)
}

fn info(folder: &Path, key: &str) -> Anything<f64> {
    let info: serde_json::Value = serde_json::from_slice(&fs::read(folder.join("info.json"))?)?;
    info[key].as_f64().ok_or_else(|| format!("no {key}").into())
}

fn reals(folder: &Path, name: &str) -> Anything<Vec<f64>> {
    Ok(npyz::NpyFile::new(&fs::read(folder.join(name).with_extension("npy"))?[..])?.into_vec()?)
}

fn labels(folder: &Path, name: &str) -> Anything<Vec<u32>> {
    Ok(npyz::NpyFile::new(&fs::read(folder.join(name).with_extension("npy"))?[..])?.into_vec()?)
}

fn square(folder: &Path, name: &str) -> Anything<Square> {
    let values = reals(folder, name)?;
    Ok(Square::from_values(values.len().isqrt(), values))
}

fn cells(folder: &Path) -> Anything<(CellGraph, Rows)> {
    let threes = |x: Vec<f64>| x.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect();
    let area = reals(folder, "area")?;
    let rows = reals(folder, "rows")?;
    let rows = Rows::new(&rows, rows.len() / area.len(), area.len());
    let graph = CellGraph {
        area,
        centre: threes(reals(folder, "centre")?),
        normal: threes(reals(folder, "normal")?),
        pairs: labels(folder, "pairs")?.chunks_exact(2).map(|p| [p[0], p[1]]).collect(),
        length: reals(folder, "length")?,
        concave: reals(folder, "concave")?,
        convex: reals(folder, "convex")?,
        convex04: reals(folder, "convex04")?,
    };
    Ok((graph, rows))
}

/// Panics unless each number is near its counterpart, relative to the larger or to `scale`.
fn near(what: &str, ours: impl IntoIterator<Item = f64>, theirs: &[f64], tolerance: f64, scale: f64) {
    let ours: Vec<f64> = ours.into_iter().collect();
    assert_eq!(ours.len(), theirs.len(), "{what}");
    for (k, (a, b)) in ours.iter().zip(theirs).enumerate() {
        let size = a.abs().max(b.abs()).max(scale);
        assert!((a - b).abs() <= tolerance * size, "{what} {k}: {a} against {b}");
    }
}

fn all(m: &Square) -> impl Iterator<Item = f64> + '_ {
    (0..m.len()).flat_map(|i| m.row(i).iter().copied())
}

/// Aligns the signs of our coordinates with theirs and compares.
fn compare_embedding(what: &str, mut ours: Embedding, theirs: &[f64]) -> Embedding {
    let (n, d) = (theirs.len() / ours.width, ours.width);
    for c in 0..d {
        let agree: f64 = (0..n).map(|i| ours.values[i * d + c] * theirs[i * d + c]).sum();
        (0..n).for_each(|i| ours.values[i * d + c] *= agree.signum());
    }
    near(what, ours.values.iter().copied(), theirs, 1e-6, 1.0);
    ours
}

#[test]
fn every_step_equals_the_prototype() -> Anything<()> {
    let mut compared = 0;
    for folder in dumps().iter().filter(|f| f.join("tree.npy").exists()) {
        let (graph, rows) = cells(folder)?;
        let every: Vec<usize> = (0..rows.count).collect();
        let shares = graph.area_shares();
        let x12 = anchor_embedding(&rows, &every, &shares, EMBEDDED, 0.2);
        let x12 = compare_embedding("embedding of 12", x12, &reals(folder, "x12")?);
        let x28 = anchor_embedding(&rows, &every, &shares, 28, 0.25);
        compare_embedding("embedding of 28", x28, &reals(folder, "x28")?);

        // Convexity between atoms, three widths.
        let run = Run::new(&());
        let atom = labels(folder, "atom2")?;
        let n = atom.iter().max().map_or(0, |&m| m as usize + 1);
        let thickness = log_thickness(&graph, &run)?;
        let sums = convexity(&graph, &thickness, &atom, n, &run)?;
        let dense = |pick: fn(&PairSums) -> [f64; 3]| {
            let mut out = vec![0.0; 3 * n * n];
            for s in &sums {
                for (w, x) in pick(s).into_iter().enumerate() {
                    out[(w * n + s.a as usize) * n + s.b as usize] = x;
                    out[(w * n + s.b as usize) * n + s.a as usize] = x;
                }
            }
            out
        };
        near("convex pairs", dense(|s| s.seen), &reals(folder, "v")?, 1e-9, 1e-12);
        near("all pairs", dense(|s| s.all), &reals(folder, "t")?, 1e-9, 1e-12);

        // Sums over regions, by way of the atoms (intersections with another over-segmentation).
        let region = labels(folder, "region")?;
        let count = region.iter().max().map_or(0, |&m| m as usize + 1);
        let mut of_atom = vec![0; n];
        atom.iter().zip(&region).for_each(|(&a, &r)| of_atom[a as usize] = r);
        let r = Regions::gather(&graph, &cell_columns(&graph, &x12, &thickness), &region, count, &sums, &of_atom, 1);
        // The prototype knows no thickness.
        let known = r.columns.iter().flat_map(|q| &q[..COLUMNS - 1]).copied();
        near("columns", known, &reals(folder, "q")?, 1e-6, 1e-3);
        let p = reals(folder, "p")?;
        for (k, m) in [&r.strength, &r.length, &r.convex].into_iter().enumerate() {
            near("boundaries", all(m), &p[k * count * count..(k + 1) * count * count], 1e-9, 1e-12);
        }
        near("convex pairs of regions", all(&r.seen), &reals(folder, "vr")?, 1e-9, 1e-12);
        near("pairs of regions", all(&r.all), &reals(folder, "tr")?, 1e-9, 1e-12);
        let (i, j) = (labels(folder, "cost_i")?, labels(folder, "cost_j")?);
        let costs = i.iter().zip(&j).map(|(&i, &j)| Model::default().log_cost(&r, i as usize, j as usize));
        near("costs", costs, &reals(folder, "cost")?, 1e-9, 1.0);
        // The labelling that the same C leads to.
        let (area, together) = (reals(folder, "atom_area")?, square(folder, "c")?);
        let pull = Pull { area: &area, together: &together };
        let some: Vec<u32> = (0..area.len() as u32).collect();
        let ours = pull.objective(&pull.best(&some, HALF), HALF);
        let theirs = pull.objective(&labels(folder, "found")?, HALF);
        assert!((theirs - info(folder, "objective")?).abs() < 1e-9, "the objective itself");
        eprintln!("{}: objective {ours:.9} against {theirs:.9}", folder.display());
        assert!(ours >= theirs - 1e-8, "labelling: {ours} against {theirs}");
        compared += 1;
    }
    eprintln!("{compared} models compared");
    Ok(())
}

/// Not a test but the measurement behind the table: decides all dumped models and writes labels
/// beside the dumps (`PARTS_SEEDS` seeds, 1 by default), for `tools/parts_reference.py score`.
#[test]
#[ignore = "a measurement: run it in release with PARTS_DUMP set"]
fn decide_the_dumped_models() -> Anything<()> {
    let seeds: u64 = std::env::var("PARTS_SEEDS").ok().and_then(|s| s.parse().ok()).unwrap_or(1);
    let mut seconds = [0.0; 3];
    let folders = dumps();
    for folder in &folders {
        let (graph, rows) = cells(folder)?;
        let given = info(folder, "parts")? as usize;
        for seed in 0..seeds {
            let run = Run { threads: 2, seed, ..Run::new(&()) };
            let all = [Decision::SoftTrees, Decision::Single, Decision::Consensus];
            for (k, (decision, name)) in all.into_iter().zip(["soft", "single", "consensus"]).enumerate() {
                let params = PartsParams { decision, ..PartsParams::default() };
                let start = Instant::now();
                let result = parts(&graph, &rows.values, rows.count, &params, &run)?;
                seconds[k] += start.elapsed().as_secs_f64();
                let exactly = result.tree.cut_for(PartCount::Exactly(given), 0.0)?;
                assert_eq!(exactly.parts, given);
                for (what, label) in [("found", &result.label), ("given", &exactly.label)] {
                    write(folder, &format!("{name}_{what}_{seed}"), label)?;
                }
            }
        }
    }
    let runs = (folders.len() as u64 * seeds).max(1) as f64;
    eprintln!(
        "mean ms: soft {:.1}, single {:.1}, consensus {:.1}",
        seconds[0] / runs * 1e3,
        seconds[1] / runs * 1e3,
        seconds[2] / runs * 1e3
    );
    Ok(())
}

/// Processor milliseconds of this thread so far: what others do on the machine does not count.
fn clock() -> f64 {
    let text = fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    text.split(' ').next().and_then(|x| x.parse::<f64>().ok()).unwrap_or(0.0) / 1e6
}

/// Not a test but the measurement of the stages, in processor time on one thread.
#[test]
#[ignore = "a measurement: run it in release with PARTS_DUMP set"]
fn time_the_stages() -> Anything<()> {
    let mut table: Vec<(&str, f64)> = Vec::new();
    let folders: Vec<PathBuf> = dumps().into_iter().step_by(8).collect();
    for folder in &folders {
        let (graph, rows) = cells(folder)?;
        let run = Run { threads: 1, ..Run::new(&()) };
        let mut last = clock();
        let mut lap = |name: &'static str| {
            let now = clock();
            match table.iter_mut().find(|t| t.0 == name) {
                Some(t) => t.1 += now - last,
                None => table.push((name, now - last)),
            }
            last = clock();
        };
        let shares = graph.area_shares();
        let mut random = stream(0, "time");
        for _ in 0..12 {
            let recipe = Recipe::draw(rows.count, &mut random);
            lap("draw");
            let x = anchor_embedding(&rows, &recipe.rows, &shares, recipe.kmeans.clusters, recipe.scale);
            lap("embedding");
            let label = recipe.kmeans.run(&x.values, &shares, &mut random);
            lap("k-means");
            let (piece, _) = connected_pieces(&graph.pairs, &label);
            std::hint::black_box(join_small(&graph.pairs, &graph.length, &shares, &piece, 0.001, 0));
            lap("pieces");
        }
        let members = draw_members(&graph, &rows, 12, "parts member", &run)?;
        lap("members");
        let atoms = Atoms::of(&graph, &rows, &members, &run)?;
        lap("atoms");
        std::hint::black_box(convexity(&graph, &log_thickness(&graph, &run)?, &atoms.of_cell, atoms.len(), &run)?);
        lap("of which convexity");
        let together = co_association(&graph, &atoms, &members, &Model::default(), &run)?;
        lap("trees and C");
        let pull = Pull { area: &atoms.area, together: &together };
        std::hint::black_box(pull.best(&(0..atoms.len() as u32).collect::<Vec<_>>(), HALF));
        lap("labelling");
        let tree = soft_hierarchy(&graph, &atoms, &together, 0.003, &run)?;
        lap("hierarchy with labelling");
        std::hint::black_box(tree.cut_k(9)?);
        lap("cut");
        let result = parts(&graph, &rows.values, rows.count, &PartsParams::default(), &run)?;
        lap("all");
        std::hint::black_box(result);
    }
    for (name, ms) in table {
        eprintln!("{name:<26} {:8.2} ms", ms / folders.len().max(1) as f64);
    }
    Ok(())
}

fn write(folder: &Path, name: &str, label: &[u32]) -> Anything<()> {
    use npyz::WriterBuilder;
    let file = std::io::BufWriter::new(fs::File::create(folder.join(name).with_extension("npy"))?);
    let mut out = npyz::WriteOptions::new().default_dtype().shape(&[label.len() as u64]).writer(file).begin_nd()?;
    out.extend(label.iter().copied())?;
    Ok(out.finish()?)
}
