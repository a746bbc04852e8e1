//! The paper's study: its measures against exact ones, its identities, and its figures in small.

use crate::common;
use nalgebra::DMatrix;
use nystrom_stream::apps::study::compare::embedding_errors;
use nystrom_stream::apps::study::data::{Over, StudyData, StudyParams};
use nystrom_stream::apps::study::points::{self, PointsParams, TOLERANCE, affinities, agreement, evaluate_sample};
use nystrom_stream::apps::study::summary::summary;
use nystrom_stream::apps::study::{CompareParams, SampleRecord, StudyWidth, compare};
use nystrom_stream::graph::Metric;
use nystrom_stream::landmarks::{MatrixSpace, Sampler, Sampling, SamplingParams};
use nystrom_stream::spectral::affinity::{AffinityBlock, Bandwidth, DenseBlock, SampledBlock};
use nystrom_stream::spectral::affinity::{KeptEigenpairs, Preprocess, PreprocessedBlock};
use nystrom_stream::spectral::kernel::Kernel;
use nystrom_stream::spectral::measures::measure;
use nystrom_stream::spectral::measures::{aligned_error, angles, exact, leading};
use nystrom_stream::spectral::nystrom::{ExtensionParams, Extrapolation, NystromExtension, Scaling};
use nystrom_stream::store::Context;
use nystrom_stream::store::{Run, WorkDir};
use nystrom_stream::{Mesh, SamplingQuality};
use std::path::Path;

/// The points and samples of the reference values, drawn by NumPy.
fn reference() -> (Vec<[f64; 2]>, [Vec<u32>; 2]) {
    let lines: Vec<&str> = include_str!("gaussian_points.txt").lines().skip(1).collect();
    let sample = |line: &str| line.split(' ').map(|word| word.parse().unwrap()).collect();
    let point = |line: &&str| {
        let (x, y) = line.split_once(' ').unwrap();
        [x.parse().unwrap(), y.parse().unwrap()]
    };
    (lines[2..].iter().map(point).collect(), [sample(lines[0]), sample(lines[1])])
}

fn dense(w: &DMatrix<f64>, landmarks: &[u32]) -> DenseBlock {
    let rows = DMatrix::from_fn(landmarks.len(), w.ncols(), |k, j| w[(landmarks[k] as usize, j)]);
    DenseBlock { landmarks: landmarks.to_vec(), rows }
}

fn near(a: &DMatrix<f64>, b: &DMatrix<f64>, tolerance: f64) -> bool {
    (a - b).amax() <= tolerance * b.amax()
}

#[test]
fn gamma_and_schur_complement_have_the_reference_values() {
    let (points, samples) = reference();
    let w = affinities(&points);
    let expected = [(476.492073, 5.995561), (474.359263, 7.658967)];
    for (landmarks, (gamma, frobenius)) in samples.iter().zip(expected) {
        let measures = evaluate_sample(&w, landmarks, &Run::new(&())).unwrap();
        assert!((measures.gamma - gamma).abs() < 1e-6, "{measures:?}");
        assert!((measures.frobenius - frobenius).abs() < 1e-6, "{measures:?}");
        // The nuclear norm of the Schur complement is m − Γ, exactly.
        assert!((measures.nuclear - (490. - measures.gamma)).abs() <= 1e-8 * 490., "{measures:?}");
        assert!(measures.spectral <= measures.frobenius && measures.frobenius <= measures.nuclear);
    }
}

#[test]
fn gamma_ranks_samples_as_the_schur_complement_does() {
    let params = PointsParams::default().points(200).runs(60);
    let pairs = points::pairs(params, 0, &Run::new(&())).unwrap();
    let share = agreement(&pairs, |s| s.frobenius);
    assert!((0.85..=1.).contains(&share), "{share}");
    assert_eq!(agreement(&pairs, |s| s.nuclear), 1.);
    let again = points::pairs(params, 0, &Run { threads: 1, ..Run::new(&()) }).unwrap();
    assert_eq!(pairs, again);
}

