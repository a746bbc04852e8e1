//! Makes harder copies of a mesh, to see how steady a segmentation is: every triangle in four, noise along the normals,
//! a turned and rescaled copy, shuffled faces.
//!
//! `cargo run --release -p nystrom-stream-tools --bin subdivide -- IN.ply OUT.ply [--times 2] [--noise 0.15] [--turn 40] [--scale 3]
//! [--shuffle] [--seed S]`. The new mesh's face f lies in the old face ⌊f / 4^times⌋; where faces are shuffled,
//! OUT.npy beside the mesh has the old face of each. The mesh is written as it is made, a pass for each time over an
//! edge table in memory: about 100 bytes a new face. Triangles only.

use clap::Parser;
use nystrom_stream::base::random::{Random, below, stream, unit};
use nystrom_stream::base::{Error, Result};
use nystrom_stream::mesh;
use nystrom_stream::mesh::ply::{Encoding, HeaderWriter, Scalar};
use nystrom_stream::store::{Run, npy};
use std::collections::HashMap;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Make a finer, noisy, turned or shuffled copy of a triangle mesh.
#[derive(Parser)]
struct Options {
    /// The mesh
    input: PathBuf,
    /// The copy
    output: PathBuf,
    /// How many times every triangle is cut in four, at the middles of its edges
    #[arg(long, value_name = "N", default_value_t = 0)]
    times: u32,
    /// Deviation along the normals after that, in mean edges
    #[arg(long, value_name = "X", default_value_t = 0.)]
    noise: f64,
    /// Degrees turned about each axis in turn
    #[arg(long, value_name = "DEGREES", default_value_t = 0.)]
    turn: f64,
    /// Factor of all coordinates
    #[arg(long, value_name = "X", default_value_t = 1.)]
    scale: f64,
    /// Put faces and vertices in random order
    #[arg(long)]
    shuffle: bool,
    /// Seed of everything random
    #[arg(long, value_name = "S", default_value_t = 0)]
    seed: u64,
}

type Point = [f64; 3];

fn main() -> ExitCode {
    match run(&Options::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("subdivide: {error}");
            ExitCode::FAILURE
        }
    }
}

fn run(options: &Options) -> Result<()> {
    let scratch = tempfile::tempdir().map_err(Error::io(std::env::temp_dir(), "create a folder in"))?;
    let opened = mesh::open(&options.input, scratch.path(), &Run::new(&()))?;
    let mut points: Vec<Point> = (0..opened.positions.len() as u32).map(|v| opened.positions.get(v)).collect();
    let (mut faces, mut others) = (Vec::new(), 0);
    opened.faces.for_each(0..opened.faces.len(), |_, corners| match *corners {
        [a, b, c] => faces.push([a, b, c]),
        _ => others += 1,
    });
    if others > 0 {
        return Err(Error::unusable(
            &options.input,
            format!("{others} faces are no triangles"),
            "triangulate it first",
        ));
    }
    for _ in 0..options.times {
        quarter(&mut points, &mut faces);
    }
    if options.noise > 0. {
        shake(&mut points, &faces, options.noise, &mut stream(options.seed, "noise"));
    }
    for point in &mut points {
        *point = turned(*point, options.turn.to_radians()).map(|x| x * options.scale);
    }
    if options.shuffle {
        let mut draw = stream(options.seed, "shuffle");
        let order = permutation(faces.len(), &mut draw);
        faces = order.iter().map(|&f| faces[f as usize]).collect();
        let place = permutation(points.len(), &mut draw);
        let mut moved = points.clone();
        place.iter().zip(&points).for_each(|(&to, &point)| moved[to as usize] = point);
        points = moved;
        faces.iter_mut().flatten().for_each(|v| *v = place[*v as usize]);
        npy::write::<u32>(&options.output.with_extension("npy"), &order, 1, false)?;
    }
    write(&options.output, &points, &faces).map_err(Error::io(&options.output, "write"))
}

/// Cuts every triangle in four: face f becomes 4 f to 4 f + 3.
fn quarter(points: &mut Vec<Point>, faces: &mut Vec<[u32; 3]>) {
    let mut middles: HashMap<(u32, u32), u32> = HashMap::with_capacity(faces.len() * 3 / 2);
    let mut finer = Vec::with_capacity(4 * faces.len());
    for &[a, b, c] in faces.iter() {
        let mut middle = |u: u32, v: u32| {
            *middles.entry((u.min(v), u.max(v))).or_insert_with(|| {
                let (p, q) = (points[u as usize], points[v as usize]);
                points.push([0, 1, 2].map(|e| 0.5 * (p[e] + q[e])));
                points.len() as u32 - 1
            })
        };
        let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
        finer.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
    }
    *faces = finer;
}

/// Moves every vertex along its normal, by a normal deviate of `amount` mean edges.
fn shake(points: &mut [Point], faces: &[[u32; 3]], amount: f64, draw: &mut Random) {
    let mut normals = vec![[0f64; 3]; points.len()];
    let mut edges = 0.;
    for corners in faces {
        let [p, q, r] = corners.map(|v| points[v as usize]);
        let (a, b) = ([0, 1, 2].map(|e| q[e] - p[e]), [0, 1, 2].map(|e| r[e] - p[e]));
        let cross = [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
        for &v in corners {
            (0..3).for_each(|e| normals[v as usize][e] += cross[e]);
        }
        let third = [0, 1, 2].map(|e| r[e] - q[e]);
        edges += length(a) + length(b) + length(third);
    }
    let size = amount * edges / (3 * faces.len().max(1)) as f64;
    for (point, normal) in points.iter_mut().zip(&normals) {
        let by = size * deviate(draw) / length(*normal).max(1e-300);
        (0..3).for_each(|e| point[e] += by * normal[e]);
    }
}

fn length(a: Point) -> f64 {
    a.iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// A standard normal deviate, by Box and Muller.
fn deviate(draw: &mut Random) -> f64 {
    (-2. * (1. - unit(draw)).ln()).sqrt() * (std::f64::consts::TAU * unit(draw)).cos()
}

/// Turned by `angle` about x, then y, then z.
fn turned(point: Point, angle: f64) -> Point {
    let (sin, cos) = angle.sin_cos();
    (0..3).fold(point, |mut p, axis| {
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        (p[u], p[v]) = (cos * p[u] - sin * p[v], sin * p[u] + cos * p[v]);
        p
    })
}

/// A random order of 0 to n − 1.
fn permutation(n: usize, draw: &mut Random) -> Vec<u32> {
    let mut order: Vec<u32> = (0..n as u32).collect();
    for k in (1..n).rev() {
        order.swap(k, below(draw, k + 1));
    }
    order
}

fn write(path: &Path, points: &[Point], faces: &[[u32; 3]]) -> std::io::Result<()> {
    let mut out = BufWriter::new(std::fs::File::create(path)?);
    let mut header = HeaderWriter::new(Encoding::Little);
    header.element("vertex", points.len() as u64).positions(false);
    header.element("face", faces.len() as u64).corners(Scalar::U8, Scalar::I32);
    out.write_all(&header.finish())?;
    for x in points.iter().flatten() {
        out.write_all(&(*x as f32).to_le_bytes())?;
    }
    for face in faces {
        out.write_all(&[3])?;
        for v in face {
            out.write_all(&v.to_le_bytes())?;
        }
    }
    out.flush()
}
