//! Faces that occur twice, as on two-sided models: the parts are those of the surface, and both faces get one label.

use super::common;
use nystrom_stream::apps::evaluate::{contingency, rand};
use nystrom_stream::apps::measure;
use nystrom_stream::graph::DualGraph;
use nystrom_stream::store::{Budget, Context, Run, WorkDir};
use nystrom_stream::{Mesh, Segmenter};

type Arrays = (Vec<[f64; 3]>, Vec<[u32; 3]>);

/// How the second face of each is stored.
#[derive(Clone, Copy, Debug)]
enum Twice {
    /// After all first ones, in the same winding.
    Appended,
    /// Right after the first, in the opposite winding.
    BackToBack,
    /// In the opposite winding, faces in reverse order, and every face with vertices of its own.
    Soup,
    /// After all first ones, in the opposite winding and with vertices of their own.
    Apart,
}

/// The mesh with every face twice, and the two places of each face.
fn twice((points, faces): &Arrays, how: Twice) -> (Mesh, Vec<[usize; 2]>) {
    let n = faces.len();
    let back = |face: &[u32; 3]| [face[2], face[1], face[0]];
    let (all, places): (Vec<_>, Vec<_>) = match how {
        Twice::Appended => ([&faces[..], &faces[..]].concat(), (0..n).map(|f| [f, n + f]).collect()),
        Twice::BackToBack => {
            (faces.iter().flat_map(|face| [*face, back(face)]).collect(), (0..n).map(|f| [2 * f, 2 * f + 1]).collect())
        }
        Twice::Soup => {
            let all: Vec<[u32; 3]> = faces.iter().copied().chain(faces.iter().rev().map(back)).collect();
            let points = all.iter().flatten().map(|&v| points[v as usize]).collect();
            let own = (0..all.len() as u32).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect();
            return (Mesh::from_vecs(points, own).unwrap(), (0..n).map(|f| [f, 2 * n - 1 - f]).collect());
        }
        Twice::Apart => {
            let own = |face: &[u32; 3]| back(face).map(|v| v + points.len() as u32);
            let all = faces.iter().copied().chain(faces.iter().map(own)).collect();
            let points = [&points[..], &points[..]].concat();
            return (Mesh::from_vecs(points, all).unwrap(), (0..n).map(|f| [f, n + f]).collect());
        }
    };
    (Mesh::from_vecs(points.clone(), all).unwrap(), places)
}

const HOW: [Twice; 4] = [Twice::Appended, Twice::BackToBack, Twice::Soup, Twice::Apart];

/// Regression: with every face right after its other side, the two were joined as at a fold by 180°, and any surface was
/// one part.
#[test]
fn the_parts_of_a_two_sided_surface_are_those_of_its_front() {
    let once = common::arrays(&Mesh::creature(12_700).unwrap());
    let (n, segmenter) = (once.1.len(), Segmenter::new());
    let expected = segmenter.run(&Mesh::from_vecs(once.0.clone(), once.1.clone()).unwrap()).unwrap();
    assert_eq!(expected.report().input.duplicate_faces, 0);
    for how in HOW {
        let (mesh, places) = twice(&once, how);
        let found = segmenter.run(&mesh).unwrap();
        let input = &found.report().input;
        let counts = [input.duplicate_faces, input.components, input.nonmanifold_edges, input.boundary_edges];
        assert_eq!(counts, [n as u64, 1, 0, 0], "{how:?}");
        assert!(found.report().notes.iter().any(|note| note.contains("faces lie exactly where another one lies")));
        let label = |side: usize| places.iter().map(|place| found.labels()[place[side]]).collect::<Vec<u32>>();
        assert!(label(0) == label(1), "{how:?}: two sides with different labels");
        assert_eq!(found.parts(), expected.parts(), "{how:?}");
        let apart = rand(&contingency(&label(0), expected.labels(), None).unwrap());
        assert!(apart < 0.02, "{how:?}: {apart}");
    }
}

