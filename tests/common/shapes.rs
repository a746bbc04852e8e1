//! Small meshes made in code: a few plain shapes, and all that is odd about meshes.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// A mesh as arrays.
#[derive(Clone, Debug)]
pub struct Shape {
    pub name: &'static str,
    pub vertices: Vec<[f64; 3]>,
    pub faces: Vec<Vec<u32>>,
}

impl Shape {
    fn new<const N: usize>(name: &'static str, vertices: Vec<[f64; 3]>, faces: &[[u32; N]]) -> Self {
        Self { name, vertices, faces: faces.iter().map(|face| face.to_vec()).collect() }
    }

    /// The same shape under another name with every vertex changed.
    fn changed(mut self, name: &'static str, change: impl Fn([f64; 3]) -> [f64; 3]) -> Self {
        self.name = name;
        self.vertices.iter_mut().for_each(|v| *v = change(*v));
        self
    }

    /// Writes the shape as text with coordinates in full precision, `NAME.ply` in `folder`.
    pub fn write(&self, folder: &Path) -> PathBuf {
        let mut text = format!(
            "ply\nformat ascii 1.0\nelement vertex {}\nproperty double x\nproperty double y\nproperty double z\n\
             element face {}\nproperty list uchar uint vertex_indices\nend_header\n",
            self.vertices.len(),
            self.faces.len()
        );
        for [x, y, z] in &self.vertices {
            let _ = writeln!(text, "{x:?} {y:?} {z:?}");
        }
        for face in &self.faces {
            let _ = write!(text, "{}", face.len());
            face.iter().for_each(|v| {
                let _ = write!(text, " {v}");
            });
            text.push('\n');
        }
        let path = folder.join(format!("{}.ply", self.name));
        std::fs::write(&path, text).unwrap();
        path
    }
}

