//! `picture` and `segment -o x.png` from the command line.

use crate::common::{errors, in_memory, ok, program, run, shapes, word};
use nystrom_stream::apps::colours::palette;
use std::ffi::OsStr;
use std::os::unix::ffi::OsStrExt;
use std::path::Path;

/// A tetrahedron with labels and colours on its faces.
fn labelled(path: &Path) {
    let text = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
        element face 4\nproperty list uchar int vertex_indices\nproperty int label\nproperty uchar red\n\
        property uchar green\nproperty uchar blue\nend_header\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n\
        3 0 2 1 0 200 0 0\n3 0 1 3 0 200 0 0\n3 0 3 2 1 0 200 0\n3 1 2 3 -1 0 0 200\n";
    std::fs::write(path, text).unwrap();
}

/// Width, height and bytes a pixel of a PNG.
fn facts(path: &Path) -> (u32, u32, usize) {
    let decoder = png::Decoder::new(std::io::BufReader::new(std::fs::File::open(path).unwrap()));
    let mut reader = decoder.read_info().unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut pixels).unwrap();
    assert!(pixels.iter().any(|&byte| byte != pixels[0]));
    (info.width, info.height, info.color_type.samples())
}

#[test]
fn labelled_meshes_become_pictures() {
    let dir = in_memory();
    let mesh = dir.path().join("m.ply");
    labelled(&mesh);
    ok(&["picture", "-q", word(&mesh)]);
    assert_eq!(facts(&dir.path().join("m.png")), (1600, 1200, 3));
    let out = dir.path().join("o.png");
    let options = ["--size", "320x200", "--views", "4", "--transparent", "--up", "-z", "-o", word(&out)];
    ok(&[&["picture", word(&mesh)], &options[..]].concat());
    assert_eq!(facts(&out), (320, 200, 4));
    let labels = dir.path().join("l.seg");
    std::fs::write(&labels, "0\n1\n2\n3\n").unwrap();
    ok(&["picture", word(&mesh), "--size=64x64", "-o", word(&out), "--labels", word(&labels)]);
    assert_eq!(facts(&out), (64, 64, 3));
    // Nothing temporary stays behind.
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 4);
}

/// Regression: bytes that are no UTF-8 were replaced in names of outputs, so that two meshes had the same one.
#[test]
fn outputs_beside_a_mesh_keep_the_bytes_of_its_name() {
    let dir = in_memory();
    let named = |name: &[u8]| dir.path().join(OsStr::from_bytes(name));
    for name in [&b"\xfe"[..], b"\xff"] {
        let mesh = named(&[name, b".PLY"].concat());
        labelled(&mesh);
        for command in ["picture", "sequence", "segment"] {
            let output = program().arg(command).arg(&mesh).arg("-q").output().unwrap();
            assert!(output.status.success(), "{command}: {}", errors(&output));
        }
        for ending in [&b".png"[..], b".sequenced.ply", b".segmented.ply"] {
            assert!(named(&[name, ending].concat()).exists());
        }
    }
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 8);
}

#[test]
fn what_is_wrong_is_said_in_a_line() {
    let dir = in_memory();
    let mesh = dir.path().join("m.ply");
    labelled(&mesh);
    let labels = dir.path().join("l.seg");
    std::fs::write(&labels, "0\n1\n").unwrap();
    for (args, code, part) in [
        (vec!["-o", "x.jpg"], 2, "use .png"),
        (vec!["--size", "7"], 2, "write 1600x1200"),
        (vec!["--size", "1x1"], 2, "choose 16 to 16384"),
        (vec!["--views", "0"], 2, "choose 1 to 64"),
        (vec!["--up", "q"], 2, "is not an axis"),
        (vec!["--labels", "x.txt"], 2, ".seg or .npy"),
        (vec!["--labels", "l.seg"], 1, "2 labels for 4 faces"),
        // The whole picture was not counted, only one of its views.
        (vec!["--size", "6000x6000", "--views", "64", "--max-memory", "150MB"], 1, "the picture needs"),
        (vec!["--max-memory", "64MB"], 1, "raise --max-memory or make the picture smaller"),
    ] {
        let output = program().current_dir(dir.path()).arg("picture").arg(&mesh).args(&args).output().unwrap();
        let text = errors(&output);
        assert_eq!(output.status.code(), Some(code), "{args:?}: {text}");
        assert!(text.contains(part), "{args:?}: {text}");
    }
}

