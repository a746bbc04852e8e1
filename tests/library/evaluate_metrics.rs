//! The benchmark's metrics against known values, oracles and identities.

use nystrom_stream::apps::evaluate::{Evaluator, Scores, compare, contingency, matches, rand, rand_area};
use nystrom_stream::mesh::Mesh;
use proptest::prelude::*;

/// `n` labels below `parts`: x ← 1664525 x + 1013904223 mod 2³², from `seed`; label x / 2¹⁶ mod parts.
fn random(seed: u32, n: usize, parts: u32) -> Vec<u32> {
    let mut x = seed;
    let mut next = || {
        x = x.wrapping_mul(1664525).wrapping_add(1013904223);
        (x >> 16) % parts
    };
    (0..n).map(|_| next()).collect()
}

/// An n × n grid of unit squares, cut into triangles, with a bump so that nothing is flat.
fn grid(n: u32) -> Mesh {
    let height = |x: u32, y: u32| (f64::from(x) * 0.7).sin() * (f64::from(y) * 0.4).cos();
    let side = n + 1;
    let vertices: Vec<[f64; 3]> =
        (0..side * side).map(|v| (v % side, v / side)).map(|(x, y)| [x.into(), y.into(), height(x, y)]).collect();
    let corners = (0..n * n).map(|q| q / n * side + q % n);
    let faces: Vec<[u32; 3]> = corners.flat_map(|v| [[v, v + 1, v + side + 1], [v, v + side + 1, v + side]]).collect();
    Mesh::from_slices(&vertices, &faces).unwrap()
}

fn close(a: f64, b: f64) -> bool {
    (a - b).abs() <= 1e-12 * (1. + a.abs())
}

fn all_close(a: &Scores, b: &Scores) -> bool {
    let list = |s: &Scores| [s.rand, s.rand_area, s.hamming, s.missing, s.false_alarm, s.gce, s.lce];
    let cuts = match (a.cut_discrepancy, b.cut_discrepancy) {
        (Some(a), Some(b)) => close(a, b),
        (a, b) => a == b,
    };
    cuts && list(a).into_iter().zip(list(b)).all(|(a, b)| close(a, b))
}

#[test]
fn the_rand_index_is_that_of_scikit_learn() {
    // 1 - sklearn.metrics.rand_score(random(1, n, a), random(2, n, b)), scikit-learn's rand_score on
    // the sequences above; "mixed": every third label of the second replaced by the first's mod b.
    let cases = [
        (1000, 5, 7, 0.2858558558558558, 0.25749549549549544),
        (20000, 12, 3, 0.3610665083254163, 0.3486996899844992),
        (5000, 400, 2, 0.4999155831166233, 0.49959919983996803),
    ];
    for (n, a, b, plain, mixed) in cases {
        let (labels, mut truth) = (random(1, n, a), random(2, n, b));
        assert!(close(compare(None, &labels, &truth).unwrap().rand, plain));
        for f in (0..n).step_by(3) {
            truth[f] = labels[f] % b;
        }
        assert!(close(compare(None, &labels, &truth).unwrap().rand, mixed));
    }
}

#[test]
fn small_cases_have_the_values_of_the_definitions() {
    // Six faces: {0,1,2 | 3,4,5} against {0,1 | 2,3 | 4,5}.
    let scores = compare(None, &[0, 0, 0, 1, 1, 1], &[5, 5, 6, 6, 7, 7]).unwrap();
    // Together in both: 01, 45. Apart in one only: 02 12 34 35 in the first, 23 in the second.
    assert!(close(scores.rand, 5. / 15.));
    assert!(close(scores.missing, 1. / 6.) && close(scores.false_alarm, 2. / 6.) && close(scores.hamming, 0.25));
    // Errors a face, first against second: 1/3 1/3 2/3 2/3 1/3 1/3; second against first: 0 0 1/2 1/2 0 0.
    assert!(close(scores.gce, 1. / 6.) && close(scores.lce, 1. / 6.));
    assert_eq!(scores.cut_discrepancy, None);

    // A refinement has no consistency error, and one rate only.
    let finer = compare(None, &[0, 1, 2, 3], &[0, 0, 1, 1]).unwrap();
    assert_eq!((finer.gce, finer.lce, finer.false_alarm, finer.missing), (0., 0., 0., 0.5));

    // Refined in different directions at different places: the local error forgives it.
    let mixed = compare(None, &[0, 0, 1, 2], &[3, 4, 5, 5]).unwrap();
    assert_eq!((mixed.gce, mixed.lce), (0.25, 0.));
}

