//! Records summarised over meshes and seeds: a readable table, and CSV and JSON of everything.
//!
//! Cost: microseconds per record, of which a study has thousands; independent of the mesh size.

use super::compare::SampleRecord;
use crate::base::printable::{Significant, counted};
use crate::landmarks::Sampling;
use serde::Serialize;
use std::fmt::Write;

/// Mean and standard deviation over samples.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Spread {
    /// Mean.
    pub mean: f64,
    /// Standard deviation (with n − 1).
    pub deviation: f64,
}

impl Spread {
    /// The spread of the given numbers; `None` if there are none.
    pub fn of(values: &[f64]) -> Option<Self> {
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        let square: f64 = values.iter().map(|x| (x - mean).powi(2)).sum();
        (!values.is_empty()).then(|| Self { mean, deviation: (square / (n - 1.).max(1.)).sqrt() })
    }
}

/// A sampling at a number of landmarks, over all meshes and seeds.
#[derive(Clone, Debug, Serialize)]
pub struct SamplingSummary {
    /// The sampling.
    pub sampling: Sampling,
    /// Number of landmarks l.
    pub l: usize,
    /// Samples.
    pub samples: usize,
    /// Γ/n.
    pub gamma_per_node: Spread,
    /// Γ*/n.
    pub gamma_star_per_node: Spread,
    /// Held-out residual.
    pub held_out: Option<Spread>,
    /// Residual of all of W.
    pub residual: Option<Spread>,
    /// Negative mass of A.
    pub negative_mass: Spread,
    /// Dropped eigenpairs.
    pub dropped_eigenpairs: Spread,
    /// Number of fronts of the search.
    pub search_fronts: Spread,
    /// Share of pairs (same mesh, seed and l) with a greater Γ than random sampling; the paper's Fig. 5.
    pub beats_random: Option<f64>,
}

/// Summarises `records`, in the order in which samplings and sizes first appear.
pub fn summary(records: &[SampleRecord]) -> Vec<SamplingSummary> {
    let mut keys: Vec<(Sampling, usize)> = Vec::new();
    for record in records {
        if !keys.contains(&(record.sampling, record.l)) {
            keys.push((record.sampling, record.l));
        }
    }
    let random = [Sampling::Uniform, Sampling::Random].into_iter().find(|s| records.iter().any(|r| r.sampling == *s));
    keys.iter().map(|&key| line(key, records, random)).collect()
}

fn line((sampling, l): (Sampling, usize), records: &[SampleRecord], random: Option<Sampling>) -> SamplingSummary {
    let own: Vec<&SampleRecord> = records.iter().filter(|r| r.sampling == sampling && r.l == l).collect();
    let spread = |value: &dyn Fn(&SampleRecord) -> Option<f64>| {
        Spread::of(&own.iter().filter_map(|record| value(record)).collect::<Vec<_>>())
    };
    let certain = |value: &dyn Fn(&SampleRecord) -> f64| spread(&|record| Some(value(record))).unwrap_or_default();
    let pairs: Vec<bool> = own
        .iter()
        .filter_map(|record| {
            let same = |other: &&SampleRecord| {
                Some(other.sampling) == random
                    && (&other.mesh, other.seed, other.l) == (&record.mesh, record.seed, record.l)
            };
            records.iter().find(same).map(|other| record.measures.gamma > other.measures.gamma)
        })
        .collect();
    let beats = pairs.iter().filter(|beats| **beats).count() as f64 / pairs.len().max(1) as f64;
    SamplingSummary {
        sampling,
        l,
        samples: own.len(),
        gamma_per_node: certain(&|r| r.measures.gamma_per_node),
        gamma_star_per_node: certain(&|r| r.measures.gamma_star / r.nodes.max(1) as f64),
        held_out: spread(&|r| r.measures.held_out),
        residual: spread(&|r| r.residual),
        negative_mass: certain(&|r| r.measures.negative_mass),
        dropped_eigenpairs: certain(&|r| r.measures.dropped_eigenpairs as f64),
        search_fronts: certain(&|r| r.search_fronts),
        beats_random: (!pairs.is_empty() && Some(sampling) != random).then_some(beats),
    }
}

