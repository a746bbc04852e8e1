//! The creature is a mesh as segmentation wants it: closed, even, in scan order, its parts
//! divided by valleys.

use nystrom_stream::apps::creature::{Creature, Options};
use nystrom_stream::base::vector::{cross, dot, minus};
use std::collections::HashMap;

type Point = [f64; 3];

struct Mesh {
    points: Vec<Point>,
    faces: Vec<[u32; 3]>,
    truth: Vec<u32>,
}

fn make(options: Options) -> Mesh {
    let creature = Creature::new(&options).unwrap();
    Mesh {
        points: (0..creature.vertex_count()).map(|v| creature.position(v).map(f64::from)).collect(),
        faces: (0..creature.face_count()).map(|f| creature.face(f)).collect(),
        truth: (0..creature.face_count()).map(|f| creature.truth(f)).collect(),
    }
}

fn smooth(faces: u64) -> Mesh {
    make(Options { faces, ..Options::default() })
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

impl Mesh {
    fn corners(&self, face: usize) -> [Point; 3] {
        self.faces[face].map(|v| self.points[v as usize])
    }

    /// Normal with the length of twice the area.
    fn normal(&self, face: usize) -> Point {
        let [a, b, c] = self.corners(face);
        cross(minus(b, a), minus(c, a))
    }

    fn area(&self, face: usize) -> f64 {
        0.5 * dot(self.normal(face), self.normal(face)).sqrt()
    }

    /// The face of every directed edge; panics where one is used twice.
    fn directed_edges(&self) -> HashMap<(u32, u32), usize> {
        let mut edges = HashMap::new();
        for (f, face) in self.faces.iter().enumerate() {
            for k in 0..3 {
                assert_ne!(face[k], face[(k + 1) % 3]);
                assert!(edges.insert((face[k], face[(k + 1) % 3]), f).is_none(), "edge used twice in one direction");
            }
        }
        edges
    }

    /// Pairs of faces with a common edge (its ends third and fourth).
    fn pairs(&self) -> Vec<(usize, usize, u32, u32)> {
        let edges = self.directed_edges();
        let pair = |(&(a, b), &f): (&(u32, u32), &usize)| edges.get(&(b, a)).map(|&g| (f, g, a, b));
        edges.iter().filter(|((a, b), _)| a < b).filter_map(pair).collect()
    }

    fn components(&self) -> usize {
        fn root(parent: &mut [u32], mut v: u32) -> u32 {
            while parent[v as usize] != v {
                parent[v as usize] = parent[parent[v as usize] as usize];
                v = parent[v as usize];
            }
            v
        }
        let mut parent: Vec<u32> = (0..self.points.len() as u32).collect();
        for face in &self.faces {
            for k in 1..3 {
                let (a, b) = (root(&mut parent, face[0]), root(&mut parent, face[k]));
                parent[a as usize] = b;
            }
        }
        let mut used: Vec<u32> = self.faces.iter().map(|face| root(&mut parent, face[0])).collect();
        used.sort_unstable();
        used.dedup();
        used.len()
    }
}

#[test]
fn it_is_one_closed_oriented_sphere() {
    for faces in [1, 5_000, 20_000] {
        let mesh = smooth(faces);
        assert!(mesh.faces.len() as u64 >= faces);
        assert!(mesh.faces.iter().flatten().all(|&v| (v as usize) < mesh.points.len()));
        let edges = mesh.directed_edges();
        assert!(edges.keys().all(|&(a, b)| edges.contains_key(&(b, a))), "an open border");
        assert_eq!(mesh.components(), 1);
        let euler = mesh.points.len() as i64 - edges.len() as i64 / 2 + mesh.faces.len() as i64;
        assert_eq!(euler, 2);
        let volume: f64 = (0..mesh.faces.len())
            .map(|f| {
                let [a, b, c] = mesh.corners(f);
                dot(a, cross(b, c)) / 6.0
            })
            .sum();
        assert!((1.5..3.0).contains(&volume), "volume {volume}");
    }
}

#[test]
fn triangles_are_even_and_the_skin_does_not_fold() {
    let mesh = smooth(200_000);
    let n = mesh.faces.len();
    let mean = (0..n).map(|f| mesh.area(f)).sum::<f64>() / n as f64;
    // Longest edge over the height on it, 1 for the equilateral triangle.
    let aspects: Vec<f64> = (0..n)
        .map(|f| {
            let c = mesh.corners(f);
            let longest = (0..3).map(|k| minus(c[k], c[(k + 1) % 3])).map(|e| dot(e, e)).fold(0.0, f64::max);
            longest / (2.0 * mesh.area(f)) * 0.75f64.sqrt()
        })
        .collect();
    let uneven = (0..n).filter(|&f| !(0.2..5.0).contains(&(mesh.area(f) / mean))).count() as f64 / n as f64;
    let sharp = |&(f, g, _, _): &(usize, usize, u32, u32)| {
        dot(mesh.normal(f), mesh.normal(g)) < 0.8 * 4.0 * mesh.area(f) * mesh.area(g)
    };
    let folded = mesh.pairs().iter().filter(|pair| sharp(pair)).count();
    let (worst, middle) = (aspects.iter().copied().fold(0.0, f64::max), median(aspects));
    eprintln!("aspect median {middle:.2} worst {worst:.1}; {uneven:.4} uneven; {folded} folded");
    assert!(middle < 1.9 && worst < 8.0 && uneven < 0.05, "{middle} {worst} {uneven}");
    assert_eq!(folded, 0);
}

#[test]
fn parts_are_sizeable_and_meet_in_valleys() {
    let mesh = smooth(40_000);
    let names = Creature::part_names();
    let mut areas = vec![0.0; names.len()];
    (0..mesh.faces.len()).for_each(|f| areas[mesh.truth[f] as usize] += mesh.area(f));
    let total: f64 = areas.iter().sum();
    let shares: Vec<f64> = areas.iter().map(|area| area / total).collect();
    eprintln!("{names:?} {shares:.3?}");
    assert!(shares.iter().all(|&share| share > 0.01), "{shares:?}");

    let (mut inner, mut across) = (Vec::new(), Vec::new());
    for (f, g, a, b) in mesh.pairs() {
        let edge = minus(mesh.points[b as usize], mesh.points[a as usize]);
        let (m, n) = (mesh.normal(f), mesh.normal(g));
        // The edge runs along f's boundary: convex where the normals turn about it clockwise.
        let angle = dot(cross(m, n), edge).atan2(dot(m, n) * dot(edge, edge).sqrt()).to_degrees();
        if mesh.truth[f] == mesh.truth[g] { &mut inner } else { &mut across }.push(-angle);
    }
    let mean = |x: &[f64]| x.iter().sum::<f64>() / x.len() as f64;
    let concave = across.iter().filter(|&&angle| angle > 5.0).count() as f64 / across.len() as f64;
    eprintln!(
        "across borders: {} edges, mean {:.1}°, median {:.1}°, {concave:.3} above 5°; inside mean {:.2}°",
        across.len(),
        mean(&across),
        median(across.clone()),
        mean(&inner)
    );
    assert!(mean(&across) > 15.0 && concave > 0.95);
    assert!(mean(&inner) < 0.0, "a closed surface is convex on average");
}

#[test]
fn scan_order_keeps_neighbours_near() {
    let mesh = smooth(100_000);
    let n = mesh.faces.len() as f64;
    let pairs = mesh.pairs();
    let near = pairs.iter().filter(|(f, g, _, _)| (f.abs_diff(*g) as f64) < 2.0 * n.sqrt()).count() as f64;
    let mean = pairs.iter().map(|(f, g, _, _)| f.abs_diff(*g) as f64).sum::<f64>() / pairs.len() as f64;
    eprintln!("mean index difference {:.5} n; {:.4} within 2 sqrt n", mean / n, near / pairs.len() as f64);
    assert!(mean < 0.01 * n && near > 0.9 * pairs.len() as f64);
    let span = |face: &[u32; 3]| (face.iter().max().unwrap() - face.iter().min().unwrap()) as f64;
    let mean = mesh.faces.iter().map(span).sum::<f64>() / n;
    assert!(mean < 0.02 * n, "vertices of a face are {mean} apart");
}

#[test]
fn noise_moves_every_vertex_a_little() {
    let (plain, noisy) = (smooth(5_000), make(Options { faces: 5_000, noise: 0.1, ..Options::default() }));
    let moves: Vec<f64> =
        plain.points.iter().zip(&noisy.points).map(|(&a, &b)| dot(minus(a, b), minus(a, b)).sqrt()).collect();
    let edge = plain.pairs().into_iter().map(|(_, _, a, b)| {
        let e = minus(plain.points[a as usize], plain.points[b as usize]);
        dot(e, e).sqrt()
    });
    let edge = edge.sum::<f64>() / plain.pairs().len() as f64;
    let largest = moves.iter().copied().fold(0.0, f64::max) / edge;
    let middle = median(moves) / edge;
    assert!((0.09..0.11).contains(&largest) && (0.04..0.06).contains(&middle), "{largest} {middle}");
    assert_eq!(plain.faces, noisy.faces);
    let again = make(Options { faces: 5_000, noise: 0.1, seed: 1, ..Options::default() });
    assert_ne!(noisy.points, again.points);
}

#[test]
fn holes_open_that_many_borders() {
    let mesh = make(Options { faces: 20_000, holes: 7, seed: 5, ..Options::default() });
    assert!(mesh.faces.len() >= 20_000);
    let edges = mesh.directed_edges();
    let next: HashMap<u32, u32> =
        edges.keys().filter(|&&(a, b)| !edges.contains_key(&(b, a))).map(|&(a, b)| (b, a)).collect();
    let (mut seen, mut rings) = (std::collections::HashSet::new(), 0);
    for &start in next.keys() {
        let mut v = start;
        rings += usize::from(!seen.contains(&v));
        while seen.insert(v) {
            v = next[&v];
        }
    }
    assert_eq!(rings, 7);
    assert_eq!(mesh.components(), 1);
}
