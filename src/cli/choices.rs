//! The library's enums as option values: for each value its name and a line of help, in one table per enum.
//!
//! The library does not know clap. An option takes such an enum by `value_parser = choice::<T>()`, which lists names
//! and help.

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use nystrom_stream::apps::correspond::Refine;
use nystrom_stream::apps::sequence::SequenceOrder;
use nystrom_stream::apps::study::Over;
use nystrom_stream::cluster::parts::Decision;
use nystrom_stream::distance::vertex_rows::Distance;
use nystrom_stream::graph::{Metric, Order};
use nystrom_stream::landmarks::Sampling;
use nystrom_stream::mesh::ply::labelled::PlyForm;
use nystrom_stream::pipeline::sharding::ShareStep;
use nystrom_stream::pipeline::{Boundaries, Cluster, TinyComponents, Walls};
use nystrom_stream::spectral::{Kernel, Normalisation};

/// A value, its name on the command line, and its help.
type Named<T> = (T, &'static str, &'static str);

/// An enum that can be an option's value.
pub trait Choice: Copy + Send + Sync + 'static {
    /// All values, in the order of the help.
    const CHOICES: &'static [Named<Self>];
}

/// The parser of an option that takes a `T`.
pub fn choice<T: Choice>() -> impl TypedValueParser<Value = T> {
    let values = T::CHOICES.iter().map(|(_, name, help)| PossibleValue::new(*name).help(*help));
    PossibleValuesParser::new(values).try_map(|word| {
        let found = T::CHOICES.iter().find(|(_, name, _)| *name == word);
        found.map(|(value, ..)| *value).ok_or("is none of them")
    })
}

/// The name of `value` on the command line.
pub fn name_of<T: Choice + PartialEq>(value: T) -> &'static str {
    T::CHOICES.iter().find(|(choice, ..)| *choice == value).map_or("", |(_, name, _)| name)
}

impl Choice for Sampling {
    const CHOICES: &'static [Named<Self>] = &[
        (Self::Farthest, "farthest", "Max–min farthest points, starting at an extremity (§6.2 of the paper)"),
        (Self::Random, "random", "At random, with probability proportional to area"),
        (
            Self::DistanceWeighted,
            "distance-weighted",
            "At random, by area times the distance to the nearest landmark so far",
        ),
        (Self::Uniform, "uniform", "At random, each face with the same probability (the paper's random sampling)"),
        (Self::GeodesicFarthest, "geodesic-farthest", "Farthest points by length alone, whatever the metric"),
        (Self::Centroids, "centroids", "Farthest points, each moved to the middle of its Voronoi cell"),
        (Self::Cholesky, "cholesky", "Randomly pivoted Cholesky"),
        (Self::Greedy, "greedy", "The best of 90 random candidates by Γ (§6.1): 90 rows of distances per landmark"),
        (Self::PooledGreedy, "pooled-greedy", "The same with the candidates kept: 90 rows, and one more per landmark"),
    ];
}

impl Choice for ShareStep {
    const CHOICES: &'static [Named<Self>] = &[
        (Self::Normals, "normals", "The fronts for the averaged normals, by ranges of faces"),
        (
            Self::Contraction,
            "contraction",
            "The front that contracts the mesh, by ranges of faces; start when all shares of the normals are done",
        ),
        (
            Self::ContractedRows,
            "rows",
            "The rows over the contraction, by landmark; start when all shares of the contraction are done",
        ),
        (
            Self::Depths,
            "depths",
            "The front that finds the interiors of parts, by ranges of faces; start when all rows are done",
        ),
        (
            Self::Bands,
            "bands",
            "The front that labels the bands around boundaries, by ranges of faces; start when all shares of the depths \
             are done",
        ),
    ];
}

impl Choice for Refine {
    const CHOICES: &'static [Named<Self>] = &[
        (Self::Nystrom, "nystrom", "In a hundred smooth functions by Nyström's extension from a local sample"),
        (
            Self::Laplacian,
            "laplacian",
            "In a hundred eigenfunctions of the Laplace–Beltrami operator (cotangents), reduced to a sample",
        ),
        (Self::None, "none", "Not at all (the paper's way)"),
    ];
}

