//! Pages: what they hold, whatever the mesh; that they work in a browser is for `tools/check-page` to say.

use crate::common;
use base64::Engine;
use nystrom_stream::apps::edits::{Edit, Edits, Place};
use nystrom_stream::apps::page::decimate::Decimated;
use nystrom_stream::apps::page::{Cuts, Page, TRIANGLES};
use nystrom_stream::mesh::{self, Mesh};
use nystrom_stream::store::Run;
use serde_json::{Value, json};

fn run() -> Run<'static> {
    Run { threads: 2, ..Run::new(&()) }
}

fn numbers(data: &Value) -> Vec<u16> {
    let bytes = base64::engine::general_purpose::STANDARD.decode(data.as_str().unwrap()).unwrap();
    bytes.chunks(2).map(|pair| u16::from_le_bytes([pair[0], pair[1]])).collect()
}

/// What the page's script is given.
fn data(html: &str) -> Value {
    let start = html.find("type=\"application/json\">").unwrap() + 24;
    serde_json::from_str(&html[start..start + html[start..].find("</script>").unwrap()]).unwrap()
}

#[test]
fn a_small_mesh_is_shown_as_it_is_with_its_labels_and_cuts() {
    let dir = tempfile::tempdir().unwrap();
    let path = common::creature(dir.path(), 5_000, false);
    let mesh = mesh::open(&path, dir.path(), &run()).unwrap();
    let n = mesh.faces.len();
    let labels: Vec<u32> = (0..n as u32).map(|face| face * 3 / n as u32).collect();
    let cells: Vec<u32> = (0..n as u32).map(|face| face % 7).collect();
    let colours = [[255, 0, 0], [0, 255, 0], [0, 0, 255]];
    let parts = [vec![0; 7], vec![0, 1, 0, 1, 0, 1, 0]];
    let report = json!({ "landmarks": [0, n - 1, 10 * n], "note": "</script>" });
    let title = "a <b> & c";
    let cuts = Some(Cuts { cells: &cells, parts: &parts, model: None });
    let page =
        Page { title, mesh: &mesh, labels: &labels, colours: &colours, names: &[], cuts, edits: None, report: &report };
    let html = page.html(&run()).unwrap();
    assert!(html.contains("<title>a &lt;b&gt; &amp; c</title>") && !html.contains("http"), "nothing from outside");
    let data = data(&html);
    assert_eq!(numbers(&data["labels"]), labels.iter().map(|&x| x as u16).collect::<Vec<_>>());
    assert_eq!(numbers(&data["cuts"]["cells"]), cells.iter().map(|&x| x as u16).collect::<Vec<_>>());
    assert_eq!(numbers(&data["cuts"]["parts"][1]), [0, 1, 0, 1, 0, 1, 0]);
    assert_eq!(numbers(&data["landmarks"]).len(), 6, "a landmark that does not exist is left out");
    assert_eq!(numbers(&data["triangles"]).len(), 6 * n);
    assert_eq!((&data["report"]["note"], &data["faces"]), (&json!("</script>"), &json!(n)));

    // A mesh called like a place of the template put its data, names and all, where they are read as HTML.
    let title = "\"DATA\"{{TITLE}}/*SCRIPT*/<img src=x>";
    let html = Page { title, ..page }.html(&run()).unwrap();
    assert!(!html.contains("<img") && html.matches("\"DATA\"{{TITLE}}/*SCRIPT*/&lt;img src=x&gt;").count() == 2);
    assert_eq!(self::data(&html)["title"], title);

    let html = page.html(&run()).unwrap();
    let target = dir.path().join("page.html");
    page.write(&target, &run()).unwrap();
    assert_eq!(std::fs::read_to_string(&target).unwrap(), html);
    let wrong = Page { labels: &labels[1..], ..page };
    assert!(wrong.html(&run()).unwrap_err().to_string().contains("labels"));
    let nowhere = Mesh::from_slices(&[[f64::NAN; 3]; 3], &[[0, 1, 2]]).unwrap();
    assert!(Page { mesh: &nowhere, labels: &[0], cuts: None, ..page }.html(&run()).is_err());
}

