//! Meshes of triangles longer than their features: parts are decided on shorter ones, and labels are those of the faces.

use nystrom_stream::apps::edits::Edits;
use nystrom_stream::store::Run;
use nystrom_stream::{Mesh, SaveOptions, Segmenter};
use std::collections::{BTreeMap, BTreeSet, HashMap};

/// Teeth of the comb.
const TEETH: usize = 5;

/// A back with teeth, as exported by CAD: two triangles for each rectangle of its outline and of both ends. Also the tooth
/// of each face, from 1; 0 for the back.
fn comb() -> (Mesh, Vec<u32>) {
    // The lines between rectangles, and their rectangles in one end: the back below, a tooth above each second one.
    let across: Vec<f64> = (0..=2 * TEETH).map(|k| 0.2 * (k / 2) as f64 + 0.1 * (k % 2) as f64).collect();
    let up = [0., 0.3, 1.];
    let back = (0..across.len() - 1).map(|i| (i, 0, 0));
    let teeth = (0..TEETH).map(|k| (2 * k, 1, k as u32 + 1));
    let rectangles: Vec<(usize, usize, u32)> = back.chain(teeth).collect();
    let (mut number, mut points) = (HashMap::new(), Vec::new());
    let mut corner = |i: usize, j: usize, end: usize| {
        *number.entry((i, j, end)).or_insert_with(|| {
            points.push([across[i], up[j], 0.12 * end as f64]);
            points.len() as u32 - 1
        })
    };
    // The sides of all rectangles; those of the outline have one rectangle.
    let mut sides: BTreeMap<[(usize, usize); 2], i32> = BTreeMap::new();
    let (mut quads, mut of_quad) = (Vec::new(), Vec::new());
    let mut own = BTreeMap::new();
    for &(i, j, part) in &rectangles {
        let ring = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)];
        quads.push([3, 2, 1, 0].map(|k: usize| corner(ring[k].0, ring[k].1, 0)));
        quads.push([0, 1, 2, 3].map(|k: usize| corner(ring[k].0, ring[k].1, 1)));
        of_quad.extend([part; 2]);
        for k in 0..4 {
            let side = [ring[k], ring[(k + 1) % 4]];
            match sides.remove(&[side[1], side[0]]) {
                Some(_) => {}
                None => drop(sides.insert(side, 1)),
            }
            own.insert(side, part);
        }
    }
    for side in sides.keys() {
        let [(a, b), (c, d)] = *side;
        quads.push([corner(a, b, 0), corner(c, d, 0), corner(c, d, 1), corner(a, b, 1)]);
        of_quad.push(own[side]);
    }
    let faces = quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    let of_face = of_quad.into_iter().flat_map(|part| [part; 2]).collect();
    (Mesh::from_vecs(points, faces).unwrap(), of_face)
}

/// Whether two labellings are the same but for numbers.
fn alike(a: &[u32], b: &[u32]) -> bool {
    let (mut there, mut back) = (HashMap::new(), HashMap::new());
    a.iter().zip(b).all(|(a, b)| *there.entry(a).or_insert(b) == b && *back.entry(b).or_insert(a) == a)
}

/// Regression: cut on its own faces, the comb was left whole.
#[test]
fn teeth_of_a_few_long_triangles_are_parts() {
    let (mesh, tooth) = comb();
    let found = Segmenter::new().run(&mesh).unwrap();
    assert!(alike(found.labels(), &tooth), "{:?}", found.labels());
    assert!(found.confidences().iter().all(|q| (0. ..=1.).contains(q)) && found.confidences().len() == tooth.len());
    let own = Segmenter::new().exact(true).run(&mesh).unwrap();
    assert!(!alike(own.labels(), &tooth));
}

/// Numbers of parts up to that of faces are exact, though parts of the finer mesh may have most of no face.
#[test]
fn as_many_parts_as_asked_for_have_faces() {
    let (mesh, tooth) = comb();
    for parts in [1, 2, 7, 20, tooth.len() / 2, tooth.len()] {
        let mut faces = vec![0; parts];
        let cut = Segmenter::new().parts(parts).run(&mesh).unwrap();
        cut.labels().iter().for_each(|&label| faces[label as usize] += 1);
        assert!(faces.iter().all(|faces| *faces > 0), "{parts}: {faces:?}");
        assert_eq!(cut.report().parts.iter().map(|part| part.faces).collect::<Vec<_>>(), faces);
    }
}

#[test]
fn edits_apply_to_faces() {
    let (mesh, mut tooth) = comb();
    let [a, b] = [1, 2].map(|own| tooth.iter().position(|tooth| *tooth == own).unwrap());
    let text = format!(
        r#"{{"format": "nystrom-stream edits", "version": 1, "edits": [{{"edit": "merge", "at": [{a}, {b}]}}]}}"#
    );
    let edits = Edits::of_text(text.as_bytes(), "edits.json".as_ref()).unwrap();
    let joined = Segmenter::new().edits(edits).run(&mesh).unwrap();
    tooth.iter_mut().filter(|tooth| **tooth == 2).for_each(|tooth| *tooth = 1);
    assert!(alike(joined.labels(), &tooth), "{:?}", joined.labels());
}

/// Where sides of the teeth and the back are flat, boundaries cross the faces.
#[test]
fn faces_are_split_where_the_short_triangles_change_their_label() {
    let (mesh, _) = comb();
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("comb.ply");
    let cut = Segmenter::new().run(&mesh).unwrap();
    assert!(cut.labelling().fine.is_some());
    cut.save_with(&path, &SaveOptions::new().split_faces(true)).unwrap();
    let written = Mesh::open(&path).unwrap();
    assert!(written.faces.len() > mesh.faces.len() && written.faces.len() < 5 * mesh.faces.len());
    let labels: BTreeSet<u32> = written.face_property("label", &Run::new(&())).unwrap().into_iter().collect();
    assert_eq!(labels.len(), cut.parts());
    assert!(Segmenter::new().exact(true).run(&mesh).unwrap().labelling().fine.is_none());
}
