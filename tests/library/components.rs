//! Connected components as parts, against a slow version.

use nystrom_stream::pipeline::{Cluster, TinyComponents};
use nystrom_stream::{Mesh, Segmenter};

/// Strips of triangles of different lengths and widths, their faces dealt out in turn so that hardly any two
/// consecutive faces are in one component.
fn strips(lengths: &[usize]) -> (Vec<[f64; 3]>, Vec<[u32; 3]>) {
    let (mut positions, mut dealt) = (Vec::new(), Vec::new());
    for (k, &length) in lengths.iter().enumerate() {
        let first = positions.len() as u32;
        positions.extend((0..length + 2).map(|i| [i as f64, 3. * k as f64 + (i % 2) as f64, 0.]));
        dealt.extend((0..length as u32).map(|i| (i, k, [0, 1, 2].map(|corner| first + i + corner))));
    }
    dealt.sort_unstable();
    (positions, dealt.into_iter().map(|(.., face)| face).collect())
}

/// The first face of each face's component: numbers spread over common edges until nothing changes.
fn first_faces(faces: &[[u32; 3]]) -> Vec<usize> {
    let joined = |a: &[u32; 3], b: &[u32; 3]| a.iter().filter(|corner| b.contains(corner)).count() >= 2;
    let mut first: Vec<usize> = (0..faces.len()).collect();
    loop {
        let before = first.clone();
        for (i, a) in faces.iter().enumerate() {
            first[i] = (0..faces.len()).filter(|&j| joined(a, &faces[j])).map(|j| first[j]).min().unwrap();
        }
        if first == before {
            return first;
        }
    }
}

/// Components by descending number of faces, which all have the same area, then by their first faces.
fn slowly(faces: &[[u32; 3]]) -> Vec<u32> {
    let first = first_faces(faces);
    let size = |face: usize| first.iter().filter(|&&other| other == face).count();
    let mut all: Vec<usize> = (0..faces.len()).filter(|&face| first[face] == face).collect();
    all.sort_by_key(|&face| (std::cmp::Reverse(size(face)), face));
    first.iter().map(|face| all.iter().position(|other| other == face).unwrap() as u32).collect()
}

#[test]
fn components_are_numbered_by_descending_area() {
    let (positions, faces) = strips(&[3, 40, 1, 17, 17, 2, 90, 1, 5]);
    let mesh = Mesh::from_slices(&positions, &faces).unwrap();
    let segmenter = Segmenter::new().method(Cluster::Components);
    let cut = segmenter.run(&mesh).unwrap();
    assert_eq!(cut.labels(), slowly(&faces));
    let counts: Vec<u64> = cut.report().parts.iter().map(|part| part.faces).collect();
    assert_eq!(counts, [90, 40, 17, 17, 5, 3, 2, 1, 1]);
    assert!(cut.report().parts.iter().all(|part| (part.area - part.faces as f64).abs() < 1e-5));
    assert!(cut.confidences().iter().all(|&confidence| confidence == 1.));
    for threads in [1, 3] {
        let again = segmenter.clone().threads(threads).memory(1 << 20).run(&mesh).unwrap();
        assert_eq!(again.labels(), cut.labels());
    }
}

/// Components below .5 % of the area, and below a tenth of the largest, share the last part.
#[test]
fn tiny_components_share_a_part_on_request() {
    let (positions, faces) = strips(&[1, 300, 2, 150, 1]);
    let mesh = Mesh::from_slices(&positions, &faces).unwrap();
    let segmenter = Segmenter::new().method(Cluster::Components).tiny_components(TinyComponents::Own);
    let cut = segmenter.run(&mesh).unwrap();
    let expected: Vec<u32> = slowly(&faces).into_iter().map(|label| label.min(2)).collect();
    assert_eq!(cut.labels(), expected);
    assert_eq!((cut.report().tiny_components_label, cut.report().tiny_component_faces), (Some(2), 4));
}

#[test]
fn a_connected_mesh_is_one_part() {
    let (positions, faces) = strips(&[7]);
    let mesh = Mesh::from_slices(&positions, &faces).unwrap();
    let cut = Segmenter::new().method(Cluster::Components).run(&mesh).unwrap();
    assert_eq!((cut.labels(), cut.parts()), (&[0; 7][..], 1));
    assert!(cut.report().notes.iter().any(|note| note.contains("all faces are connected")));
}

#[test]
fn options_without_effect_are_refused() {
    let (positions, faces) = strips(&[7, 3]);
    let mesh = Mesh::from_slices(&positions, &faces).unwrap();
    let components = Segmenter::new().method(Cluster::Components);
    // Regression: of a range it was `parts` that the error named.
    for (segmenter, told) in [
        (components.clone().parts(2), "parts: there are as many parts as connected components"),
        (components.parts_between(2, 3), "parts_between: there are as many parts as connected components"),
        (Segmenter::new().parts_between(0, 3), "parts_between: 0 parts; choose at least 1"),
    ] {
        let error = segmenter.run(&mesh).unwrap_err().to_string();
        assert!(error.starts_with(told), "{error}");
    }
}

/// Regression: a thousand like pieces were cut into fewer parts without a word, since pieces that are small beside the
/// mean part join a neighbour.
#[test]
fn pieces_that_share_a_part_are_told() {
    let corners = |k: usize| [0, 1, 2, 3].map(|i| [(3 * (k % 40) + i % 2) as f64, (3 * (k / 40) + i / 2) as f64, 0.]);
    let squares = |count: usize| {
        let faces: Vec<[u32; 3]> =
            (0..count as u32).flat_map(|k| [[0, 1, 2], [2, 1, 3]].map(|f| f.map(|v| 4 * k + v))).collect();
        Mesh::from_vecs((0..count).flat_map(corners).collect(), faces).unwrap()
    };
    let told = |count, segmenter: Segmenter| {
        let cut = segmenter.run(&squares(count)).unwrap();
        let note = format!("some of the {count} separate pieces share a part: as connected components each is a part");
        (cut.parts(), cut.report().notes.iter().any(|told| told.starts_with(&note)))
    };
    let (parts, noted) = told(2_600, Segmenter::new());
    assert!((500..2_600).contains(&parts) && noted, "{parts}");
    assert_eq!(told(2_600, Segmenter::new().method(Cluster::Components)), (2_600, false));
    assert_eq!(told(20, Segmenter::new()), (20, false));
}