#[test]
fn kernel_pca_is_nystrom_times_the_root_of_the_eigenvalues() {
    let (points, [landmarks, _]) = reference();
    let w = affinities(&points);
    let (block, run) = (dense(&w, &landmarks), Run::new(&()));
    let fit = |how, scaling| {
        NystromExtension::fit(&block, ExtensionParams::new(how, 6, TOLERANCE).scaled(scaling), None, &run).unwrap()
    };
    // Eq. 2 and eq. 4 written out.
    let kept = KeptEigenpairs::of(block.sampled(), TOLERANCE);
    let sum = |power: f64| {
        DMatrix::from_fn(500, 6, |j, d| {
            let dot: f64 = (0..10).map(|i| kept.vectors[(i, d)] * block.rows[(i, j)]).sum();
            dot * kept.values[d].powf(power)
        })
    };
    let (eq2, eq4) = (sum(-1.), sum(-0.5));
    assert!(near(&fit(Extrapolation::Plain, Scaling::None).embed(&block), &eq2, 1e-9));
    assert!(near(&fit(Extrapolation::Kpca, Scaling::None).embed(&block), &eq4, 1e-9));
    assert!(near(&fit(Extrapolation::Plain, Scaling::Root).embed(&block), &eq4, 1e-9));
    assert!(near(&fit(Extrapolation::Kpca, Scaling::InverseRoot).embed(&block), &eq2, 1e-9));
    // Eq. 1: the samples' own coordinates are A's eigenvectors.
    for (i, &node) in landmarks.iter().enumerate() {
        for d in 0..6 {
            assert!((eq2[(node as usize, d)] - kept.vectors[(i, d)]).abs() < 1e-7);
        }
    }
}

#[test]
fn orthogonalised_vectors_are_the_eigenvectors_of_the_approximation() {
    let (points, [landmarks, _]) = reference();
    let w = affinities(&points);
    let (block, run) = (dense(&w, &landmarks), Run::new(&()));
    let weights: Vec<f64> = (0..500).map(|i| 0.5 + (i % 7) as f64 / 6.).collect();
    let damped = |tolerance| {
        let f = block.rows.transpose() * KeptEigenpairs::damped(block.sampled(), tolerance);
        &f * f.transpose()
    };
    let approximation = damped(1e-6);
    // Far below the least eigenvalue damping is no cut, and takes nothing away.
    assert!(near(&damped(1e-12), &nystrom_stream::spectral::measures::approximation(&block, 1e-12), 1e-6));
    for weights in [None, Some(&weights[..])] {
        let weigh = weights.map(|w| move |i: usize| w[i]);
        let weigh = weigh.as_ref().map(|weigh| weigh as &(dyn Fn(usize) -> f64 + Sync));
        let fit = NystromExtension::fit(&block, ExtensionParams::new(Extrapolation::Orthogonal, 5, 1e-6), weigh, &run)
            .unwrap();
        let u = fit.embed(&block);
        let m = DMatrix::from_fn(500, 500, |i, j| if i == j { weights.map_or(1., |w| w[i]) } else { 0. });
        assert!(near(&(u.transpose() * &m * &u), &DMatrix::identity(5, 5), 1e-8));
        // W̄ M u = μ u.
        let mut scaled = u.clone();
        scaled.column_iter_mut().zip(&fit.values).for_each(|(mut column, value)| column *= *value);
        assert!(near(&(&approximation * &m * &u), &scaled, 1e-8));
    }
    // Against the true eigenvectors it is better than the plain extrapolation, or as good.
    let (values, truth) = leading(&w, 5);
    let full = w.clone().symmetric_eigenvalues();
    assert!((values[0] - full.max()).abs() < 1e-8 * values[0]);
    let found =
        |how| NystromExtension::fit(&block, ExtensionParams::new(how, 5, 1e-6), None, &run).unwrap().embed(&block);
    let (plain, better) =
        (angles(&truth, &found(Extrapolation::Plain)), angles(&truth, &found(Extrapolation::Orthogonal)));
    assert!(better[4] <= plain[4] + 1e-6, "{better:?} {plain:?}");
    let ones = vec![1.; 500];
    let rotated = &truth * DMatrix::from_fn(5, 5, |i, j| if (i + 1) % 5 == j { 1. } else { 0. });
    assert!(aligned_error(&truth, &rotated, &ones) < 1e-9);
}

