//! Labelled output holds the labels, keeps everything else, and opens again as the same mesh.

use crate::common::{self, reference};
use nystrom_stream::mesh::{self, Labelling, Mesh, PlyForm};
use nystrom_stream::store::Run;
use ply_rs_bw::ply::{DefaultElement, Ply, Property};
use std::path::Path;

const ADDED: [&str; 5] = ["label", "red", "green", "blue", "quality"];

fn open(path: &Path, scratch: &Path) -> Mesh {
    mesh::open(path, scratch, &Run { threads: 2, ..Run::new(&()) }).unwrap()
}

fn colours() -> Vec<[u8; 3]> {
    (0..7).map(|k| [k, 2 * k, 255 - k]).collect()
}

/// Labels `input` and returns the folder with `out.ply`.
fn label(input: &Path, form: PlyForm, stream: bool) -> (tempfile::TempDir, Mesh, Vec<f32>) {
    let dir = common::in_memory();
    let opened = open(input, dir.path());
    let run = Run { threads: 2, ..Run::new(&()) };
    let faces = opened.faces.len();
    let labels: Vec<u32> = (0..faces as u32).map(|f| f % 7).collect();
    let quality: Vec<f32> = (0..faces).map(|f| f as f32 / 3.0).collect();
    let labelling = Labelling { labels: &labels, colours: &colours(), quality: Some(&quality), names: &[], fine: None };
    let out = dir.path().join("out.ply");
    if stream {
        let mut file = std::fs::File::create(&out).unwrap();
        mesh::write_labelled_to(&opened, "<stdout>", &mut file, &labelling, form, &run).unwrap();
    } else {
        mesh::write_labelled(&opened, &out, &labelling, form, &run).unwrap();
    }
    assert!(!dir.path().join("out.ply.partial").exists());
    (dir, opened, quality)
}

#[test]
fn every_mesh_survives_labelling_in_every_form() {
    let Some(data) = common::data() else { return };
    let mut compared = 0;
    for folder in ["flavour", "nasty", "real"] {
        for entry in std::fs::read_dir(data.join(folder)).unwrap() {
            let input = entry.unwrap().path();
            let name = input.display().to_string();
            let scratch = common::in_memory();
            let bytes = std::fs::metadata(&input).unwrap().len();
            // The reference reader is slow; the real meshes are of the plainest forms.
            let large = bytes > if folder == "real" && !common::every_case() { 300_000 } else { 1_000_000 };
            // Those of five megabytes are written in as many pieces as any.
            if bytes > 10_000_000 && !common::every_case() {
                continue;
            }
            if mesh::open(&input, scratch.path(), &Run::new(&())).is_err() {
                continue;
            }
            let read = if large { None } else { reference(&input) };
            for (form, stream) in
                [(PlyForm::Same, false), (PlyForm::Same, true), (PlyForm::Binary, false), (PlyForm::Ascii, false)]
            {
                if large && (stream || form == PlyForm::Ascii) {
                    continue;
                }
                let (dir, before, quality) = label(&input, form, stream);
                let again = common::in_memory();
                let out = dir.path().join("out.ply");
                let after = open(&out, again.path());
                assert!(after.notes().is_empty(), "{name}: {:?}", after.notes());
                let same = |n: usize| (0..n as u32).collect::<Vec<u32>>();
                let (places, numbers) = (same(before.faces.len()), same(before.positions.len()));
                common::assert_rearranged(&name, &before, &after, &places, &numbers);
                if large {
                    continue;
                }
                let Some(written) = reference(&out) else { continue };
                compared += 1;
                for (f, face) in written.payload["face"].iter().enumerate() {
                    let k = (f % 7) as u8;
                    assert_eq!(face["label"], Property::Int(k.into()), "{name}");
                    assert_eq!(face["green"], Property::UChar(2 * k), "{name}");
                    assert_eq!(face["blue"], Property::UChar(255 - k), "{name}");
                    assert_eq!(face["quality"], Property::Float(quality[f]), "{name}");
                }
                if let Some(read) = &read {
                    assert_kept(&name, read, &written);
                }
            }
        }
    }
    assert!(compared > 150, "{compared}");
}

