//! Scratch experiments; not kept.
use nystrom_stream::cluster::parts::{CellGraph, PartsParams, parts};
use nystrom_stream::store::Run;
use std::collections::HashMap;
use std::path::Path;

pub struct Case { pub of_node: Vec<u32>, pub cells: CellGraph, pub rows: Vec<f64>, pub l: usize }

fn npy_u32(p: &Path) -> Vec<u32> { let b = std::fs::read(p).unwrap(); let h = 10 + u16::from_le_bytes([b[8], b[9]]) as usize; b[h..].chunks_exact(4).map(|c| u32::from_le_bytes(c.try_into().unwrap())).collect() }
fn npy_f64(p: &Path) -> Vec<f64> { let b = std::fs::read(p).unwrap(); let h = 10 + u16::from_le_bytes([b[8], b[9]]) as usize; b[h..].chunks_exact(8).map(|c| f64::from_le_bytes(c.try_into().unwrap())).collect() }

pub fn load(dir: &Path) -> Option<Case> {
    let cells: CellGraph = serde_json::from_slice(&std::fs::read(dir.join("cell_graph.json")).ok()?).ok()?;
    let rows = npy_f64(&dir.join("cell_rows.npy"));
    Some(Case { of_node: npy_u32(&dir.join("cells.npy")), l: rows.len() / cells.area.len(), rows, cells })
}

pub fn rand_distance(a: &[u32], b: &[u32]) -> f64 {
    let mut t: HashMap<(u32, u32), f64> = HashMap::new();
    let (mut x, mut y): (HashMap<u32, f64>, HashMap<u32, f64>) = Default::default();
    for (&i, &j) in a.iter().zip(b) { *t.entry((i, j)).or_default() += 1.; *x.entry(i).or_default() += 1.; *y.entry(j).or_default() += 1.; }
    let s = |v: &mut dyn Iterator<Item = f64>| v.map(|c| c * c).sum::<f64>();
    let n = a.len() as f64;
    (s(&mut x.values().copied()) + s(&mut y.values().copied()) - 2. * s(&mut t.values().copied())) / (n * n)
}

fn labels(c: &Case, size: usize, seed: u64) -> (Vec<u32>, usize) {
    let run = Run { seed, threads: 2, ..Run::new(&()) };
    let params = PartsParams { ensemble_size: size, ..PartsParams::default() };
    let found = parts(&c.cells, &c.rows, c.l, &params, &run).unwrap();
    (c.of_node.iter().map(|&k| found.label[k as usize]).collect(), found.parts)
}

fn pairs(all: &[(Vec<u32>, usize)]) -> (f64, f64) {
    let mut d = Vec::new();
    for i in 0..all.len() { for j in 0..i { d.push(rand_distance(&all[i].0, &all[j].0)); } }
    (d.iter().sum::<f64>() / d.len() as f64, d.iter().copied().fold(0., f64::max))
}

fn main() {
    let args: Vec<String> = std::env::args().collect();
    let root = Path::new(&args[1]);
    let sizes: Vec<usize> = args[2].split(',').map(|s| s.parse().unwrap()).collect();
    let fixed = args.get(3).is_some_and(|s| s == "fixed");
    let mut names: Vec<_> = std::fs::read_dir(root).unwrap().map(|e| e.unwrap().path()).collect();
    names.sort();
    let mut total = vec![(0., 0., 0.); sizes.len()];
    for name in &names {
        let cases: Vec<Case> = (0..8).filter_map(|s| load(&name.join(s.to_string()))).collect();
        if cases.len() < 8 { continue }
        print!("{:24}", name.file_name().unwrap().to_string_lossy());
        for (k, &size) in sizes.iter().enumerate() {
            let t = std::time::Instant::now();
            let all: Vec<_> = (0..8u64).map(|s| labels(&cases[if fixed { 0 } else { s as usize }], size, s)).collect();
            let (mean, max) = pairs(&all);
            total[k].0 += mean; total[k].1 += max; total[k].2 += 1.;
            let counts: Vec<String> = all.iter().map(|a| a.1.to_string()).collect();
            print!(" | {mean:.4} {max:.3} [{}] {:.2}s", counts.join(" "), t.elapsed().as_secs_f64() / 8.);
        }
        println!();
    }
    for t in total { print!(" mean {:.4} max {:.4}", t.0 / t.2, t.1 / t.2); }
    println!();
}