/// Without its duplicates, the graph is that of the mesh that has each face once, whatever the budget.
#[test]
fn duplicates_hang_on_the_graph_of_the_others() {
    let once = common::arrays(&Mesh::creature(40_000).unwrap());
    let n = once.1.len() as u32;
    let build = |mesh: &Mesh, run: &Run, dir: &tempfile::TempDir| {
        let work = WorkDir::temporary(dir.path()).unwrap();
        DualGraph::build(mesh, "mesh".as_ref(), &"mesh".into(), Context::new(&work, run)).unwrap()
    };
    let dir = common::in_memory();
    let single = build(&Mesh::from_vecs(once.0.clone(), once.1.clone()).unwrap(), &Run::new(&()), &dir);
    for how in HOW {
        let (mesh, places) = twice(&once, how);
        let mut face = vec![0; 2 * n as usize];
        places.iter().enumerate().for_each(|(f, place)| face[place[0].min(place[1])] = f as u32);
        for budget in [1 << 30, 4 << 20, 1 << 20] {
            let run = Run { budget: Budget::new(budget), ..Run::new(&()) };
            let graph = build(&mesh, &run, &dir);
            let first = graph.duplicates.as_deref().unwrap();
            assert_eq!((graph.facts.duplicate_faces, graph.facts.components), (u64::from(n), 1));
            assert_eq!(graph.facts.unoriented_edges, 0, "{how:?} {budget}");
            assert!((graph.facts.area / single.facts.area - 1.).abs() < 1e-9);
            for place in &places {
                let [a, b] = [place[0].min(place[1]), place[0].max(place[1])];
                assert_eq!((first[a], first[b] as usize), (0, a + 1), "{how:?} {budget}");
                let beside: Vec<u32> = graph.edges.by_shared_edge().neighbours(b as u32).map(|(to, _)| to).collect();
                assert_eq!((beside, graph.nodes.area(b)), (vec![a as u32], 0.));
                assert_eq!(graph.nodes.at(a).normal, graph.nodes.at(b).normal, "{how:?} {budget}");
                let mut own: Vec<(u32, f32)> = graph.edges.by_shared_edge().neighbours(a as u32).collect();
                own.retain(|(to, _)| first[*to as usize] == 0);
                own.iter_mut().for_each(|(to, _)| *to = face[*to as usize]);
                own.sort_by_key(|(to, _)| *to);
                let mut expected: Vec<_> = single.edges.by_shared_edge().neighbours(face[a]).collect();
                expected.sort_by_key(|(to, _)| *to);
                assert_eq!(own, expected, "{how:?} {budget}");
            }
        }
    }
}

/// Vertices and faces of a box of unit squares, `size` of them along each axis, from `low` on.
fn block(low: [i32; 3], size: [i32; 3]) -> (Vec<[i32; 3]>, Vec<[usize; 3]>) {
    let (mut points, mut faces) = (Vec::new(), Vec::new());
    for axis in 0..3 {
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        for (side, i, j) in (0..2).flat_map(|s| (0..size[u]).flat_map(move |i| (0..size[v]).map(move |j| (s, i, j)))) {
            let corner = |di: i32, dj: i32| {
                let mut p = low;
                (p[u], p[v]) = (p[u] + i + di, p[v] + j + dj);
                p[axis] += side * size[axis];
                p
            };
            let first = points.len();
            points.extend([corner(0, 0), corner(1, 0), corner(1, 1), corner(0, 1)]);
            // The diagonal is the same on both sides of a contact.
            let [a, b, c, d] = if side == 1 { [0, 1, 2, 3] } else { [0, 3, 2, 1] }.map(|k| first + k);
            faces.extend([[a, b, c], [a, c, d]]);
        }
    }
    (points, faces)
}

/// A mesh of blocks, with one vertex for each place.
fn blocks(all: &[([i32; 3], [i32; 3])]) -> Arrays {
    let (mut places, mut faces): (Vec<[i32; 3]>, Vec<[u32; 3]>) = (Vec::new(), Vec::new());
    let mut numbers = std::collections::HashMap::new();
    for &(low, size) in all {
        let (points, own) = block(low, size);
        let number: Vec<u32> = points
            .into_iter()
            .map(|p| {
                *numbers.entry(p).or_insert_with(|| {
                    places.push(p);
                    places.len() as u32 - 1
                })
            })
            .collect();
        faces.extend(own.into_iter().map(|face| face.map(|k| number[k])));
    }
    (places.into_iter().map(|p| p.map(f64::from)).collect(), faces)
}