#[test]
fn preprocessing_of_columns_equals_that_of_whole_matrices() {
    let (points, [landmarks, _]) = reference();
    let w = affinities(&points[..300]);
    let landmarks: Vec<u32> = landmarks.into_iter().filter(|&i| i < 300).collect();
    let (block, run) = (dense(&w, &landmarks), Run::new(&()));
    let whole = |block: &dyn SampledBlock| {
        let mut out = vec![0.; block.len() * block.nodes()];
        block.columns(0..block.nodes(), &mut out);
        DMatrix::from_vec(block.nodes(), block.len(), out).transpose()
    };
    let prepared = |kind| PreprocessedBlock::new(&block, kind, TOLERANCE, &run).unwrap();
    assert_eq!(whole(&prepared(Preprocess::None)), block.rows);
    // Degrees of the approximation, by forming it.
    let approximation = nystrom_stream::spectral::measures::approximation(&block, TOLERANCE);
    let ones = nalgebra::DVector::from_element(300, 1.);
    let degrees = &approximation * &ones;
    let expected = DMatrix::from_fn(landmarks.len(), 300, |k, j| {
        let own: f64 = w.row(landmarks[k] as usize).sum();
        w[(landmarks[k] as usize, j)] / (own * degrees[j].max(1e-3 * 100.)).sqrt()
    });
    assert!(near(&whole(&prepared(Preprocess::Degree)), &expected, 1e-6));
    // Rows of D⁻¹W: its leading eigenvector is constant.
    let stochastic = prepared(Preprocess::RowStochastic);
    let fit =
        NystromExtension::fit(&stochastic, ExtensionParams::new(Extrapolation::Orthogonal, 1, TOLERANCE), None, &run)
            .unwrap();
    let y = fit.embed(&stochastic);
    assert!((y.max() - y.min()).abs() < 0.02 * y.amax(), "{} {}", y.min(), y.max());
    // Centring on the training set: features of the landmarks have no mean.
    let centred = whole(&prepared(Preprocess::Centred));
    for j in 0..300 {
        assert!(centred.column(j).sum().abs() < 1e-9);
    }
    let rows: f64 = landmarks.iter().map(|&j| centred[(0, j as usize)]).sum();
    assert!(rows.abs() < 1e-9);
}

#[test]
fn local_widths_are_symmetric_and_free_of_scale() {
    let distances: Vec<Vec<f32>> = [3., 40., 77.]
        .iter()
        .map(|&from: &f32| (0..100).map(|j| (j as f32 - from).abs() * if j < 50 { 1. } else { 3. }).collect())
        .collect();
    let landmarks = [3, 40, 77];
    let block = |factor: f32| {
        let rows: Vec<Vec<f32>> =
            distances.iter().map(|row| row.iter().map(|d| d * factor).collect::<Vec<f32>>()).collect();
        AffinityBlock::new(&landmarks, rows.iter().map(|row| &row[..]).collect(), Kernel::Gaussian, Bandwidth::Local(2))
            .columns_of(&(0..100).collect::<Vec<u32>>())
    };
    assert!(near(&block(1.), &block(8.), 1e-12));
    // The diagonal of A is 1 whatever the width.
    landmarks.iter().enumerate().for_each(|(k, &node)| assert_eq!(block(1.)[(k, node as usize)], 1.));
}

/// A small mesh with all its distances.
struct Small {
    ground: StudyData,
    work: WorkDir,
    run: Run<'static>,
    _dir: tempfile::TempDir,
}

fn small(metric: Metric, matrix: usize) -> Small {
    let dir = tempfile::tempdir().unwrap();
    let run = Run { threads: 2, ..Run::new(&()) };
    let path = common::shapes::dumbbell().write(dir.path());
    let work = WorkDir::temporary(dir.path()).unwrap();
    let opened = nystrom_stream::mesh::open(&path, work.path(), &run).unwrap();
    let params = StudyParams::default().metric(metric).matrix(matrix).held_out(60).lengths(true).over(Over::Faces);
    let ground = StudyData::of(&opened, &serde_json::json!(1), params, Context::new(&work, &run)).unwrap();
    Small { ground, work, run, _dir: dir }
}