/// Aligned text, one line per sampling and l.
pub fn to_text(lines: &[SamplingSummary]) -> String {
    let mut text = format!(
        "{:18} {:>4} {:>7} {:>14} {:>7} {:>14} {:>14} {:>8} {:>7} {:>7} {:>6}\n",
        "sampling", "l", "samples", "Γ/n", "Γ*/n", "held out", "residual", "negative", "dropped", "search", "beats"
    );
    for line in lines {
        let spread = |spread: Option<Spread>| match spread {
            Some(spread) if line.samples > 1 => format!("{:.3} ± {:.3}", spread.mean, spread.deviation),
            Some(spread) => format!("{:.4}", spread.mean),
            None => "-".into(),
        };
        let beats = line.beats_random.map_or("-".into(), |share| format!("{:.0} %", 100. * share));
        let _ = writeln!(
            text,
            "{:18} {:>4} {:>7} {:>14} {:>7.3} {:>14} {:>14} {:>8.3} {:>7.1} {:>7.1} {:>6}",
            line.sampling,
            line.l,
            line.samples,
            spread(Some(line.gamma_per_node)),
            line.gamma_star_per_node.mean,
            spread(line.held_out),
            spread(line.residual),
            line.negative_mass.mean,
            line.dropped_eigenpairs.mean,
            line.search_fronts.mean,
            beats
        );
    }
    text
}

/// One record, number by number.
pub fn one_to_text(record: &SampleRecord) -> String {
    let m = &record.measures;
    let mut text = String::new();
    let mut tell = |name: &str, value: String| {
        let _ = writeln!(text, "{name:28} {value}");
    };
    let (landmarks, nodes) = (counted(record.l, "landmark"), counted(record.nodes, "node"));
    tell("sampling", format!("{}, {landmarks} of {nodes}", record.sampling));
    tell("search", format!("{:.1} fronts besides {}", record.search_fronts, counted(record.l, "row")));
    tell("σ", record.sigma.map_or("local".into(), |sigma| format!("{:.6}", Significant(sigma))));
    tell("Γ", format!("{:.6}", m.gamma));
    tell("Γ/n", format!("{:.6}", m.gamma_per_node));
    tell("Γ*", format!("{:.6}", m.gamma_star));
    tell("greatest w̃", format!("{:.6}", m.max_diagonal));
    if let Some(held_out) = m.held_out {
        tell("held-out residual", format!("{held_out:.6}"));
    }
    tell("negative mass of A", format!("{:.6} in {} eigenvalues", m.negative_mass, m.negative_eigenvalues));
    tell("dropped eigenpairs", m.dropped_eigenpairs.to_string());
    if let Some(residual) = record.residual {
        tell("residual", format!("{residual:.6}"));
    }
    if let Some(exact) = &record.exact {
        tell("Schur complement, Frobenius", format!("{:.6}", exact.frobenius));
        tell("Schur complement, spectral", format!("{:.6}", exact.spectral));
        tell("Schur complement, nuclear", format!("{:.6}", exact.nuclear));
        let angles: Vec<String> = exact.angles.iter().map(|angle| format!("{angle:.2}")).collect();
        tell("principal angles, degrees", angles.join(" "));
    }
    text
}

/// Every record as a line of comma-separated values, after a header line. Commas in names of meshes become underscores.
pub fn to_csv(records: &[SampleRecord]) -> String {
    let mut text =
        "mesh,sampling,l,seed,nodes,sigma,search_fronts,gamma,gamma_per_node,gamma_star,max_diagonal,held_out,\
                    negative_mass,negative_eigenvalues,dropped_eigenpairs,residual\n"
            .to_owned();
    let maybe = |value: Option<f64>| value.map_or(String::new(), |value| value.to_string());
    for record in records {
        let m = &record.measures;
        let _ = writeln!(
            text,
            "{},{},{},{},{},{},{},{},{},{},{},{},{},{},{},{}",
            record.mesh.replace([',', '\n', '"'], "_"),
            record.sampling,
            record.l,
            record.seed,
            record.nodes,
            maybe(record.sigma),
            record.search_fronts,
            m.gamma,
            m.gamma_per_node,
            m.gamma_star,
            m.max_diagonal,
            maybe(m.held_out),
            m.negative_mass,
            m.negative_eigenvalues,
            m.dropped_eigenpairs,
            maybe(record.residual)
        );
    }
    text
}