#[test]
fn areas_weigh_what_they_measure() {
    // Faces of area 1 and 3: the one wrong face is the large one.
    let table = contingency(&[0, 0, 1], &[0, 0, 0], Some(&[1., 1., 3.])).unwrap();
    // Pairs 0-1 (weight 1) agree, 0-2 and 1-2 (weight 3 each) do not.
    assert!(close(rand_area(&table), 6. / 7.) && close(rand(&table), 2. / 3.));
    assert!(close(Scores::of_table(&table).missing, 2. / 5.));
    assert!(close(matches(&table), 3. / 5.));
}

#[test]
fn degenerate_labellings_have_scores() {
    for n in [0, 1, 2] {
        let scores = compare(None, &vec![0; n], &vec![7; n]).unwrap();
        assert!(all_close(&scores, &Scores::of_table(&contingency(&[], &[], None).unwrap())));
    }
    let every: Vec<u32> = (0..100).collect();
    assert_eq!(compare(None, &every, &[0; 100]).unwrap().rand, 1.);
}

#[test]
fn counts_that_differ_are_named_in_one_line() {
    let mesh = grid(3);
    let error = compare(Some(&mesh), &[0; 18], &[0; 17]).unwrap_err().to_string();
    assert_eq!(error, "truth: 17 labels for 18 faces; give one label per face, in the order of the mesh file");
    let surface = Evaluator::of(&mesh).unwrap();
    let error = surface.segmentations(&[vec![0; 18], vec![0; 3]]).unwrap_err().to_string();
    assert!(error.starts_with("truth 2: 3 labels for 18 faces") && !error.contains('\n'));
    let single = [vec![0u32; 18]];
    let one = surface.segmentations(&single).unwrap();
    assert!(surface.people(&one).is_err() && surface.compare_many(&one[0], &[]).is_err());
}

#[test]
fn people_are_compared_with_each_other_person() {
    let mesh = grid(8);
    let surface = Evaluator::of(&mesh).unwrap();
    let truths: Vec<Vec<u32>> = (1..5).map(|k| (0..128).map(|f| f / (16 * k)).collect()).collect();
    let ready = surface.segmentations(&truths).unwrap();
    let left_out: Vec<Scores> = (0..4)
        .map(|k| {
            let others: Vec<_> = (0..4).filter(|&o| o != k).map(|o| ready[o].clone()).collect();
            surface.compare_many(&ready[k], &others).unwrap()
        })
        .collect();
    assert!(all_close(&surface.people(&ready).unwrap(), &Scores::mean(&left_out).unwrap()));
    let direct = compare(Some(&mesh), &truths[0], &truths[1]).unwrap();
    assert!(all_close(&surface.compare(&ready[0], &ready[1]).unwrap(), &direct));
}

/// Regression: labels of a mesh with more vertices or fewer faces ended in a panic, or in wrong scores.
#[test]
fn labels_that_another_evaluator_prepared_are_refused() {
    let (small, large) = (Evaluator::of(&grid(3)).unwrap(), Evaluator::of(&grid(8)).unwrap());
    let labels: Vec<u32> = (0..128).map(|face| face / 20).collect();
    let (few, many) = (small.segmentation("few", &labels[..18]).unwrap(), large.segmentation("many", &labels).unwrap());
    assert!(small.clone().compare(&few, &few).is_ok());
    for (labels, truth, told) in [(&few, &many, "truth: another evaluator"), (&many, &few, "labels: another")] {
        let error = small.compare(labels, truth).unwrap_err().to_string();
        assert!(error.starts_with(told), "{error}");
        assert!(small.contingency(labels, truth).is_err());
    }
    assert!(small.compare_many(&few, &[few.clone(), many.clone()]).is_err() && small.people(&[few, many]).is_err());
}

#[test]
fn the_pairs_of_ten_million_faces_are_counted() {
    // 5·10¹³ pairs: two labellings at random disagree about a pair where one joins it and the other does not.
    let n = 10_000_000;
    let scores = compare(None, &random(1, n, 12), &random(2, n, 15)).unwrap();
    let (one, other) = (1. / 12., 1. / 15.);
    let expected = one * (1. - other) + other * (1. - one);
    assert!((scores.rand - expected).abs() < 1e-4, "{} {expected}", scores.rand);
}