impl Small {
    fn compare(&self, params: &CompareParams) -> Vec<SampleRecord> {
        compare(&self.ground, "small", params, Context::new(&self.work, &self.run)).unwrap()
    }
}

#[test]
fn every_sampling_finds_distinct_landmarks_the_same_on_matrix_and_graph() {
    let (matrix, graph) = (small(Metric::default(), 5000), small(Metric::default(), 0));
    assert!(matrix.ground.matrix.is_some() && graph.ground.matrix.is_none());
    let params = |sigma: f64| {
        // Both are measured under one width, which each knows as a mean of its own.
        CompareParams::default()
            .samplings(Sampling::ALL.to_vec())
            .landmarks(vec![1, 2, 7])
            .seeds(vec![3])
            .width(StudyWidth::Mean(sigma))
    };
    let (a, b) = (matrix.compare(&params(1.)), graph.compare(&params(matrix.ground.mean / graph.ground.mean)));
    assert_eq!(a.len(), 3 * Sampling::ALL.len());
    for (a, b) in a.iter().zip(&b) {
        let name = a.sampling.to_string();
        let mut distinct = a.landmarks.clone();
        distinct.sort_unstable();
        distinct.dedup();
        assert_eq!((distinct.len(), a.l), (a.l, a.landmarks.len()), "{name}");
        // Samplings by affinity use a σ that differs between the grounds.
        if !matches!(a.sampling, Sampling::Greedy | Sampling::PooledGreedy | Sampling::Cholesky) {
            assert_eq!(a.landmarks, b.landmarks, "{name}");
            assert!((a.measures.gamma - b.measures.gamma).abs() < 1e-9 * a.measures.gamma, "{name}");
            assert!(
                (a.search_fronts - b.search_fronts).abs() < 0.6 + 0.3 * a.search_fronts,
                "{name}: {} {}",
                a.search_fronts,
                b.search_fronts
            );
        }
    }
    // All nodes as landmarks, and more candidates than nodes.
    let tiny = Sampling::ALL.map(|sampling| {
        let nodes = [0, 1, 2, 3].map(|i| matrix.ground.nodes.at(i));
        let distances: Vec<f32> = (0..16).map(|k| (k / 4i32 - k % 4).abs() as f32).collect();
        let mut space = MatrixSpace::new(&distances, nodes[..].into(), None);
        let mut found = Vec::new();
        let sampler =
            if sampling.needs_lengths() { Sampling::Farthest } else { sampling }.sampler(SamplingParams::default());
        sampler
            .choose(4, 1, &mut space, &mut [0.; 4], &mut |node, _| {
                found.push(node);
                Ok(())
            })
            .unwrap();
        found.sort_unstable();
        found
    });
    tiny.iter().zip(Sampling::ALL).for_each(|(found, sampling)| assert_eq!(*found, [0, 1, 2, 3], "{sampling}"));
}

#[test]
fn a_work_directory_keeps_what_its_manifest_lists_and_nothing_else_of_a_study() {
    // Regression: rows of held-out columns stayed there, 80 bytes per face that no command listed.
    let (dir, mesh) = (tempfile::tempdir().unwrap(), Mesh::creature(3_528).unwrap());
    let samplings = [Sampling::GeodesicFarthest];
    let quality = SamplingQuality::new().landmarks([4]).samplings(samplings).work_dir(dir.path());
    let first = quality.run(&mesh).unwrap();
    let stages = WorkDir::open_existing(dir.path()).unwrap().manifest().stages;
    let listed: Vec<&String> = stages.values().flat_map(|stage| stage.files.keys()).collect();
    let names = std::fs::read_dir(dir.path()).unwrap().map(|file| file.unwrap().file_name().into_string().unwrap());
    let arrays: Vec<String> = names.filter(|name| name.ends_with(".npy")).collect();
    assert!(!listed.is_empty() && arrays.iter().all(|name| listed.contains(&name)), "{arrays:?} {listed:?}");
    assert_eq!(quality.run(&mesh).unwrap()[0].measures, first[0].measures);
}