/// All that was in `read` and is not replaced is in `written`, values and order.
fn assert_kept(name: &str, read: &Ply<DefaultElement>, written: &Ply<DefaultElement>) {
    let kept = |comment: &String| written.header.comments.iter().any(|other| other.trim() == comment.trim());
    assert!(read.header.comments.iter().all(kept), "{name}");
    assert_eq!(read.header.obj_infos, written.header.obj_infos, "{name}");
    if read.payload.contains_key("tristrips") {
        return;
    }
    let names = |ply: &Ply<DefaultElement>| ply.header.elements.keys().cloned().collect::<Vec<_>>();
    assert_eq!(names(read), names(written), "{name}");
    for (element, records) in &read.payload {
        for (a, b) in records.iter().zip(&written.payload[element]) {
            for (property, value) in a {
                if element != "face" || !ADDED.contains(&property.as_str()) {
                    // As text, since NaN equals nothing.
                    assert_eq!(format!("{value:?}"), format!("{:?}", b[property]), "{name}: {element} {property}");
                }
            }
            let added = if element == "face" { 5 } else { 0 };
            let replaced = if element == "face" { a.keys().filter(|p| ADDED.contains(&p.as_str())).count() } else { 0 };
            assert_eq!(a.len() + added - replaced, b.len(), "{name}: {element}");
        }
    }
}

#[test]
fn labelling_a_labelled_file_again_changes_nothing() {
    let Some(data) = common::data() else { return };
    for input in ["real/horse_4k.ply", "flavour/plyrs_turk2.ply", "flavour/synth_be_float.ply"] {
        let (first, ..) = label(&data.join(input), PlyForm::Same, false);
        let (second, ..) = label(&first.path().join("out.ply"), PlyForm::Same, false);
        let read = |dir: &tempfile::TempDir| std::fs::read(dir.path().join("out.ply")).unwrap();
        assert_eq!(read(&first), read(&second), "{input}");
    }
}

#[test]
fn kept_text_stays_as_it_stands() {
    let dir = common::in_memory();
    let path = dir.path().join("in.ply");
    let text = "ply\nformat ascii 1.0\ncomment first\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement face 1\nproperty float quality\nproperty list uchar int vertex_indices\nobj_info inside\nproperty uchar alpha\nelement edge 1\nproperty int a\nend_header\n0.100 0 0\n1e0 0 0\n0 +1 nan\n0.5 3 0 1 2 255\n07\n";
    std::fs::write(&path, text).unwrap();
    let (out, ..) = label(&path, PlyForm::Same, false);
    let expected = "ply\nformat ascii 1.0\ncomment first\ncomment labelled by nystrom-stream\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement face 1\nproperty list uchar int vertex_indices\nobj_info inside\nproperty uchar alpha\nproperty int label\nproperty uchar red\nproperty uchar green\nproperty uchar blue\nproperty float quality\nelement edge 1\nproperty int a\nend_header\n0.100 0 0\n1e0 0 0\n0 +1 nan\n3 0 1 2 255 0 0 0 255 0.0\n07\n";
    assert_eq!(std::fs::read_to_string(out.path().join("out.ply")).unwrap(), expected);
}

#[test]
fn labels_that_do_not_fit_are_refused_and_leave_nothing() {
    let Some(data) = common::data() else { return };
    let dir = common::in_memory();
    let opened = open(&data.join("real/horse_4k.ply"), dir.path());
    let out = dir.path().join("out.ply");
    let run = Run::new(&());
    let write = |labels: &[u32]| {
        let labelling = Labelling { labels, colours: &[], quality: None, names: &[], fine: None };
        mesh::write_labelled(&opened, &out, &labelling, PlyForm::Same, &run)
    };
    assert!(write(&[0; 3999]).unwrap_err().to_string().starts_with("labels: 3999 values for 4000 faces"));
    run.cancel.cancel();
    assert!(write(&[0; 4000]).is_err());
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
}

#[test]
fn quality_of_the_input_stays_where_none_is_given() {
    let Some(data) = common::data() else { return };
    let dir = common::in_memory();
    let opened = open(&data.join("flavour/synth_le_faceprop_before_after.ply"), dir.path());
    let out = dir.path().join("out.ply");
    let labelling = Labelling { labels: &[3; 4000], colours: &colours(), quality: None, names: &[], fine: None };
    let run = Run::new(&());
    mesh::write_labelled(&opened, &out, &labelling, PlyForm::Same, &run).unwrap();
    let (before, after) = (reference(opened.path()).unwrap(), reference(&out).unwrap());
    for (a, b) in before.payload["face"].iter().zip(&after.payload["face"]) {
        assert_eq!(a["quality"], b["quality"]);
        assert_eq!(b["label"], Property::Int(3));
    }
}