/// Both Rand variants by looking at every pair.
fn by_pairs(labels: &[u32], truth: &[u32], areas: &[f64]) -> (f64, f64) {
    let (mut faces, mut area, mut all, mut all_area) = (0u64, 0., 0u64, 0.);
    for i in 0..labels.len() {
        for j in 0..i {
            let apart = (labels[i] == labels[j]) != (truth[i] == truth[j]);
            all += 1;
            all_area += areas[i] * areas[j];
            faces += u64::from(apart);
            area += if apart { areas[i] * areas[j] } else { 0. };
        }
    }
    if all == 0 { (0., 0.) } else { (faces as f64 / all as f64, area / all_area) }
}

proptest! {
    #[test]
    fn rand_is_what_counting_pairs_gives(
        pairs in prop::collection::vec((0u32..6, 0u32..4, 0.1f64..5.), 0..120)
    ) {
        let labels: Vec<u32> = pairs.iter().map(|p| p.0).collect();
        let truth: Vec<u32> = pairs.iter().map(|p| p.1).collect();
        let areas: Vec<f64> = pairs.iter().map(|p| p.2).collect();
        let table = contingency(&labels, &truth, Some(&areas)).unwrap();
        let (faces, area) = by_pairs(&labels, &truth, &areas);
        prop_assert_eq!(rand(&table), faces);
        prop_assert!((rand_area(&table) - area).abs() < 1e-9);
        let unit = contingency(&labels, &truth, None).unwrap();
        prop_assert!(close(rand_area(&unit), rand(&unit)));
    }

    #[test]
    fn names_of_labels_do_not_matter_and_the_reverse_swaps_the_rates(
        labels in prop::collection::vec(0u32..5, 32),
        truth in prop::collection::vec(0u32..4, 32),
        names in Just([90u32, 3, u32::MAX, 17, 4]).prop_shuffle(),
    ) {
        let mesh = grid(4);
        let scores = compare(Some(&mesh), &labels, &truth).unwrap();
        let renamed: Vec<u32> = labels.iter().map(|&l| names[l as usize]).collect();
        prop_assert!(all_close(&compare(Some(&mesh), &renamed, &truth).unwrap(), &scores));
        let back = compare(Some(&mesh), &truth, &labels).unwrap();
        prop_assert!(all_close(&back, &scores.reversed()));
        let same = compare(Some(&mesh), &renamed, &labels).unwrap();
        let nothing = Scores::of_table(&contingency(&[], &[], None).unwrap());
        prop_assert_eq!(same, Scores { cut_discrepancy: Some(0.), ..nothing });
        let metrics = [scores.rand, scores.rand_area, scores.missing, scores.false_alarm, scores.gce, scores.lce];
        prop_assert!(metrics.iter().all(|x| (0. ..=1.).contains(x)) && scores.lce <= scores.gce + 1e-15);
        // The consistency errors by their definition, face by face.
        let areas = areas(&mesh);
        let area = |of: &dyn Fn(usize) -> bool| (0..32).filter(|&f| of(f)).map(|f| areas[f]).sum::<f64>();
        let error = |a: &[u32], b: &[u32], f: usize| {
            area(&|g| a[g] == a[f] && b[g] != b[f]) / area(&|g| a[g] == a[f]) * areas[f]
        };
        let all = area(&|_| true);
        let (one, other): (Vec<f64>, Vec<f64>) =
            (0..32).map(|f| (error(&labels, &truth, f), error(&truth, &labels, f))).unzip();
        let gce = f64::min(one.iter().sum(), other.iter().sum()) / all;
        let lce = one.iter().zip(&other).map(|(a, b)| a.min(*b)).sum::<f64>() / all;
        prop_assert!(close(scores.gce, gce) && close(scores.lce, lce));
    }
}

/// Triangle areas by Heron's formula.
fn areas(mesh: &Mesh) -> Vec<f64> {
    let mut areas = Vec::new();
    mesh.faces.for_each(0..mesh.faces.len(), |_, corners| {
        let p: Vec<[f64; 3]> = corners.iter().map(|&v| mesh.positions.get(v)).collect();
        let side = |a: [f64; 3], b: [f64; 3]| (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt();
        let (a, b, c) = (side(p[0], p[1]), side(p[1], p[2]), side(p[2], p[0]));
        let s = (a + b + c) / 2.;
        areas.push((s * (s - a) * (s - b) * (s - c)).sqrt());
    });
    areas
}