#[test]
fn more_landmarks_than_nodes_are_all_nodes_and_no_sample_counts_double() {
    // Regression: 300 and 400 landmarks of fewer nodes were two samples alike, of centroids four, in means and
    // deviations too; so was a sampling that was named twice.
    let small = small(Metric::default(), 5000);
    let n = small.ground.len();
    let samplings = vec![Sampling::Uniform, Sampling::Centroids, Sampling::Uniform];
    let params = CompareParams::default().samplings(samplings).landmarks(vec![n - 1, n + 1, n + 2]).seeds(vec![3, 3]);
    let found: Vec<_> = small.compare(&params).iter().map(|record| (record.sampling, record.l)).collect();
    let of = |sampling| [(sampling, n - 1), (sampling, n)];
    assert_eq!(found, [of(Sampling::Uniform), of(Sampling::Centroids)].concat());
}

#[test]
fn greedy_sampling_takes_the_candidate_of_greatest_gamma() {
    let small = small(Metric::Geodesic, 5000);
    let (ground, n) = (&small.ground, small.ground.len());
    let matrix = ground.matrix.as_ref().unwrap();
    let row = |i: u32| &matrix[i as usize * n..(i as usize + 1) * n];
    for kernel in [Kernel::Exponential, Kernel::Gaussian] {
        // Every node is a candidate, so that the choice does not depend on a draw.
        let params = SamplingParams { kernel, sigma: Some(ground.mean), candidates: n, columns: n };
        let mut space = MatrixSpace::new(matrix, ground.nodes.view(), None);
        let mut found = Vec::new();
        let sampler = Sampling::Greedy.sampler(params);
        let mut field = vec![0.; n];
        sampler
            .choose(3, 0, &mut space, &mut field, &mut |node, _| {
                found.push(node);
                Ok(())
            })
            .unwrap();
        let gamma = |landmarks: &[u32]| {
            let rows = landmarks.iter().map(|&i| row(i)).collect();
            let block = AffinityBlock::new(landmarks, rows, kernel, Bandwidth::Global(ground.mean));
            measure(&block, None, kernel.tolerance(landmarks.len()), &small.run).unwrap().gamma
        };
        for k in 0..3 {
            let best = (0..n as u32)
                .step_by(7)
                .filter(|c| !found[..k].contains(c))
                .map(|c| gamma(&[&found[..k], &[c]].concat()))
                .fold(f64::MIN, f64::max);
            let chosen = gamma(&found[..=k]);
            assert!(chosen >= best * (1. - 1e-4), "{kernel:?} {k}: {chosen} {best}");
        }
    }
}

#[test]
fn samplings_rank_as_in_the_paper() {
    let small = small(Metric::Geodesic, 5000);
    let params = CompareParams::default()
        .samplings(vec![Sampling::Uniform, Sampling::Farthest, Sampling::Greedy])
        .landmarks(vec![10])
        .seeds((0..10).collect())
        .residual(true);
    let records = small.compare(&params);
    let lines = summary(&records);
    let of = |sampling| lines.iter().find(|line| line.sampling == sampling).unwrap();
    let [random, farthest, greedy] = [Sampling::Uniform, Sampling::Farthest, Sampling::Greedy].map(of);
    assert!(farthest.beats_random >= Some(0.9) && greedy.beats_random == Some(1.), "{lines:#?}");
    assert!(greedy.gamma_per_node.mean > farthest.gamma_per_node.mean, "{lines:#?}");
    assert!(random.residual.unwrap().mean > greedy.residual.unwrap().mean);
    for record in &records {
        let (held_out, residual) = (record.measures.held_out.unwrap(), record.residual.unwrap());
        assert!((held_out / residual - 1.).abs() < 0.5, "{held_out} {residual}");
        assert!(record.measures.gamma <= record.nodes as f64 && record.measures.max_diagonal <= 1. + 1e-6);
        assert!((record.measures.gamma_star - record.measures.gamma).abs() < 1e-6);
    }
    let means = |value: fn(&SampleRecord) -> f64| records.iter().map(value).sum::<f64>() / records.len() as f64;
    let (held_out, residual) = (means(|r| r.measures.held_out.unwrap()), means(|r| r.residual.unwrap()));
    assert!((held_out / residual - 1.).abs() < 0.15, "{held_out} {residual}");
    // The same whatever the threads.
    let run = Run { threads: 1, ..Run::new(&()) };
    let again = compare(&small.ground, "small", &params, Context::new(&small.work, &run)).unwrap();
    assert!(records.iter().zip(&again).all(|(a, b)| a.landmarks == b.landmarks && a.measures == b.measures));
}