/// Regression: the mesh was read first.
#[test]
fn labels_that_cannot_be_read_are_refused_before_any_work() {
    let dir = in_memory();
    let mesh = dir.path().join("m.ply");
    labelled(&mesh);
    for (labels, code, told) in [("x.txt", 2, ".seg or .npy"), ("gone.seg", 1, "gone.seg: cannot open")] {
        for words in [&["picture", "m.ply"][..], &["transfer-labels", "m.ply", "m.ply", "-o", "t.seg"]] {
            let command = program().current_dir(dir.path()).args(words).args(["--labels", labels]).output().unwrap();
            let text = errors(&command);
            assert!(command.status.code() == Some(code) && text.contains(told), "{words:?}: {text}");
            assert_eq!(text.lines().count(), 1, "{words:?}: {text}");
        }
    }
}

/// Regression: a picture that does not fit the budget was refused after all the work, when other outputs were written.
#[test]
fn a_picture_beyond_the_budget_is_refused_before_any_work() {
    let dir = in_memory();
    let mesh = dir.path().join("m.ply");
    labelled(&mesh);
    for words in [
        &["segment", "m.ply", "-k", "2", "-o", "x.seg", "-o", "x.png"][..],
        &["transfer-labels", "m.ply", "m.ply", "-o", "x.seg", "-o", "x.png"],
        &["sequence", "m.ply", "-o", "x.npy", "-o", "x.png"],
    ] {
        let output = program().current_dir(dir.path()).args(words).args(["--max-memory", "64MB"]).output().unwrap();
        assert_eq!(output.status.code(), Some(1), "{words:?}");
        assert!(errors(&output).contains("the picture needs"), "{words:?}: {}", errors(&output));
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1, "{words:?}");
    }
}

/// Regression: there was a colour for each number up to the greatest label, 6 GB here, and 12 for labels that only a
/// picture or a table can hold.
#[test]
fn labels_in_the_billions_need_no_colour_for_each_number() {
    let dir = in_memory();
    let shape = shapes::grid(3);
    shape.write(dir.path());
    let mesh = format!("{}.ply", shape.name);
    for (greatest, outputs) in
        [(2_000_000_000u32, &["x.ply", "x.csv", "x.png"][..]), (4_000_000_000, &["x.csv", "x.png"])]
    {
        let labels: String = (0..shape.faces.len() as u32).map(|face| format!("{}\n", greatest - face % 2)).collect();
        std::fs::write(dir.path().join("labels.seg"), labels).unwrap();
        let given = ["--labels", "labels.seg", "--max-memory", "256MB"];
        let mut words = vec!["transfer-labels", &mesh, &mesh, "-q"];
        words.extend(outputs.iter().flat_map(|output| ["-o", output]));
        for words in [words, vec!["picture", &mesh, "-q", "-o", "y.png"]] {
            let output = program().current_dir(dir.path()).args(&words).args(given).output().unwrap();
            assert!(output.status.success(), "{words:?}: {}", errors(&output));
        }
        // Great labels take 256 colours in turn.
        let table = std::fs::read_to_string(dir.path().join("x.csv")).unwrap();
        let some = palette(256);
        for label in [greatest, greatest - 1] {
            let [r, g, b] = some[label as usize % 256];
            let row = table.lines().find(|row| row.starts_with(&format!("{label},"))).unwrap();
            assert!(row.contains(&format!("#{r:02x}{g:02x}{b:02x}")), "{row}");
        }
    }
}

/// It was called misuse (code 2), and nothing named the file.
#[test]
fn a_mesh_without_a_place_in_space_is_the_files_fault() {
    let dir = in_memory();
    let mut shape = shapes::tetrahedron();
    shape.vertices.iter_mut().for_each(|v| *v = [f64::NAN; 3]);
    let mesh = shape.write(dir.path());
    for command in [vec!["picture", word(&mesh)], vec!["segment", "-q", word(&mesh), "-o", "x.png"]] {
        let output = program().current_dir(dir.path()).args(&command).output().unwrap();
        let (code, told) = (output.status.code(), errors(&output));
        let last = told.lines().next_back().unwrap_or_default();
        let start = format!("nystrom-stream: {}: none of its faces has finite coordinates", mesh.display());
        assert!(code == Some(1) && last.starts_with(&start), "{command:?}: {code:?} {told}");
    }
}

