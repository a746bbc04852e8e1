//! Prepares the fit of the probability that people keep two regions together, and tells how good fitted trees are on models
//! that they were not fitted to.
//!
//! ```text
//! cargo run --release -p nystrom-stream-tools --bin fit -- BENCHMARK --examples examples.npy     # what people make of each merge
//! tools/fit/boost.py -o FOLDER examples.npy... [--copies copies.npy...]       # fits trees with LightGBM
//! cargo run --release -p nystrom-stream-tools --bin fit -- BENCHMARK --judge FOLDER              # 1 - Rand with them
//! cp FOLDER/all.json src/cluster/parts/merge_odds.json                       # takes them into use
//! ```
//!
//! BENCHMARK holds `N.ply`, people's `N_j.seg` and `models.tsv` with the columns model, category and parts. Scores are the
//! mean 1 − Rand index of the parts on cells, without the last front: with trees fitted to all models, to the other half of
//! them (odd or even places in the category), to the other four fifths of the categories, and to all other categories. A
//! second of one core per model and seed, half of that with the cache that the first run filled (some 8 MB per model and
//! seed).

mod data;
mod trees;

use clap::Parser;
use nystrom_stream::base::{Error, Result};
use nystrom_stream::cluster::parts::PartsParams;
use nystrom_stream::cluster::parts::merge_features::FEATURES;
use nystrom_stream::cluster::parts::merge_odds::BoostedTrees;
use nystrom_stream::cluster::parts::merges::{EnsembleMean, MergeModel};
use nystrom_stream::store::Run;
use nystrom_stream::store::npy;
use std::borrow::Cow;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use trees::{Score, Trees};

/// Parts of the categories, each judged by trees fitted to the others.
const FOLDS: usize = 5;

/// Prepare and judge fits of the decision to a benchmark.
#[derive(Parser)]
struct Arguments {
    /// A folder with models and people's labels of them.
    benchmark: PathBuf,
    /// Write what people make of each merge: a row per merge of model, category, place in the category, seed, share of people
    /// who join the two, product of the areas, and features.
    #[arg(long)]
    examples: Option<PathBuf>,
    /// Judge the trees `all.json`, `half-0.json`, `half-1.json` and `fold-0.json` to `fold-4.json` of this folder.
    #[arg(long)]
    judge: Option<PathBuf>,
    /// Where what the pipeline tells of the models is kept.
    #[arg(long, default_value = "target/fit")]
    cache: PathBuf,
    /// Seeds 0, 1, … whose merges are examples, and whose scores are averaged.
    #[arg(long, default_value_t = 1)]
    seeds: u64,
    /// Over-segmentations of a model.
    #[arg(long, default_value_t = PartsParams::default().ensemble_size)]
    ensemble: usize,
    /// Exponent of the smaller area in the order of merges.
    #[arg(long, default_value_t = MergeModel::default().area_power)]
    area_power: f64,
    /// Exponent of the convexity in the order of merges.
    #[arg(long, default_value_t = MergeModel::default().convexity_power)]
    convexity_power: f64,
    /// Exponent of the odds in the order of merges.
    #[arg(long, default_value_t = MergeModel::default().odds_power)]
    odds_power: f64,
    /// Greatest log odds that count in the order of merges.
    #[arg(long, default_value_t = MergeModel::default().odds_bound)]
    odds_bound: f64,
    /// Log odds are averaged over the ensemble, each between ± this value; 0 averages probabilities [default: as in use].
    #[arg(long, value_name = "BOUND")]
    mean_log_odds: Option<f64>,
    /// The odds that order the merges of the examples: those in this folder that were fitted to other categories, instead of
    /// those in use.
    #[arg(long)]
    order: Option<PathBuf>,
}

impl Arguments {
    /// The model of merges with these exponents and `odds`.
    fn model(&self, odds: Cow<'static, BoostedTrees>) -> MergeModel {
        let Self { area_power, convexity_power, odds_power, odds_bound, .. } = *self;
        let mean = match self.mean_log_odds {
            None => MergeModel::default().mean,
            Some(0.0) => EnsembleMean::Probabilities,
            Some(bound) => EnsembleMean::LogOdds(bound),
        };
        MergeModel { area_power, convexity_power, odds_power, odds_bound, mean, odds }
    }