pub fn tetrahedron() -> Shape {
    let vertices = vec![[0., 0., 0.], [1., 0., 0.], [0., 1., 0.], [0., 0., 1.]];
    Shape::new("tetrahedron", vertices, &[[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
}

/// A grid of `n` × `n` squares, each two triangles, with a bump.
pub fn grid(n: u32) -> Shape {
    let mut vertices = Vec::new();
    for i in 0..=n {
        for j in 0..=n {
            let (x, y) = (f64::from(i) / f64::from(n), f64::from(j) / f64::from(n));
            vertices.push([x, y, 0.3 * (-8. * ((x - 0.4).powi(2) + (y - 0.3).powi(2))).exp() + 0.01 * x * y]);
        }
    }
    let at = |i: u32, j: u32| i * (n + 1) + j;
    let mut faces = Vec::new();
    for i in 0..n {
        for j in 0..n {
            faces.push([at(i, j), at(i + 1, j), at(i + 1, j + 1)]);
            faces.push([at(i, j), at(i + 1, j + 1), at(i, j + 1)]);
        }
    }
    Shape::new("grid", vertices, &faces)
}

/// A surface of revolution about x: `rings` rings of `sides` vertices with the given radius, closed by poles.
fn revolution(name: &'static str, rings: u32, sides: u32, radius: impl Fn(f64) -> f64) -> Shape {
    let along = |ring: u32| -1. + 2. * f64::from(ring + 1) / f64::from(rings + 1);
    let profile: Vec<[f64; 2]> = (0..rings).map(|ring| [along(ring), radius(along(ring))]).collect();
    revolved(name, [-1., 1.], &profile, sides)
}

/// A surface of revolution about x through `profile`, (x, radius) for each ring of `sides` vertices, closed by poles at these `ends`. Two
/// triangles for each side of each strip between rings, strip by strip, then those at the poles. Normals point away from the axis where x grows.
pub fn revolved(name: &'static str, ends: [f64; 2], profile: &[[f64; 2]], sides: u32) -> Shape {
    let mut vertices = ends.map(|x| [x, 0., 0.]).to_vec();
    for &[x, radius] in profile {
        for side in 0..sides {
            // A twist and a squash, so that nothing is symmetric.
            let angle = std::f64::consts::TAU * f64::from(side) / f64::from(sides) + 0.3 * x;
            vertices.push([x, radius * angle.cos(), 0.8 * radius * angle.sin()]);
        }
    }
    let at = |ring: u32, side: u32| 2 + ring * sides + side % sides;
    let last = profile.len() as u32 - 1;
    let mut faces = Vec::new();
    for ring in 0..last {
        for side in 0..sides {
            faces.push([at(ring, side), at(ring, side + 1), at(ring + 1, side + 1)]);
            faces.push([at(ring, side), at(ring + 1, side + 1), at(ring + 1, side)]);
        }
    }
    for side in 0..sides {
        faces.push([0, at(0, side + 1), at(0, side)]);
        faces.push([1, at(last, side), at(last, side + 1)]);
    }
    Shape::new(name, vertices, &faces)
}

/// Two unequal balls on a thin bar.
pub fn dumbbell() -> Shape {
    let ball = |x: f64, centre: f64, size: f64| (size * size - (x - centre).powi(2)).max(0.).sqrt();
    revolution("dumbbell", 41, 16, move |x| ball(x, -0.62, 0.4).max(ball(x, 0.7, 0.31)).max(0.08))
}

/// A strip with half a turn, wound consistently nowhere.
pub fn moebius(n: u32) -> Shape {
    let mut vertices = Vec::new();
    for i in 0..n {
        let angle = std::f64::consts::TAU * f64::from(i) / f64::from(n);
        for side in [-0.3, 0.3] {
            let r = 1. + side * (angle / 2.).cos();
            vertices.push([r * angle.cos(), r * angle.sin(), side * (angle / 2.).sin()]);
        }
    }
    let mut faces = Vec::new();
    for i in 0..n {
        let (a, b) = (2 * i, 2 * i + 1);
        let (c, d) = if i + 1 == n { (1, 0) } else { (a + 2, b + 2) };
        faces.push([a, c, d]);
        faces.push([a, d, b]);
    }
    Shape::new("moebius", vertices, &faces)
}

/// Every triangle of a shape with vertices of its own, as an STL file has them.
pub fn soup(shape: &Shape) -> Shape {
    let vertices: Vec<_> = shape.faces.iter().flatten().map(|&v| shape.vertices[v as usize]).collect();
    let mut next = 0;
    let faces = shape.faces.iter().map(|face| {
        next += face.len() as u32;
        (next - face.len() as u32..next).collect()
    });
    Shape { name: "soup", faces: faces.collect(), vertices }
}

/// Two shapes side by side in one mesh.
pub fn beside(name: &'static str, a: &Shape, b: &Shape, shift: [f64; 3]) -> Shape {
    let mut both = Shape { name, ..a.clone() };
    let first = a.vertices.len() as u32;
    both.vertices.extend(b.vertices.iter().map(|v| [0, 1, 2].map(|axis| v[axis] + shift[axis])));
    both.faces.extend(b.faces.iter().map(|face| face.iter().map(|v| v + first).collect::<Vec<_>>()));
    both
}

/// Plain shapes and odd ones: degenerate, not manifold, without a number, huge, tiny.
pub fn all() -> Vec<Shape> {
    let nan = f64::NAN;
    let mut all = vec![tetrahedron(), grid(8), dumbbell(), moebius(24)];
    let triangle = vec![[0., 0., 0.], [1., 0., 0.], [0., 1., 0.]];
    all.push(Shape::new("single", triangle.clone(), &[[0, 1, 2]]));
    // Two faces that share three edges.
    all.push(Shape::new("pillow", triangle.clone(), &[[0, 1, 2], [0, 2, 1]]));
    all.push(Shape::new("duplicates", triangle.clone(), &[[0, 1, 2], [0, 1, 2], [1, 2, 0], [2, 1, 0]]));
    let fins = vec![[0., 0., 0.], [0., 0., 1.], [1., 0., 0.5], [-0.5, 0.8, 0.5], [-0.5, -0.8, 0.5]];
    all.push(Shape::new("three_on_an_edge", fins, &[[0, 1, 2], [0, 1, 3], [0, 1, 4]]));
    all.push(beside("two_components", &tetrahedron(), &grid(4), [3., 0., 0.]));
    all.push(beside("touching_components", &grid(3), &grid(3), [1., 0., 0.]));
    all.push(soup(&dumbbell()));
    // Slivers around one vertex, ever thinner.
    let rim = (0..60).map(|k| 2f64.powi(-k)).map(|angle| [angle.cos(), angle.sin(), 0.]);
    let vertices: Vec<_> = std::iter::once([0., 0., 0.]).chain(rim).collect();
    let faces: Vec<_> = (1..60).map(|k| [0, k + 1, k]).collect();
    all.push(Shape::new("slivers", vertices, &faces));
    let mut holed = grid(6);
    holed.vertices[24] = [nan, 1., f64::INFINITY];
    all.push(Shape { name: "nan_vertex", ..holed });
    all.push(grid(3).changed("all_nan", |_| [nan; 3]));
    all.push(grid(4).changed("all_coincide", |_| [7., 7., 7.]));
    all.push(grid(4).changed("all_on_a_line", |[x, y, _]| [x + y, 0., 0.]));
    all.push(dumbbell().changed("huge", |v| v.map(|x| 1e30 * x)));
    all.push(dumbbell().changed("beyond_float", |v| v.map(|x| 1e200 * x)));
    all.push(dumbbell().changed("as_far_as_doubles_go", |v| v.map(|x| 1.7e308 * x)));
    all.push(dumbbell().changed("tiny", |v| v.map(|x| 1e-30 * x)));
    all.push(dumbbell().changed("subnormal", |v| v.map(|x| 1e-315 * x)));
    all.push(dumbbell().changed("far_off", |[x, y, z]| [x + 1e9, y - 1e9, z + 1e9]));
    let mut flat = grid(5);
    for face in flat.faces.iter_mut().step_by(3) {
        face[2] = face[0];
    }
    all.push(Shape { name: "repeated_vertices", ..flat });
    let mut odd = grid(3);
    odd.faces.extend([vec![], vec![4], vec![1, 2], vec![3, 3, 3], vec![5, 6, 5, 6]]);
    all.push(Shape { name: "faces_of_any_size", ..odd });
    let rim: Vec<[f64; 3]> =
        (0..50).map(|k| f64::from(k) / 50. * std::f64::consts::TAU).map(|a| [a.cos(), a.sin(), 0.]).collect();
    let mut lid = Shape { name: "fifty_corners", vertices: rim, faces: vec![(0..50).collect()] };
    lid.vertices.push([0., 0., 1.]);
    lid.faces.extend((0..50).map(|k| vec![(k + 1) % 50, k, 50]));
    all.push(lid);
    let mut loose = tetrahedron();
    loose.vertices.extend([[nan; 3], [1e5, 0., 0.], [-3., 4., 5.]]);
    all.push(Shape { name: "unreferenced", ..loose });
    // A thousand faces that share nothing at all.
    let tiny_components = |k: u32| f64::from(k.wrapping_mul(2_654_435_761) >> 8) / 16_777_216.;
    let corner = [[0., 0., 0.], [1e-3, 0., 0.], [0., 1e-3, 1e-4]];
    let place = |k: u32| [tiny_components(k), tiny_components(k + 5000), 0.01 * tiny_components(k + 9000)];
    let vertices: Vec<_> =
        (0..3000usize).map(|k| [0, 1, 2].map(|axis| place(k as u32 / 3)[axis] + corner[k % 3][axis])).collect();
    let faces: Vec<_> = (0..1000).map(|k| [3 * k, 3 * k + 1, 3 * k + 2]).collect();
    all.push(Shape::new("dust", vertices, &faces));
    // A hundred faces on one edge.
    let spokes = (0..100).map(|k| f64::from(k) * 0.0628).map(|a| [a.cos(), a.sin(), 0.5]);
    let vertices: Vec<_> = [[0., 0., 0.], [0., 0., 1.]].into_iter().chain(spokes).collect();
    let faces: Vec<_> = (0..100).map(|k| if k % 3 == 0 { [1, 0, k + 2] } else { [0, 1, k + 2] }).collect();
    all.push(Shape::new("book", vertices, &faces));
    // Wound as it comes.
    let mut mixed = dumbbell();
    mixed.faces.iter_mut().step_by(3).for_each(|face| face.reverse());
    all.push(Shape { name: "mixed_winding", ..mixed });
    let (a, b) = (tetrahedron(), tetrahedron().changed("", |v| v.map(|x| 1e-6 * x)));
    all.push(beside("a_speck", &a, &b, [0.2, 0.2, 0.2]));
    all
}
