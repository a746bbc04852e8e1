//! Pairs of landmarks given by hand: a text file with one pair per line, of vertices (two integers) or
//! of points (six numbers).

use crate::base::{Error, Result};
use crate::mesh::Mesh;
use std::path::Path;

/// Reads pairs (vertex of `a`, vertex of `b`); a point stands for the vertex nearest to it. Commas count as blanks;
/// what follows a # is skipped.
///
/// # Errors
/// [`Error::Malformed`] naming the line, [`Error::Unusable`] for a file without pairs, [`Error::Io`].
pub fn read(path: &Path, a: &Mesh, b: &Mesh) -> Result<Vec<(u32, u32)>> {
    let text = std::fs::read_to_string(path).map_err(Error::io(path, "read"))?;
    let mut pairs = Vec::new();
    for (k, line) in text.lines().enumerate() {
        let words: Vec<&str> =
            line.split('#').next().unwrap_or("").split([' ', '\t', ',', ';']).filter(|w| !w.is_empty()).collect();
        let wrong = |problem: String| {
            Error::malformed(
                path,
                format!("line {}", k + 1),
                problem,
                "give two vertices, or two points as six numbers",
            )
        };
        let vertex = |word: &str, mesh: &Mesh| {
            let n = mesh.positions.len();
            let found = word.parse::<u32>().ok().filter(|&v| (v as usize) < n);
            found.ok_or_else(|| wrong(format!("{word:?} is no vertex of a mesh of {n}")))
        };
        match words[..] {
            [] => {}
            [of_a, of_b] => pairs.push((vertex(of_a, a)?, vertex(of_b, b)?)),
            [_, _, _, _, _, _] => {
                let numbers: Option<Vec<f64>> =
                    words.iter().map(|word| word.parse().ok().filter(|x: &f64| x.is_finite())).collect();
                let x = numbers.ok_or_else(|| wrong("has what is no number".into()))?;
                pairs.push((nearest(a, [x[0], x[1], x[2]]), nearest(b, [x[3], x[4], x[5]])));
            }
            _ => return Err(wrong(format!("has {} numbers", words.len()))),
        }
    }
    if pairs.is_empty() {
        return Err(Error::unusable(path, "has no pair of landmarks", "write a pair a line"));
    }
    Ok(pairs)
}

/// The vertex nearest to `point`.
fn nearest(mesh: &Mesh, point: [f64; 3]) -> u32 {
    let square = |v: u32| mesh.positions.get(v).iter().zip(point).map(|(x, y)| (x - y) * (x - y)).sum::<f64>();
    let mut best = (0, f64::INFINITY);
    for v in 0..mesh.positions.len() as u32 {
        let there = square(v);
        if there < best.1 {
            best = (v, there);
        }
    }
    best.0
}
