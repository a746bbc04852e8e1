//! Parts of surfaces that are small, broken or odd: always an answer, always the same.

use nystrom_stream::base::Result;
use nystrom_stream::cluster::parts::{self, CellGraph, Decision, PartCount, PartTree, PartsParams, PartsResult};
use nystrom_stream::store::run::Run;
use nystrom_stream::{Mesh, Segmenter};

const DECISIONS: [Decision; 3] = [Decision::SoftTrees, Decision::Consensus, Decision::Single];

/// Cells on a chain of balls: `balls` spheres side by side, `each` cells a sphere, boundaries
/// concave where spheres meet. Areas sum to 1.
fn chain(balls: usize, each: usize) -> CellGraph {
    let mut g = CellGraph::default();
    let r = (1.0 / (4.0 * std::f64::consts::PI * balls as f64)).sqrt();
    for b in 0..balls {
        for i in 0..each {
            let x = 1.0 - (2.0 * i as f64 + 1.0) / each as f64;
            let (t, s) = (2.399963 * i as f64, (1.0 - x * x).sqrt());
            let n = [x, s * t.cos(), s * t.sin()];
            g.centre.push([r * n[0] - 1.9 * r * b as f64, r * n[1], r * n[2]]);
            g.normal.push(n);
            g.area.push(1.0 / (balls * each) as f64);
        }
    }
    let size = (1.0 / (balls * each) as f64).sqrt();
    for i in 0..g.len() {
        for j in i + 1..g.len() {
            let gap: f64 = (0..3).map(|c| (g.centre[i][c] - g.centre[j][c]).powi(2)).sum::<f64>().sqrt();
            let same = i / each == j / each;
            if gap < if same { 1.6 } else { 1.2 } * size {
                g.pairs.push([i as u32, j as u32]);
                g.length.push(size);
                g.concave.push(if same { 0.0 } else { 1.5 });
                g.convex.push(if same { 0.3 } else { 0.0 });
                g.convex04.push(if same { 0.3 } else { 0.0 });
            }
        }
    }
    g
}

/// Shortest paths over the cells from `l` of them under length + 5 × concave angle.
fn rows(g: &CellGraph, l: usize) -> Vec<f64> {
    let gap = |k: usize| {
        let [i, j] = g.pairs[k].map(|i| i as usize);
        let d: f64 = (0..3).map(|c| (g.centre[i][c] - g.centre[j][c]).powi(2)).sum::<f64>().sqrt();
        d + 5.0 * g.concave[k] + 0.25 * g.convex[k]
    };
    let mut out = Vec::new();
    for s in 0..l {
        let mut d = vec![f64::INFINITY; g.len()];
        d[s * g.len() / l] = 0.0;
        loop {
            let mut changed = false;
            for (k, p) in g.pairs.iter().enumerate() {
                for [i, j] in [*p, [p[1], p[0]]].map(|p| p.map(|i| i as usize)) {
                    if d[i] + gap(k) < d[j] {
                        (d[j], changed) = (d[i] + gap(k), true);
                    }
                }
            }
            if !changed {
                break;
            }
        }
        out.extend(d);
    }
    out
}

/// All answers, and the one that `params` asks for.
fn parts(g: &CellGraph, b: &[f64], l: usize, params: &PartsParams, run: &Run) -> Result<(PartTree, PartsResult)> {
    let (decided, seconds) = parts::decide(g, b, l, params, run)?;
    let cut = decided.tree.cut_for(params.count, params.detail)?;
    let answer = parts::describe(&decided, cut, l, seconds);
    Ok((decided.tree, answer))
}

fn decide(g: &CellGraph, l: usize, params: &PartsParams, threads: usize, seed: u64) -> (PartTree, PartsResult) {
    parts(g, &rows(g, l), l, params, &Run { threads, seed, ..Run::new(&()) }).unwrap()
}

/// What every answer has to be.
fn sound(g: &CellGraph, (tree, r): &(PartTree, PartsResult)) {
    assert_eq!((r.label.len(), r.confidence.len(), tree.cells()), (g.len(), g.len(), g.len()));
    let mut seen = vec![false; r.parts];
    r.label.iter().for_each(|&k| seen[k as usize] = true);
    assert!(seen.iter().all(|x| *x), "an empty part");
    assert!(r.confidence.iter().all(|c| (0.0..=1.0).contains(c)));
    assert!(r.report.expected_disagreement.is_finite());
    tree.check().unwrap();
}

