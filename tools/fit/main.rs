//! Fits the constants of the probability that people keep two regions together to a benchmark, and tells how good they
//! are on models that they were not fitted to.
//!
//! `cargo run --release --example fit -- BENCHMARK [--cache FOLDER]`, where BENCHMARK holds `N.ply`, people's `N_j.seg`
//! and `models.tsv` with the columns model, category and parts. Target of a merge of a member is what most people do
//! (t > ½), its weight |2t − 1| times the pairs of area that it joins to a power, t being the share of people who join
//! them. Prints the constants and the mean 1 − Rand index of the parts on cells, without the last front: of constants
//! fitted to all models, to the other half of them (odd or even places in the category), and to the other four fifths of
//! the categories. Half a second of one core a model, half of that with the cache that the first run filled (4 MB a model
//! and seed).

mod data;
mod logistic;
mod trees;

use clap::Parser;
use logistic::Case;
use nystrom_stream::base::Result;
use nystrom_stream::cluster::parts::PartsParams;
use nystrom_stream::cluster::parts::regions::{FEATURES, MergeModel};
use nystrom_stream::store::Run;
use std::path::PathBuf;
use std::process::ExitCode;
use trees::{Score, Trees};

/// Parts of the categories, each judged by constants fitted to the others.
const FOLDS: usize = 5;

/// Fit the constants of the decision to a benchmark.
#[derive(Parser)]
struct Arguments {
    /// A folder with models and people's labels of them.
    benchmark: PathBuf,
    /// Where what the pipeline tells of the models is kept.
    #[arg(long, default_value = "target/fit")]
    cache: PathBuf,
    /// Seeds 0, 1, … whose members are fitted to, and whose scores are averaged.
    #[arg(long, default_value_t = 1)]
    seeds: u64,
    /// Members of a model.
    #[arg(long, default_value_t = PartsParams::default().ensemble_size)]
    members: usize,
    /// Power of the pairs in the weight of a merge.
    #[arg(long, default_value_t = 0.6)]
    power: f64,
    /// Penalty of large constants.
    #[arg(long, default_value_t = 1e-6)]
    ridge: f64,
    /// Exponent of the smaller area in the order of merges.
    #[arg(long, default_value_t = MergeModel::default().area_power)]
    area_power: f64,
    /// Exponent of the convexity in the order of merges.
    #[arg(long, default_value_t = MergeModel::default().convexity_power)]
    convexity_power: f64,
}

/// A model under a seed: which of the benchmark's it is, and its trees.
struct Grown {
    model: usize,
    trees: Trees,
}

/// Constants fitted to the models that `chosen` picks.
fn fitted(all: &[Grown], chosen: impl Fn(usize) -> bool, arguments: &Arguments) -> MergeModel {
    let examples = all.iter().filter(|grown| chosen(grown.model)).flat_map(|grown| &grown.trees.examples);
    let case = |e: &trees::Example| Case {
        features: e.features.to_vec(),
        target: f64::from(e.together > 0.5),
        weight: (2. * e.together - 1.).abs() * e.pairs.powf(arguments.power),
    };
    let found = logistic::fit(&examples.map(case).collect::<Vec<_>>(), arguments.ridge);
    let weights = std::array::from_fn(|k| found.get(k + 1).copied().unwrap_or(0.));
    MergeModel { constant: found.first().copied().unwrap_or(0.), weights, ..order(arguments) }
}

/// The order of merges that was asked for.
fn order(arguments: &Arguments) -> MergeModel {
    MergeModel { area_power: arguments.area_power, convexity_power: arguments.convexity_power, ..MergeModel::default() }
}

/// The mean over seeds and models, and over each half, of parts by the constants that `of` gives for a model.
fn judge<'a>(
    name: &str,
    all: &[Grown],
    models: &[data::Model],
    of: impl Fn(usize) -> &'a MergeModel + Sync,
    run: &Run,
) -> Result<()> {
    let one = |k: usize, (): &mut ()| {
        let Grown { model, trees } = &all[k];
        trees.score(&|m: &[f64; FEATURES]| of(*model).probability(m), models[*model].parts)
    };
    let scores = run.map_chunks(all.len(), || (), one)?;
    let mean = |chosen: &dyn Fn(&data::Model) -> bool| {
        let some: Vec<&Score> =
            all.iter().zip(&scores).filter(|(g, _)| chosen(&models[g.model])).map(|(_, s)| s).collect();
        let mean = |of: fn(&Score) -> f64| some.iter().map(|s| of(s)).sum::<f64>() / some.len().max(1) as f64;
        format!("{:.4} / {:.4}", mean(|s| s.found), mean(|s| s.given))
    };
    let (a, b) = (mean(&|m| m.position % 2 == 0), mean(&|m| m.position % 2 == 1));
    println!("{name:28} {a}   {b}   {}", mean(&|_| true));
    Ok(())
}

fn print(name: &str, model: &MergeModel) {
    let weights: Vec<String> = model.weights.iter().map(|w| format!("{w:.3}")).collect();
    println!("{name:12} {:.3}, [{}]", model.constant, weights.join(", "));
}

fn fit(arguments: &Arguments) -> Result<()> {
    let run = Run::new(&());
    let models = data::models(&arguments.benchmark)?;
    let order = order(arguments);
    let mut all = Vec::new();
    for seed in 0..arguments.seeds {
        let data = data::collect(&arguments.benchmark, &models, &arguments.cache, seed, &run)?;
        let data: Vec<_> = data.into_iter().map(|data| std::sync::Mutex::new(Some(data))).collect();
        let grow = |k: usize, (): &mut ()| {
            let data = data[k].lock().ok().and_then(|mut data| data.take());
            data.map(|data| Trees::grow(data, &order, arguments.members, seed)).transpose()
        };
        let grown = run.map_chunks(models.len(), || (), grow)?;
        all.extend(grown.into_iter().enumerate().filter_map(|(model, trees)| Some(Grown { model, trees: trees? })));
    }
    let whole = fitted(&all, |_| true, arguments);
    let halves = [0, 1].map(|half| fitted(&all, |k| models[k].position % 2 != half, arguments));
    let folds: Vec<MergeModel> =
        (0..FOLDS).map(|fold| fitted(&all, |k| models[k].category % FOLDS != fold, arguments)).collect();
    print("in use", &MergeModel::default());
    print("all", &whole);
    print("half B", &halves[0]);
    print("half A", &halves[1]);
    folds.iter().enumerate().for_each(|(k, model)| print(&format!("not fold {}", k + 1), model));
    println!("\n1 - Rand, found / given       half A            half B            all");
    let now = MergeModel { ..MergeModel::default() };
    judge("in use", &all, &models, |_| &now, &run)?;
    judge("all", &all, &models, |_| &whole, &run)?;
    judge("the other half", &all, &models, |k| &halves[models[k].position % 2], &run)?;
    judge("other categories", &all, &models, |k| &folds[models[k].category % FOLDS], &run)
}

fn main() -> ExitCode {
    match fit(&Arguments::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("fit: {error}");
            ExitCode::FAILURE
        }
    }
}