/// A sheet with both sides is a sheet, also where each side has vertices of its own, of which only the rim coincides.
#[test]
fn a_sheet_with_two_sides_is_one_sheet() {
    let at = |x: u32, y: u32| 41 * y + x;
    let points = (0..41 * 21).map(|v| [f64::from(v % 41), f64::from(v / 41), (f64::from(v % 41) / 6.).sin()]).collect();
    let square = |x, y| [[at(x, y), at(x + 1, y), at(x + 1, y + 1)], [at(x, y), at(x + 1, y + 1), at(x, y + 1)]];
    let faces = (0..20).flat_map(|y| (0..40).flat_map(move |x| square(x, y))).collect::<Vec<_>>();
    let once = (points, faces);
    for how in HOW {
        let (mesh, places) = twice(&once, how);
        let found = Segmenter::new().parts(3).run(&mesh).unwrap();
        assert_eq!(found.report().input.duplicate_faces, 1600, "{how:?}");
        assert_eq!(found.report().input.boundary_edges, 120, "{how:?}");
        assert!(places.iter().all(|&[a, b]| found.labels()[a] == found.labels()[b]), "{how:?}");
    }
}

/// Where two bodies touch, each keeps its own faces: without one of them, its winding would follow from the other body.
#[test]
fn faces_in_a_contact_of_two_bodies_are_no_duplicates() {
    let touching = blocks(&[([0, 0, 0], [8, 8, 8]), ([2, 2, 8], [4, 4, 4])]);
    let (_, alone) = blocks(&[([2, 2, 8], [4, 4, 4])]);
    let mesh = Mesh::from_vecs(touching.0.clone(), touching.1.clone()).unwrap();
    let found = Segmenter::new().parts(2).run(&mesh).unwrap();
    assert_eq!((found.report().input.duplicate_faces, found.report().input.components), (0, 2));
    // Two cubes of the same size, each with vertices of its own.
    let (mut points, mut faces) = blocks(&[([0, 0, 0], [4, 4, 4])]);
    let other: Vec<_> = faces.iter().map(|face| face.map(|v| v + points.len() as u32)).collect();
    points.extend(points.clone().iter().map(|p| [p[0], p[1], p[2] + 4.]));
    faces.extend(other);
    let found = Segmenter::new().parts(2).run(&Mesh::from_vecs(points, faces).unwrap()).unwrap();
    assert_eq!((found.report().input.duplicate_faces, found.report().input.components), (0, 2));
    // A sheet that sticks out of the block is two-sided, although it touches it.
    let (mut points, mut with_sheet) = touching;
    with_sheet.truncate(with_sheet.len() - alone.len());
    let first = points.len() as u32;
    points.extend((1..=6).flat_map(|z| (0..9).map(move |y| [8., f64::from(y), 8. + f64::from(z)])));
    let rim: Vec<u32> =
        (0..9).map(|y| points.iter().position(|p| *p == [8., f64::from(y), 8.]).unwrap() as u32).collect();
    let at = |y: u32, z: u32| if z == 0 { rim[y as usize] } else { first + (z - 1) * 9 + y };
    let mut count = 0;
    for (y, z) in (0..8).flat_map(|y| (0..6).map(move |z| (y, z))) {
        let quad = [at(y, z), at(y + 1, z), at(y + 1, z + 1), at(y, z + 1)];
        for [a, b, c] in [[quad[0], quad[1], quad[2]], [quad[0], quad[2], quad[3]]] {
            with_sheet.extend([[a, b, c], [c, b, a]]);
            count += 1;
        }
    }
    let mesh = Mesh::from_vecs(points, with_sheet).unwrap();
    let found = Segmenter::new().parts(2).run(&mesh).unwrap();
    assert_eq!(found.report().input.duplicate_faces, count);
}