#[test]
fn balls_of_a_chain_are_its_parts() {
    let g = chain(4, 60);
    for decision in DECISIONS {
        let params = PartsParams { decision, ..PartsParams::default() };
        let r = decide(&g, 24, &params, 2, 0);
        sound(&g, &r);
        let four = r.0.cut_k(4).unwrap();
        let astray = (0..g.len()).filter(|&i| four.label[i] != four.label[i / 60 * 60 + 30]).count();
        assert!(astray <= 12, "{decision:?}: {astray} cells astray");
    }
}

#[test]
fn threads_change_nothing_and_seeds_little() {
    let g = chain(3, 80);
    for decision in DECISIONS {
        let params = PartsParams { decision, ..PartsParams::default() };
        let (tree, one) = decide(&g, 20, &params, 1, 7);
        let (other, many) = decide(&g, 20, &params, 5, 7);
        assert_eq!((&one.label, &tree, &one.confidence), (&many.label, &other, &many.confidence));
    }
}

#[test]
fn any_number_of_parts_is_reached_on_any_surface() {
    let mut torn = chain(3, 20);
    let keep: Vec<usize> = (0..torn.pairs.len()).filter(|&k| torn.concave[k] == 0.0).collect();
    torn.pairs = keep.iter().map(|&k| torn.pairs[k]).collect();
    torn.length.truncate(keep.len());
    torn.concave = vec![0.0; keep.len()];
    torn.convex.truncate(keep.len());
    torn.convex04 = vec![0.0; keep.len()];
    let mut flat = chain(1, 12);
    flat.area = vec![0.0; 12];
    flat.normal = vec![[0.0; 3]; 12];
    flat.centre = vec![[1.0; 3]; 12];
    let mut tiny_components = chain(2, 9);
    tiny_components.pairs.clear();
    tiny_components.length.clear();
    (tiny_components.concave, tiny_components.convex, tiny_components.convex04) = (vec![], vec![], vec![]);
    let small = [1, 2, 3, 5].map(|n| chain(1, n));
    for g in small.iter().chain([&torn, &flat, &tiny_components]) {
        for decision in DECISIONS {
            for l in [1, 2, 3, 40] {
                let params = PartsParams { decision, ensemble_size: 3, ..PartsParams::default() };
                let found = decide(g, l, &params, 1, 0);
                sound(g, &found);
                for k in 1..=g.len() {
                    assert_eq!(found.0.cut_k(k).unwrap().parts, k);
                }
                let params = PartsParams { count: PartCount::Exactly(g.len()), ..params };
                assert_eq!(decide(g, l, &params, 1, 0).1.parts, g.len());
            }
        }
    }
}

#[test]
fn numbers_that_are_none_and_sizes_that_disagree() {
    let mut g = chain(2, 30);
    let l = 6;
    let mut b = rows(&g, l);
    b[5] = f64::NAN;
    b[40..60].fill(f64::INFINITY);
    g.area[3] = f64::NAN;
    g.centre[4] = [f64::INFINITY; 3];
    g.normal[5] = [f64::NAN; 3];
    g.concave[6] = f64::NAN;
    g.length[7] = -1.0;
    for decision in DECISIONS {
        let params = PartsParams { decision, ..PartsParams::default() };
        let r = parts(&g, &b, l, &params, &Run::new(&())).unwrap();
        sound(&g, &r);
        assert!(r.0.level.iter().all(|x| x.is_finite()));
    }
    let run = Run::new(&());
    let plain = PartsParams::default();
    assert!(parts(&g, &b[1..], l, &plain, &run).is_err());
    assert!(parts(&CellGraph::default(), &[], 0, &plain, &run).is_err());
    for count in [PartCount::Exactly(0), PartCount::Exactly(61), PartCount::Between(5, 3), PartCount::Between(61, 70)] {
        assert!(parts(&g, &b, l, &PartsParams { count, ..plain.clone() }, &run).is_err(), "{count:?}");
    }
    for detail in [f64::NAN, 1.5] {
        assert!(parts(&g, &b, l, &PartsParams { detail, ..plain.clone() }, &run).is_err());
    }
    let range = PartsParams { count: PartCount::Between(5, 9), ..plain };
    assert!((5..=9).contains(&parts(&g, &b, l, &range, &run).unwrap().1.parts));
}