#[test]
fn a_large_mesh_is_thinned_and_keeps_its_shape() {
    let dir = tempfile::tempdir().unwrap();
    let path = common::creature(dir.path(), 400_000, false);
    let mesh = mesh::open(&path, dir.path(), &run()).unwrap();
    let decimated = Decimated::of(&mesh, TRIANGLES, &run()).unwrap();
    let count = decimated.triangles.len();
    assert!((TRIANGLES / 3..TRIANGLES * 3 / 2).contains(&count), "{count}");
    assert!(decimated.triangles.iter().flatten().all(|&v| (v as usize) < decimated.positions.len()));
    // Every triangle lies near the face that it stands for.
    let side = 4.;
    for (triangle, &face) in decimated.triangles.iter().zip(&decimated.faces) {
        mesh.faces.with(face as usize, |corners| {
            let (a, b) = (decimated.positions[triangle[0] as usize], mesh.positions.get(corners[0]));
            let apart = (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt();
            assert!(apart < 0.05 * side, "{apart}");
        });
    }
    let again = Decimated::of(&mesh, TRIANGLES, &run()).unwrap();
    assert!(again.positions == decimated.positions && again.triangles == decimated.triangles);
}

#[test]
fn the_box_of_a_page_is_that_of_the_faces_without_strays() {
    // Regression: it held strays, and edits that a page had saved were scaled as if for a mesh in other units.
    let w = 20u32;
    let mut points: Vec<[f64; 3]> = (0..w * w).map(|i| [f64::from(i % w), f64::from(i / w), 0.]).collect();
    let faces: Vec<[u32; 3]> = (0..w * (w - 1))
        .filter(|i| i % w < w - 1)
        .flat_map(|i| [[i, i + 1, i + w + 1], [i, i + w + 1, i + w]])
        .collect();
    points[210] = [3e3, 0., 7.];
    points.push([60., 60., 60.]);
    let mesh = Mesh::from_slices(&points, &faces).unwrap();
    let (labels, report) = (vec![0; faces.len()], json!({}));
    let page = Page {
        title: "sheet",
        mesh: &mesh,
        labels: &labels,
        colours: &[[255, 0, 0]],
        names: &[],
        cuts: None,
        edits: None,
        report: &report,
    };
    let shown = data(&page.html(&run()).unwrap());
    assert_eq!((&shown["low"], &shown["side"]), (&json!([0., 0., 0.]), &json!(19.)));
    assert_eq!((&shown["extent"], &shown["whole"]), (&json!([1., 1., 0.]), &json!(true)));
    // Regression: greater labels all became 65,535.
    let labels: Vec<u32> = (0..faces.len() as u32).map(|face| 65_535 + face / 500).collect();
    let told = Page { labels: &labels, ..page }.html(&run()).unwrap_err().to_string();
    assert!(told.contains("65536 is too large for a page"), "{told}");
    assert!(Page { labels: &[65_535; 722], ..page }.html(&run()).is_ok());
}

#[test]
fn edits_of_a_page_are_in_units_of_its_mesh() {
    // Regression: those from a file in metres stayed so beside new ones in millimetres, and were saved with the box of
    // the latter.
    let corners = [[0., 0., 0.], [2000., 0., 0.], [2000., 1000., 0.], [0., 1000., 0.]];
    let mesh = Mesh::from_slices(&corners, &[[0, 1, 2], [0, 2, 3]]).unwrap();
    let at = vec![Place::Point([1.9, 0.1, 0.]), Place::Face(1)];
    let edits = Edits { bounds: Some([[0.; 3], [2., 1., 0.]]), edits: vec![Edit::Merge { at }], ..Edits::default() };
    let page = Page {
        title: "sheet",
        mesh: &mesh,
        labels: &[0, 0],
        colours: &[[255, 0, 0]],
        names: &[],
        cuts: None,
        edits: Some(&edits),
        report: &json!({}),
    };
    let shown = &data(&page.html(&run()).unwrap())["edits"];
    assert_eq!(shown["box"], json!([[0., 0., 0.], [2000., 1000., 0.]]));
    assert_eq!(shown["edits"][0]["at"], json!([[1900., 100., 0.], 1]));
    // Without a box they are in units of the mesh.
    let plain = Edits { bounds: None, ..edits.clone() };
    let shown = &data(&Page { edits: Some(&plain), ..page }.html(&run()).unwrap())["edits"];
    assert_eq!((&shown["box"], &shown["edits"][0]["at"][0]), (&Value::Null, &json!([1.9, 0.1, 0.])));
}

#[test]
fn edits_of_a_page_state_the_cut_that_they_were_made_on() {
    // Regression: with `-k` beside a file of edits, the page saved them without that number, or with that of the file:
    // what it saved made other parts than it showed.
    let mesh = Mesh::from_slices(&[[0., 0., 0.], [1., 0., 0.], [1., 1., 0.]], &[[0, 1, 2]]).unwrap();
    let shown = |edits: Edits, asked: Value| {
        let report = json!({"options": {"parts": asked}});
        let (edits, labels, colours) = (Some(&edits), &[0], &[[255, 0, 0]]);
        let page = Page { title: "", mesh: &mesh, labels, colours, names: &[], cuts: None, edits, report: &report };
        let shown = &data(&page.html(&run()).unwrap())["edits"];
        [shown["parts"].clone(), shown["detail"].clone()]
    };
    let at = || Place::Face(0);
    let file = |edit| Edits { parts: Some(4), edits: vec![edit], ..Edits::default() };
    let split = || file(Edit::Split { at: at(), into: 2 });
    let six = || json!({"count": {"exactly": 6}, "detail": 0.});
    assert_eq!(shown(split(), six()), [json!(6), Value::Null]);
    assert_eq!(shown(Edits { parts: None, ..split() }, six()), [json!(6), Value::Null]);
    assert_eq!(shown(split(), json!({"count": "found", "detail": 0.5})), [Value::Null, json!(0.5)]);
    assert_eq!(
        shown(Edits { parts: None, ..split() }, json!({"count": "found", "detail": 0.})),
        [Value::Null, Value::Null]
    );
    // Protected parts are those of the file's cut, and nothing is known of a report without options.
    assert_eq!(shown(file(Edit::Protect { at: at() }), six()), [json!(4), Value::Null]);
    assert_eq!(shown(split(), Value::Null), [json!(4), Value::Null]);
}

#[test]
fn a_page_knows_which_parts_its_edits_dropped_and_protect() {
    // Regression: an edit on the page could change protected parts, and dropped ones got the number of ordinary parts.
    let corners = [[0., 0., 0.], [1., 0., 0.], [1., 1., 0.], [0., 1., 0.]];
    let mesh = Mesh::from_slices(&corners, &[[0, 1, 2], [0, 2, 3]]).unwrap();
    let shown = |edits: &[Edit], last: [u8; 3]| {
        let edits = Edits { edits: edits.to_vec(), ..Edits::default() };
        let (colours, report) = ([[255, 0, 0], last], json!({}));
        let (edits, labels, cuts) = (Some(&edits), &[1, 0], None);
        let page = Page { title: "", mesh: &mesh, labels, colours: &colours, names: &[], cuts, edits, report: &report };
        let shown = data(&page.html(&run()).unwrap());
        [shown["dropped"].clone(), shown["kept"].clone()]
    };
    let (drop, protect) = (Edit::Drop { at: Place::Face(0) }, Edit::Protect { at: Place::Point([0.1, 0.9, 0.]) });
    let (grey, red) = ([128; 3], [255, 0, 0]);
    assert_eq!(shown(&[drop.clone(), protect.clone(), protect], grey), [json!([1]), json!([0])]);
    assert_eq!(shown(&[], grey), [json!([]), json!([])]);
    // Of a dropped part that has no face left, there is no grey part.
    assert_eq!(shown(&[drop], red), [json!([]), json!([])]);
}