/// `mesh` with a flap on every `step`-th face: two triangles back to back, closed in themselves, on two edges of the
/// surface, as decimation leaves them. And how many there are.
fn with_flaps((points, faces): &Arrays, step: usize) -> (Mesh, usize) {
    let mut opposite = std::collections::HashMap::new();
    for &[a, b, c] in faces {
        [(a, b, c), (b, c, a), (c, a, b)].iter().for_each(|&(from, to, third)| _ = opposite.insert((from, to), third));
    }
    let mut all = faces.clone();
    for &[a, b, c] in faces.iter().step_by(step) {
        let d = opposite[&(c, b)];
        all.extend([[a, b, d], [d, b, a]]);
    }
    let count = all.len() - faces.len();
    (Mesh::from_vecs(points.clone(), all).unwrap(), count)
}

/// Regression: a dragon of 48,000 faces, 2,500 of them in such flaps, had 4 to 6 parts instead of 13 to 14: chains of
/// faces at the flaps' edges tore the surface below.
#[test]
fn the_parts_of_a_surface_with_flaps_are_those_of_the_surface() {
    let once = common::arrays(&Mesh::creature(20_000).unwrap());
    let n = once.1.len();
    let expected = Segmenter::new().run(&Mesh::from_vecs(once.0.clone(), once.1.clone()).unwrap()).unwrap();
    let (mesh, count) = with_flaps(&once, 12);
    let mut first: Option<Vec<u32>> = None;
    for memory in [1 << 30, 8 << 20] {
        let found = Segmenter::new().memory(memory).run(&mesh).unwrap();
        let input = &found.report().input;
        let counts = [input.duplicate_faces, input.components, input.boundary_edges, input.flipped_faces];
        assert_eq!(counts, [count as u64, 1, 0, 0]);
        assert_eq!((input.nonmanifold_edges > count as u64 / 2, input.unoriented_edges), (true, 0));
        assert_eq!(found.parts(), expected.parts());
        let apart = rand(&contingency(&found.labels()[..n], expected.labels(), None).unwrap());
        assert!(apart < 0.02, "{apart}");
        assert!(*first.get_or_insert_with(|| found.labels().to_vec()) == found.labels(), "{memory}");
    }
}

/// Where materials meet at an edge, each is a body of its own.
#[test]
fn three_bodies_around_an_edge_stay_apart() {
    let all = [([0, 0, 0], [4, 4, 4]), ([4, 0, 0], [4, 4, 4]), ([0, 4, 0], [8, 4, 4])];
    let (points, faces) = blocks(&all);
    for turn in 0..5 {
        let mut faces = faces.clone();
        faces.sort_by_key(|face| face.iter().map(|&v| u64::from(v) * 7919 % (31 + turn)).sum::<u64>());
        let mesh = Mesh::from_vecs(points.clone(), faces).unwrap();
        let dir = common::in_memory();
        let (work, run) = (WorkDir::temporary(dir.path()).unwrap(), Run::new(&()));
        let graph = DualGraph::build(&mesh, "mesh".as_ref(), &"mesh".into(), Context::new(&work, &run)).unwrap();
        let facts = &graph.facts;
        assert_eq!(
            [facts.components, facts.duplicate_faces, facts.unoriented_edges, facts.flipped_faces],
            [3, 0, 0, 0]
        );
    }
}

#[test]
fn a_surface_is_measured_once() {
    let cube = blocks(&[([0, 0, 0], [3, 3, 3])]);
    for how in HOW {
        let (mesh, _) = twice(&cube, how);
        let dir = common::in_memory();
        let (work, run) = (WorkDir::temporary(dir.path()).unwrap(), Run::new(&()));
        let measures = measure::mesh(&mesh, Context::new(&work, &run)).unwrap();
        assert_eq!((measures.duplicate_faces, measures.components, measures.all.open_edges), (108, 1, 0), "{how:?}");
        assert!((measures.all.area - 54.).abs() < 1e-9, "{how:?}: {measures:?}");
        assert!((measures.all.volume.unwrap() - 27.).abs() < 1e-9, "{how:?}: {measures:?}");
    }
}