#[test]
fn a_stored_tree_answers_like_a_fresh_one() {
    let g = chain(3, 50);
    let (tree, r) = decide(&g, 16, &PartsParams::default(), 2, 1);
    let text = serde_json::to_string(&tree).unwrap();
    let read: PartTree = serde_json::from_str(&text).unwrap();
    read.check().unwrap();
    assert_eq!(read.cut_detail(0.0).label, r.label);
    for k in [1, 2, 5, 11, 150] {
        assert_eq!(read.cut_k(k).unwrap(), tree.cut_k(k).unwrap());
    }
    let parts: Vec<usize> = [-0.9, -0.4, 0.0, 0.4, 0.9].map(|d| read.cut_detail(d).parts).into();
    assert!(parts.windows(2).all(|w| w[0] <= w[1]), "{parts:?}");
}

/// Labels of `mesh` in `k` parts, all of which must be there.
fn in_parts(mesh: &Mesh, k: usize, exact: bool) -> Vec<u32> {
    let cut = Segmenter::new().parts(k).exact(exact).run(mesh).unwrap();
    let mut faces = vec![0; k];
    cut.labels().iter().for_each(|&label| faces[label as usize] += 1);
    assert!(faces.iter().all(|count| *count > 0) && cut.parts() == k, "{k}: {faces:?}");
    cut.labels().to_vec()
}

#[test]
fn there_are_as_many_parts_as_asked_for_up_to_one_per_face() {
    let creature = Mesh::creature(4_000).unwrap();
    let n = creature.faces.len();
    for k in [1_700, 2_001, 3_000, n] {
        in_parts(&creature, k, false);
    }
    in_parts(&creature, 2_500, true);
    assert!(Segmenter::new().parts(n + 1).run(&creature).unwrap_err().to_string().contains("fewer than the"));
}

/// A sheet beside three faces with nearly all of the area: it is a tiny component, without a cell of its own.
fn three_faces_and_a_sheet() -> Mesh {
    let mut points: Vec<[f64; 3]> = (0..1600).map(|i| [f64::from(i % 40), f64::from(i / 40), 0.]).collect();
    points.extend([[0., 0., 9e3], [9e3, 0., 9e3], [9e3, 9e3, 9e3], [0., 9e3, 9e3], [-9e3, 9e3, 9e3]]);
    let quad = |i: u32| [[i, i + 1, i + 41], [i, i + 41, i + 40]];
    let mut faces: Vec<[u32; 3]> = (0..1560).filter(|i| i % 40 < 39).flat_map(quad).collect();
    faces.extend([[1600, 1601, 1602], [1600, 1602, 1603], [1600, 1603, 1604]]);
    Mesh::from_vecs(points, faces).unwrap()
}

#[test]
fn cells_on_three_faces_can_be_four_parts() {
    for k in [3, 4, 50] {
        in_parts(&three_faces_and_a_sheet(), k, false);
    }
}

/// Regression: the sheet was the interior of all parts, since it has more faces, and the three faces became one part.
#[test]
fn tiny_components_do_not_outvote_the_faces_that_they_float_beside() {
    let mesh = three_faces_and_a_sheet();
    for k in 1..=3 {
        let labels = in_parts(&mesh, k, false);
        let mut large = labels[labels.len() - 3..].to_vec();
        large.sort_unstable();
        large.dedup();
        assert_eq!(large.len(), k);
    }
}

#[test]
fn one_face_is_one_part() {
    let mesh = Mesh::from_slices(&[[0f32, 0., 0.], [1., 0., 0.], [0., 1., 0.]], &[[0, 1, 2]]).unwrap();
    assert_eq!(Segmenter::new().run(&mesh).unwrap().labels(), [0]);
    assert_eq!(in_parts(&mesh, 1, false), [0]);
    let error = Segmenter::new().parts(2).run(&mesh).unwrap_err();
    assert_eq!(error.to_string(), "<arrays>: has 1 face, fewer than the 2 parts requested; choose a smaller `parts`");
}