#[test]
fn exact_norms_agree_with_gamma_and_with_all_of_w() {
    let small = small(Metric::Geodesic, 5000);
    let params = CompareParams::default().schur(true).residual(true);
    let record = &small.compare(&params)[0];
    let exact_ones = record.exact.as_ref().unwrap();
    let m = (record.nodes - record.l) as f64;
    // Nearly positive: the nuclear norm is at least the trace, and hardly more.
    assert!(exact_ones.nuclear >= m - record.measures.gamma - 1e-6);
    let trace = m - record.measures.gamma;
    assert!(exact_ones.nuclear <= 1.2 * trace, "{} {trace}", exact_ones.nuclear);
    assert!((exact_ones.residual - record.residual.unwrap()).abs() < 1e-4);
    assert!(exact_ones.angles.len() == 6 && exact_ones.angles[0] < 10.);
    // With every node a landmark nothing is left.
    let (points, _) = reference();
    let w = affinities(&points[..40]);
    let all: Vec<u32> = (0..39).collect();
    let left = exact(&w, &dense(&w, &all), 1e-12, 3, &small.run).unwrap();
    assert!(left.residual < 1e-4 && left.angles[2] < 5., "{left:?}");
}

#[test]
fn the_orthogonalised_embedding_converges_where_the_plain_one_stalls() {
    let small = small(Metric::Geodesic, 5000);
    let gaussian = CompareParams::default().kernel(Kernel::Gaussian).landmarks(vec![10, 20, 50, 100]);
    let errors = embedding_errors(&small.ground, &gaussian, Sampling::Farthest, 0, &small.run).unwrap();
    assert!(errors[1..].iter().all(|e| e.orthogonal < e.plain / 3.), "{errors:?}");
    let bounds = [0.2, 0.05, 0.04, 0.015];
    // Between vertices, through triangles: what a small sample misses is not the paths' zigzag.
    let dir = tempfile::tempdir().unwrap();
    let path = common::shapes::dumbbell().write(dir.path());
    let work = WorkDir::temporary(dir.path()).unwrap();
    let opened = nystrom_stream::mesh::open(&path, work.path(), &small.run).unwrap();
    let params = StudyParams::default().over(Over::Vertices);
    let ground = StudyData::of(&opened, &serde_json::json!(1), params, Context::new(&work, &small.run)).unwrap();
    assert_eq!(ground.len(), opened.positions.len());
    let fewer = gaussian.landmarks(vec![20, 50]);
    let marched = embedding_errors(&ground, &fewer, Sampling::Farthest, 0, &small.run).unwrap();
    assert!(marched[1].orthogonal < 0.02 && marched[1].by_area < 0.02, "{marched:?}");
    assert!(marched.iter().all(|e| e.by_area < e.plain && e.orthogonal < e.plain), "{marched:?}");
    assert!(errors.iter().zip(bounds).all(|(e, bound)| e.by_area < bound && e.orthogonal < bound), "{errors:?}");
}

#[test]
fn embeddings_are_of_the_landmarks_that_are_asked_for() {
    // Regression: ten centroids were the first of twenty, and greedy landmarks went by the exponential kernel alone.
    let small = small(Metric::Geodesic, 5000);
    let errors = |sampling, landmarks: &[usize], kernel| {
        let params = CompareParams::default().landmarks(landmarks.to_vec()).gamma_kernel(kernel);
        embedding_errors(&small.ground, &params, sampling, 0, &small.run).unwrap()[0].plain
    };
    let centroids = |landmarks| errors(Sampling::Centroids, landmarks, Kernel::Exponential);
    assert_eq!(centroids(&[10, 20]), centroids(&[10]));
    let greedy = |kernel| errors(Sampling::Greedy, &[5], kernel);
    assert_ne!(greedy(Kernel::Exponential), greedy(Kernel::Gaussian));
}

