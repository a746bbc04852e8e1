//! `study`: Fig. 1 of the paper, on points in the plane.

use super::options::RunArgs;
use super::quality::{check_plots, publish};
use super::{AppContext, Failure};
use nystrom_stream::apps::plots::charts;
use nystrom_stream::apps::study::points::{Judged, PointsParams, agreement, pairs};
use serde_json::json;
use std::fmt::Write;
use std::path::PathBuf;

#[derive(Clone, Debug, clap::Args)]
pub struct Args {
    /// Points a run
    #[arg(long, value_name = "N", default_value_t = 500, value_parser = clap::value_parser!(u32).range(2..=2000))]
    pub points: u32,
    /// Samples of them
    #[arg(short = 'l', long, value_name = "L", default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub landmarks: u32,
    /// Runs a seed, two samples each
    #[arg(long, value_name = "N", default_value_t = 100, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub runs: u32,
    /// Number of seeds, from --seed on
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub seeds: u32,
    /// Write everything as JSON; `-` for standard output, instead of the table
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// Draw the markers of the first seed with their quadrants, .svg or .png, once or more
    #[arg(long, value_name = "FILE")]
    pub plot: Vec<PathBuf>,
    #[command(flatten)]
    pub run: RunArgs,
}

pub fn run(args: &Args, app: &AppContext) -> Result<(), Failure> {
    check_plots("--plot", &args.plot)?;
    if args.landmarks > args.points {
        return Err(Failure::Misused(format!("-l: {} of {} points; choose fewer", args.landmarks, args.points)));
    }
    let bars = args.run.bars();
    let run = args.run.run(&bars, app);
    let params = PointsParams::default()
        .points(args.points as usize)
        .landmarks(args.landmarks as usize)
        .runs(args.runs as usize);
    type Norm = (&'static str, fn(&Judged) -> f64);
    let norms: [Norm; 3] = [("frobenius", |s| s.frobenius), ("spectral", |s| s.spectral), ("nuclear", |s| s.nuclear)];
    let mut text = String::from("agreement with Γ, per cent, by norm of the Schur complement\n");
    let _ = writeln!(text, "{:>6} {:>10} {:>10} {:>10}", "seed", norms[0].0, norms[1].0, norms[2].0);
    let (mut all, mut sums) = (Vec::new(), [0.; 3]);
    for k in 0..u64::from(args.seeds) {
        let seed = args.run.seed.unwrap_or(0).wrapping_add(k);
        let (pairs, _) = run.stage("runs", "runs", u64::from(args.runs), || pairs(params, seed, &run))?;
        let shares = norms.map(|(_, norm)| 100. * agreement(&pairs, norm));
        let _ = writeln!(text, "{seed:>6} {:>10.1} {:>10.1} {:>10.1}", shares[0], shares[1], shares[2]);
        (0..3).for_each(|i| sums[i] += shares[i] / f64::from(args.seeds));
        if k == 0 {
            let title = format!("{:.0} % in the first and third quadrants", shares[0]);
            args.plot.iter().try_for_each(|path| charts::scatter(path, &pairs, &title))?;
        }
        all.push(
            json!({"seed": seed, "agreement": {"frobenius": shares[0], "spectral": shares[1], "nuclear": shares[2]},
                        "runs": pairs}),
        );
    }
    let _ = writeln!(text, "{:>6} {:>10.1} {:>10.1} {:>10.1}", "mean", sums[0], sums[1], sums[2]);
    publish(&text, &json!(all), args.json.as_deref())?;
    Ok(())
}