impl Choice for Kernel {
    const CHOICES: &'static [Named<Self>] = &[
        (Self::Gaussian, "gaussian", "exp(−d²/2σ²)"),
        (Self::Exponential, "exponential", "exp(−d/σ)"),
        (Self::Polynomial { degree: 3 }, "polynomial", "max(0, 1 − d/4σ)³"),
        (Self::InverseMultiquadric, "inverse-multiquadric", "1/√(1 + d²/σ²)"),
        (Self::Matern, "matern", "(1 + √3 d/σ) exp(−√3 d/σ)"),
        (Self::Cauchy, "cauchy", "1/(1 + d²/σ²)"),
    ];
}

impl Choice for Normalisation {
    const CHOICES: &'static [Named<Self>] = &[
        (Self::None, "none", "Not at all (eq. 1)"),
        (Self::Degree, "degree", "By the square roots of both degrees"),
        (Self::Anchor, "anchor", "As an anchor graph"),
    ];
}

impl Choice for Order {
    const CHOICES: &'static [Named<Self>] = &[
        (Self::Keep, "keep", "As in the file"),
        (Self::Hilbert, "hilbert", "Sorted along a Hilbert curve"),
        (Self::Auto, "auto", "Sorted where the mesh is large and the order of the file is poor"),
    ];
}

impl Choice for Cluster {
    const CHOICES: &'static [Named<Self>] = &[
        (Self::Parts, "parts", "Parts as people would cut them; their number is found"),
        (Self::KMeans, "kmeans", "K-means in the spectral embedding, as in the paper"),
        (
            Self::TwoMeans,
            "two-means",
            "Repeated 2-means in the embedding, as in the paper; without -k, until no split gains much",
        ),
        (Self::Components, "components", "Connected components, by descending area, whatever their shape"),
    ];
}

impl Choice for Decision {
    const CHOICES: &'static [Named<Self>] = &[
        (
            Self::SoftTrees,
            "soft-trees",
            "Twelve merge trees with probabilities; the labelling with the greatest expected Rand index",
        ),
        (
            Self::Consensus,
            "consensus",
            "Several over-segmentations merged up to a threshold, combined by average linkage",
        ),
        (Self::Single, "single", "One over-segmentation, merged up to a threshold"),
    ];
}

impl Choice for TinyComponents {
    const CHOICES: &'static [Named<Self>] = &[
        (Self::Join, "join", "Each joins the nearest part"),
        (Self::Own, "own", "Together they form one extra part, the last one, which -k does not count"),
    ];
}

impl Choice for Walls {
    const CHOICES: &'static [Named<Self>] = &[
        (Self::Follow, "follow", "They get the labels of the outer surface behind them"),
        (Self::Own, "own", "Together they form one extra part after the others, which -k does not count"),
    ];
}

impl Choice for Boundaries {
    const CHOICES: &'static [Named<Self>] = &[
        (Self::Front, "front", "From the nearest part by distance, so that boundaries lie on creases"),
        (
            Self::Embedding,
            "embedding",
            "From each face's coordinates in the spectral embedding (Nyström extrapolation)",
        ),
    ];
}

impl Choice for Metric {
    const CHOICES: &'static [Named<Self>] = &[
        (
            Self::ScaleFree { beta: 5., eta: 0.05 },
            "scale-free",
            "Length + β·turning, in units of the size of the shape",
        ),
        (Self::Paper { delta: 0.03, eta: 0.1 }, "paper", "δ·length/mean + (1−δ)·(1−cos)/mean, as in the paper"),
        (Self::Geodesic, "geodesic", "Length alone"),
    ];
}

impl Choice for PlyForm {
    const CHOICES: &'static [Named<Self>] = &[
        (Self::Same, "same", "As the input"),
        (Self::Binary, "binary", "Little-endian"),
        (Self::Ascii, "ascii", "Text"),
    ];
}

impl Choice for Distance {
    const CHOICES: &'static [Named<Self>] = &[
        (Self::Edges, "edges", "Along edges (Dijkstra)"),
        (Self::March, "march", "Through triangles (fast marching)"),
    ];
}