/// Regression: only `segment` told of faces that have no place.
#[test]
fn faces_without_a_place_are_noted() {
    let dir = in_memory();
    let mesh = shapes::all().into_iter().find(|shape| shape.name == "nan_vertex").unwrap().write(dir.path());
    let output = ok(&["picture", word(&mesh), "--size", "64x64", "-o", word(&dir.path().join("o.png"))]);
    assert!(errors(&output).contains("faces have corners whose coordinates are not finite"), "{}", errors(&output));
    let text = String::from_utf8(ok(&["info", word(&mesh)]).stdout).unwrap();
    assert!(text.contains("faces whose coordinates are not finite numbers"), "{text}");
}

/// Pictures were blank, or squares of lengths overflowed, and areas in tables were not finite or 0.
#[test]
fn meshes_of_any_size_are_drawn_and_measured() {
    let dir = in_memory();
    for exponent in [150, -150, 300, -300] {
        let mut shape = shapes::grid(9);
        shape.vertices.iter_mut().flatten().for_each(|x| *x *= 10f64.powi(exponent));
        let (mesh, out, table) = (shape.write(dir.path()), dir.path().join("o.png"), dir.path().join("t.csv"));
        ok(&["segment", "-q", "-k", "2", word(&mesh), "-o", word(&out), "-o", word(&table)]);
        assert_eq!(facts(&out), (1600, 1200, 3));
        let text = std::fs::read_to_string(&table).unwrap();
        let areas = text.lines().skip(1).map(|row| row.split(',').nth(2).unwrap().parse::<f64>().unwrap());
        let area: f64 = areas.sum();
        match exponent {
            150 => assert!((1e300..1e302).contains(&area), "{area:e}"),
            -150 => assert!((1e-300..1e-298).contains(&area), "{area:e}"),
            300 => assert!(area == f64::INFINITY, "{area}"),
            _ => assert!(area == 0., "{area}"),
        }
    }
}

/// Labels as NumPy keeps integers by default, in 64 bits with a sign, were refused.
#[test]
fn labels_are_integers_of_any_type() {
    let dir = in_memory();
    let (mesh, labels, out) = (dir.path().join("m.ply"), dir.path().join("l.npy"), dir.path().join("o.png"));
    labelled(&mesh);
    let array = |descr: &str, data: &[u8]| {
        let text = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': (4,), }}\n");
        let head = [b"\x93NUMPY\x01\x00", &(text.len() as u16).to_le_bytes()[..], text.as_bytes()].concat();
        std::fs::write(&labels, [&head, data].concat()).unwrap();
    };
    let drawn = || {
        let output = run(&["picture", "-q", word(&mesh), "--size=64x64", "--labels", word(&labels), "-o", word(&out)]);
        (output.status.code(), errors(&output), std::fs::read(&out).unwrap_or_default())
    };
    let wanted = [0u32, 1, 1, 2];
    array("<u4", &wanted.map(u32::to_le_bytes).concat());
    let (_, _, pixels) = drawn();
    let [bytes, words, longs] = [
        wanted.map(|x| vec![x as u8]).concat(),
        wanted.map(|x| (x as u16).to_be_bytes()).concat(),
        wanted.map(|x| i64::from(x).to_le_bytes()).concat(),
    ];
    for (descr, data) in [("|u1", &bytes), ("|i1", &bytes), (">i2", &words), ("<i8", &longs)] {
        array(descr, data);
        assert_eq!(drawn(), (Some(0), String::new(), pixels.clone()), "{descr}");
    }
    // A face without a label; then numbers that are no labels, too few of them, and numbers that are no integers.
    array("<i8", &[0i64, 1, -7, 2].map(i64::to_le_bytes).concat());
    assert_eq!(drawn().0, Some(0));
    let refused = |part: &str| {
        let (code, told, _) = drawn();
        let is_right = code == Some(1) && told.contains(word(&labels)) && told.contains(part);
        assert!(is_right, "{told}");
    };
    array("<u8", &[1 << 40, 1, 7, 2u64].map(u64::to_le_bytes).concat());
    refused("item 0 is 1099511627776, beyond 32 bits; give a vector of integers");
    array("<i8", &longs[..24]);
    refused("4 items are declared, but only 3 are present");
    array("<f4", &[0; 16]);
    refused("has items <f4");
}

#[test]
fn segment_writes_a_picture() {
    let dir = in_memory();
    let mesh = dir.path().join("m.ply");
    labelled(&mesh);
    let out = dir.path().join("o.png");
    ok(&["segment", "-q", "-k", "2", word(&mesh), "-o", word(&out)]);
    assert_eq!(facts(&out), (1600, 1200, 3));
}