    /// The same with the trees in the file `name` of `folder`.
    fn read(&self, folder: &Path, name: &str) -> Result<MergeModel> {
        let path = folder.join(name);
        let text = std::fs::read_to_string(&path).map_err(Error::io(&path, "read"))?;
        let odds = BoostedTrees::parse(&text)
            .ok_or_else(|| Error::unusable(&path, "is not a file of trees", "make it with tools/fit/boost.py"))?;
        Ok(self.model(Cow::Owned(odds)))
    }

    /// Those of the `count` divisions that `boost.py` calls `name`, each fitted to the models outside of one of them.
    fn divisions(&self, folder: &Path, name: &str, count: usize) -> Result<Vec<MergeModel>> {
        (0..count).map(|k| self.read(folder, &format!("{name}-{k}.json"))).collect()
    }
}

/// A model under a seed: which of the benchmark's it is, and its trees.
struct Grown {
    model: usize,
    seed: u64,
    trees: Trees,
}

/// Writes the examples of all models, a row each.
fn write_examples(path: &Path, all: &[Grown], models: &[data::Model]) -> Result<()> {
    let row = |grown: &Grown, e: &trees::Example| {
        let data::Model { category, position, .. } = models[grown.model];
        let key = [grown.model, category, position, grown.seed as usize].map(|x| x as f32);
        key.into_iter()
            .chain([e.together as f32, e.pairs as f32])
            .chain(e.features.map(|x| x as f32))
            .collect::<Vec<f32>>()
    };
    let rows: Vec<f32> = all.iter().flat_map(|grown| grown.trees.examples.iter().flat_map(|e| row(grown, e))).collect();
    npy::write(path, &rows, FEATURES + 6, false)?;
    Ok(())
}

/// All models under all seeds, each merged by what `of` gives for it.
fn grown<'a>(
    arguments: &Arguments,
    models: &[data::Model],
    of: impl Fn(&data::Model) -> &'a MergeModel + Sync,
    run: &Run,
) -> Result<Vec<Grown>> {
    let mut all = Vec::new();
    for seed in 0..arguments.seeds {
        let data = data::collect(&arguments.benchmark, models, &arguments.cache, seed, run)?;
        let data: Vec<_> = data.into_iter().map(|data| std::sync::Mutex::new(Some(data))).collect();
        let grow = |k: usize, (): &mut ()| {
            let data = data[k].lock().ok().and_then(|mut data| data.take());
            data.map(|data| Trees::grow(data, of(&models[k]), arguments.ensemble, seed)).transpose()
        };
        let grown = run.map_chunks(models.len(), || (), grow)?.into_iter().enumerate();
        all.extend(grown.filter_map(|(model, trees)| Some(Grown { model, seed, trees: trees? })));
    }
    Ok(all)
}

/// The mean over seeds and models, and over each half, of parts by the trees that `of` gives for a model.
fn judge<'a>(
    name: &str,
    arguments: &Arguments,
    models: &[data::Model],
    of: impl Fn(&data::Model) -> &'a MergeModel + Sync,
    run: &Run,
) -> Result<()> {
    let all = grown(arguments, models, of, run)?;
    let one = |k: usize, (): &mut ()| all[k].trees.score(models[all[k].model].parts);
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

fn fit(arguments: &Arguments) -> Result<()> {
    let run = Run::new(&());
    let models = data::models(&arguments.benchmark)?;
    let now = arguments.model(MergeModel::default().odds);
    if let Some(path) = &arguments.examples {
        let all = match &arguments.order {
            Some(folder) => {
                let folds = arguments.divisions(folder, "fold", FOLDS)?;
                grown(arguments, &models, |m| &folds[m.category % FOLDS], &run)?
            }
            None => grown(arguments, &models, |_| &now, &run)?,
        };
        return write_examples(path, &all, &models);
    }
    println!("1 - Rand, found / given       half A            half B            all");
    let Some(folder) = &arguments.judge else { return judge("in use", arguments, &models, |_| &now, &run) };
    let whole = arguments.read(folder, "all.json")?;
    judge("all", arguments, &models, |_| &whole, &run)?;
    let halves = arguments.divisions(folder, "half", 2)?;
    judge("the other half", arguments, &models, |m| &halves[m.position % 2], &run)?;
    let folds = arguments.divisions(folder, "fold", FOLDS)?;
    judge("other categories", arguments, &models, |m| &folds[m.category % FOLDS], &run)?;
    if !folder.join("category-0.json").exists() {
        return Ok(());
    }
    let categories = models.iter().map(|m| m.category + 1).max().unwrap_or(0);
    let each = arguments.divisions(folder, "category", categories)?;
    judge("all other categories", arguments, &models, |m| &each[m.category], &run)
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