#[test]
fn meshes_of_one_name_are_compared_each_with_itself() {
    // Regression: the samples of the second were compared with random ones of the first.
    let dir = tempfile::tempdir().unwrap();
    let folders = ["a", "b"].map(|name| dir.path().join(name));
    folders.iter().for_each(|folder| std::fs::create_dir(folder).unwrap());
    let first = common::shapes::dumbbell().write(&folders[0]);
    let second = folders[1].join(first.file_name().unwrap());
    std::fs::copy(common::shapes::moebius(20).write(dir.path()), &second).unwrap();
    let other = dir.path().join("other.ply");
    std::fs::copy(&second, &other).unwrap();
    let compared = |second: &Path| {
        let words =
            ["quality", "--compare", "-q", "-l", "6", "--seeds", "2", "--sampling", "uniform,farthest", "--json"];
        let output = common::run(&[&words[..], &[common::word(&first), common::word(second)]].concat());
        let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        let meshes = json["runs"].as_array().unwrap().iter().map(|one| one["mesh"].as_str().unwrap().to_owned());
        (json["summary"].clone(), meshes.collect::<std::collections::BTreeSet<_>>().len())
    };
    assert_eq!(compared(&second), compared(&other));
    assert_eq!(compared(&second).1, 2);
}

#[test]
fn the_commands_tell_compare_and_draw() {
    let dir = tempfile::tempdir().unwrap();
    let mesh = common::shapes::dumbbell().write(dir.path());
    let path = |name: &str| dir.path().join(name);
    let run = |words: &[&str]| {
        let output = common::run(words);
        assert!(output.status.success(), "{words:?}: {}", common::errors(&output));
        String::from_utf8(output.stdout).unwrap()
    };
    let text = run(&["quality", common::word(&mesh), "-q", "--exact"]);
    for word in ["Γ/n", "Γ*", "held-out residual", "negative mass", "dropped", "nuclear", "principal angles"] {
        assert!(text.contains(word), "{text}");
    }
    let (svg, png, csv) = (path("c.svg"), path("c.png"), path("c.csv"));
    let words = ["quality", common::word(&mesh), "-q", "--compare", "-l", "3,6", "--seeds", "2", "--csv"];
    let more = ["--plot", common::word(&svg), "--plot", common::word(&png), "--json"];
    let json = run(&[&words[..], &[common::word(&csv)], &more].concat());
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!((json["summary"].as_array().unwrap().len(), json["runs"].as_array().unwrap().len()), (8, 16));
    assert_eq!(std::fs::read_to_string(&csv).unwrap().lines().count(), 17);
    assert!(std::fs::read_to_string(&svg).unwrap().starts_with("<svg"));
    assert!(std::fs::read(&png).unwrap().starts_with(b"\x89PNG"));
    let text = run(&["quality", common::word(&mesh), "-q", "--nodes", "vertices"]);
    assert!(text.contains("landmarks of") && !text.contains("faces"), "{text}");
    let text = run(&["quality", common::word(&mesh), "-q", "--local", "3", "--kernel", "gaussian"]);
    assert!(text.contains("local"), "{text}");
    let scatter = path("s.png");
    let words = ["study", "-q", "--points", "60", "-l", "5", "--runs", "8", "--plot", common::word(&scatter)];
    assert!(run(&words).contains("100.0"));
    assert!(Path::new(&scatter).exists());
    for words in [
        &["quality", common::word(&mesh), "-l", "3,6"][..],
        &["quality", common::word(&mesh), "--sigma", "0"],
        &["quality", common::word(&mesh), "--compare", "--plot", "c.gif"],
        &["study", "--points", "20", "-l", "30"],
        // Regression: with all points in both samples, agreement was said to be 0 %.
        &["study", "--points", "20", "-l", "20"],
    ] {
        assert_eq!(common::run(words).status.code(), Some(2), "{words:?}");
    }
    // Every sampling can feed a segmentation.
    for sampling in ["uniform", "geodesic-farthest", "centroids", "cholesky", "greedy", "pooled-greedy"] {
        let labels = path(&format!("{sampling}.seg"));
        run(&["segment", common::word(&mesh), "-q", "--sampling", sampling, "-l", "8", "-o", common::word(&labels)]);
    }
}