impl Choice for Over {
    const CHOICES: &'static [Named<Self>] = &[
        (Self::Faces, "faces", "Faces, with the distances of --metric"),
        (Self::Vertices, "vertices", "Vertices, with distances through triangles"),
    ];
}

impl Choice for SequenceOrder {
    const CHOICES: &'static [Named<Self>] = &[
        (Self::Spectral, "spectral", "The second vector of the degree-normalised Nyström embedding"),
        (Self::Pca, "pca", "The longest principal axis"),
        (Self::Bfs, "bfs", "Breadth-first search from a peripheral vertex"),
        (Self::Rcm, "rcm", "Reverse Cuthill–McKee"),
        (Self::Hilbert, "hilbert", "A Hilbert curve"),
        (Self::Random, "random", "At random"),
        (Self::Keep, "keep", "Faces as in the file, vertices in the order in which faces use them"),
    ];
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::Serialize;
    use serde::de::DeserializeOwned;
    use serde_json::{Value, from_value, json, to_value};

    /// The names of the variants of `T` in files, as serde lists them for an unknown variant. Variants with fields have
    /// their name under `tag`.
    fn words<T: DeserializeOwned>(tag: Option<&str>) -> Vec<String> {
        let other = tag.map_or(json!("?"), |tag| json!({tag: "?"}));
        let told = from_value::<T>(other).err().unwrap().to_string();
        told.split('`').skip(3).step_by(2).map(str::to_string).collect()
    }

    /// The literals of the type `name` of the Python package; `None` if its sources are not there.
    fn literal(name: &str) -> Option<Vec<String>> {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/python/python/nystrom_stream/_functions.py");
        let text = std::fs::read_to_string(path).ok()?;
        let start = format!("\n{name} = Literal[");
        let rest = &text[text.find(&start).unwrap() + start.len()..];
        Some(rest[..rest.find(']').unwrap()].split('"').skip(1).step_by(2).map(str::to_string).collect())
    }

    fn sorted(mut words: Vec<String>) -> Vec<String> {
        words.sort();
        words
    }

    /// The command line has every variant of `T` once, under the name used in files; so has the Python type `python`,
    /// which also has the command-line names in `besides` that files do not have.
    fn check<T: Choice + Serialize + DeserializeOwned>(tag: Option<&str>, python: Option<&str>, besides: &[&str]) {
        let of_files = words::<T>(tag);
        let mut of_options = Vec::new();
        for (value, name, _) in T::CHOICES {
            let word = to_value(value).map(|told| tag.map_or(told.clone(), |tag| told[tag].clone())).unwrap();
            let Value::String(word) = word else { panic!("{name} has no word: {word}") };
            assert!(word == *name || besides.contains(name), "{name} is {word} in files");
            of_options.push(word);
        }
        assert_eq!(sorted(of_options), sorted(of_files.clone()));
        if let Some(of_python) = python.and_then(literal) {
            let besides = besides.iter().map(|name| name.to_string());
            assert_eq!(sorted(of_python), sorted(of_files.into_iter().chain(besides).collect()), "{python:?}");
        }
    }

    #[test]
    fn the_command_line_and_python_know_every_variant_by_its_word_in_files() {
        check::<Sampling>(None, Some("Sampling"), &[]);
        check::<Refine>(None, Some("Refine"), &[]);
        check::<Kernel>(Some("kernel"), Some("Kernel"), &[]);
        check::<Normalisation>(None, Some("Normalise"), &[]);
        check::<Order>(None, Some("Order"), &[]);
        check::<Cluster>(None, Some("Cluster"), &["kmeans"]);
        check::<Decision>(None, Some("Decision"), &[]);
        check::<TinyComponents>(None, Some("TinyComponents"), &[]);
        check::<Walls>(None, Some("Walls"), &[]);
        check::<Boundaries>(None, Some("Boundaries"), &[]);
        check::<Metric>(Some("form"), Some("Metric"), &[]);
        check::<Distance>(None, Some("Distance"), &[]);
        check::<SequenceOrder>(None, Some("StreamOrder"), &[]);
    }
}
