//! User-defined pairs of landmarks: a text file with one pair per line, of vertices (two integers) or of points (six
//! numbers). Cost: one pass over the faces of each mesh, times the number of points.

use crate::base::printable::counted;
use crate::base::vector::distance;
use crate::base::{Error, Result};
use crate::graph::vertex_graph::triangles;
use crate::mesh::Mesh;
use crate::store::{Run, json};
use std::path::Path;

/// Faces between two checks of the stop flag.
const CHUNK: usize = 1 << 16;

/// A landmark on each mesh.
enum Pair {
    Vertices([u32; 2]),
    /// With the number of their line.
    Points(usize, [[f64; 3]; 2]),
}

/// Reads pairs (vertex of `a`, vertex of `b`); a point represents the nearest vertex that some triangle uses, which may
/// be as far away as the mesh is large. Commas count as blanks; the rest of a line after # is ignored.
///
/// # Errors
/// [`Error::Malformed`] naming the line, [`Error::Unusable`] for a file without pairs, [`Error::Io`],
/// [`Error::Cancelled`].
pub fn read(path: &Path, a: &Mesh, b: &Mesh, run: &Run) -> Result<Vec<(u32, u32)>> {
    let text = String::from_utf8(json::read_small(path)?)
        .map_err(|_| Error::unusable(path, "is not text", "write two vertices, or two points, in each line"))?;
    let mut pairs = Vec::new();
    for (k, line) in text.trim_start_matches('\u{feff}').lines().enumerate() {
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
            found.ok_or_else(|| wrong(format!("{word:?} is not a vertex of a mesh with {n} vertices")))
        };
        match words[..] {
            [] => {}
            [of_a, of_b] => pairs.push(Pair::Vertices([vertex(of_a, a)?, vertex(of_b, b)?])),
            [_, _, _, _, _, _] => {
                let numbers: Option<Vec<f64>> =
                    words.iter().map(|word| word.parse().ok().filter(|x: &f64| x.is_finite())).collect();
                let x = numbers.ok_or_else(|| wrong("contains a value that is not a number".into()))?;
                pairs.push(Pair::Points(k + 1, [[x[0], x[1], x[2]], [x[3], x[4], x[5]]]));
            }
            _ => return Err(wrong(format!("has {}", counted(words.len(), "number")))),
        }
    }
    if pairs.is_empty() {
        return Err(Error::unusable(path, "has no pair of landmarks", "write one pair per line"));
    }
    let on = |mesh: &Mesh, side: usize| {
        let point = |pair: &Pair| match pair {
            Pair::Vertices(_) => None,
            Pair::Points(line, points) => Some((*line, points[side])),
        };
        let (lines, points): (Vec<usize>, Vec<_>) = pairs.iter().filter_map(point).unzip();
        let Nearest { vertices, diagonal } = nearest(mesh, &points, run)?;
        if let Some((line, (square, _))) = lines.iter().zip(&vertices).find(|(_, near)| near.0.sqrt() > diagonal) {
            let (away, mesh) = (square.sqrt(), mesh.path().display());
            let problem = format!("a point is {away:.3e} away from {mesh}, whose diagonal is {diagonal:.3e}");
            let remedy = "give the point on A first, in the units of the mesh";
            return Err(Error::malformed(path, format!("line {line}"), problem, remedy));
        }
        Ok(vertices.into_iter().map(|(_, v)| v))
    };
    let mut near = on(a, 0)?.zip(on(b, 1)?);
    let vertices = |pair: &Pair| match pair {
        Pair::Vertices([a, b]) => Some((*a, *b)),
        Pair::Points(..) => near.next(),
    };
    Ok(pairs.iter().filter_map(vertices).collect())
}

/// What [`nearest`] finds.
struct Nearest {
    /// The squared distance and the number of the nearest vertex of each point.
    vertices: Vec<(f64, u32)>,
    /// The diagonal of the box around all triangles.
    diagonal: f64,
}

/// For each of `points` the nearest vertex that some triangle of `mesh` uses; of several, the first.
fn nearest(mesh: &Mesh, points: &[[f64; 3]], run: &Run) -> Result<Nearest> {
    let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    let mut best = vec![(f64::INFINITY, 0); points.len()];
    let n = if points.is_empty() { 0 } else { mesh.faces.len() };
    for start in (0..n).step_by(CHUNK) {
        run.cancel.check()?;
        mesh.faces.for_each(start..n.min(start + CHUNK), |_, corners| {
            triangles(mesh, corners, |triangle, at| {
                for (v, at) in triangle.into_iter().zip(at) {
                    for axis in 0..3 {
                        low[axis] = low[axis].min(at[axis]);
                        high[axis] = high[axis].max(at[axis]);
                    }
                    for (best, point) in best.iter_mut().zip(points) {
                        let square = at.iter().zip(point).map(|(x, y)| (x - y) * (x - y)).sum::<f64>();
                        if (square, v) < *best {
                            *best = (square, v);
                        }
                    }
                }
            });
        });
    }
    Ok(Nearest { vertices: best, diagonal: distance(low, high) })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Regression: the nearest of all vertices was taken, and rejected if no triangle used it.
    #[test]
    fn points_stand_for_vertices_of_triangles() {
        let square = [[9., 9., 9.], [0., 0., 0.], [1., 0., 0.], [1., 1., 0.], [0., 1., 0.], [0.9, 0.9, 0.]];
        let mesh = Mesh::from_slices(&square, &[vec![1, 2, 3, 4], vec![5, 0]]).unwrap();
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("pairs.txt");
        let pairs = |text: &str| {
            std::fs::write(&path, text).unwrap();
            read(&path, &mesh, &mesh, &Run::new(&()))
        };
        assert_eq!(pairs("5 0\n.9 .9 0, 1 2 0 # two points\n.1 0 0 .4 .6 0\n").unwrap(), [(5, 0), (3, 3), (1, 4)]);
        // Regression: points of another mesh, or in other units, became the nearest vertex without a word.
        let told = pairs("5 0\n.9 .9 0, 9 9 8\n").unwrap_err().to_string();
        assert!(told.contains("line 2: a point is 1.386e1 away from"), "{told}");
    }
}
