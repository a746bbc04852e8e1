//! All metrics of a pair of labellings, of one against many, and of people against each other; and tables of them by
//! category, as text and as JSON.
//!
//! Cost: a pass over the faces per pair; the data of the evaluator and of prepared labellings are shared.

use super::boundaries::{BoundaryField, Evaluator, discrepancy};
use super::contingency::{Contingency, LabelIndex, check_count, consistency, count, hamming, rand, rand_area};
use crate::base::{Error, Result};
use crate::mesh::Mesh;
use crate::store::json::pretty;
use serde::Serialize;
use std::fmt::Write;
use std::sync::Arc;

/// The metrics of labels against a truth; 0 means equal, lower is better, all except the cut discrepancy are at most 1.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Scores {
    /// 1 − Rand index over pairs of faces.
    pub rand: f64,
    /// 1 − Rand index, pairs weighted by their areas.
    pub rand_area: f64,
    /// Sum of the two mean distances between cuts over the mean radius; `None` without a mesh, or if only one of the
    /// two has cuts. A mean is taken over the pairs that have one.
    pub cut_discrepancy: Option<f64>,
    /// Mean of `missing` and `false_alarm`.
    pub hamming: f64,
    /// Share of the area that lies outside the best-overlapping part of its truth part.
    pub missing: f64,
    /// Share of the area that lies outside the best-overlapping truth part of its part.
    pub false_alarm: f64,
    /// Global consistency error by area.
    pub gce: f64,
    /// Local consistency error by area.
    pub lce: f64,
}

impl Scores {
    /// The metrics of a contingency table, without cut discrepancy.
    pub fn of_table(table: &Contingency) -> Self {
        let (hamming, consistency) = (hamming(table), consistency(table));
        Self {
            rand: rand(table),
            rand_area: rand_area(table),
            cut_discrepancy: None,
            hamming: (hamming.missing + hamming.false_alarm) / 2.,
            missing: hamming.missing,
            false_alarm: hamming.false_alarm,
            gce: consistency.gce,
            lce: consistency.lce,
        }
    }

    /// The mean of each metric; `None` for an empty list.
    pub fn mean(all: &[Self]) -> Option<Self> {
        if all.is_empty() {
            return None;
        }
        let mean = |of: fn(&Self) -> f64| all.iter().map(of).sum::<f64>() / all.len() as f64;
        let (sum, defined) =
            all.iter().filter_map(|s| s.cut_discrepancy).fold((0., 0u32), |(sum, n), x| (sum + x, n + 1));
        Some(Self {
            rand: mean(|s| s.rand),
            rand_area: mean(|s| s.rand_area),
            cut_discrepancy: (defined > 0).then(|| sum / f64::from(defined)),
            hamming: mean(|s| s.hamming),
            missing: mean(|s| s.missing),
            false_alarm: mean(|s| s.false_alarm),
            gce: mean(|s| s.gce),
            lce: mean(|s| s.lce),
        })
    }

    /// The scores with the roles of labels and truth exchanged.
    pub fn reversed(self) -> Self {
        Self { missing: self.false_alarm, false_alarm: self.missing, ..self }
    }
}

/// A labelling prepared for comparisons: parts numbered, distances to its cuts computed.
#[derive(Clone, Debug)]
pub struct Segmentation<'a> {
    labels: &'a [u32],
    numbering: LabelIndex,
    cut: Option<BoundaryField>,
    /// The evaluator that prepared it.
    evaluator: Arc<()>,
}

impl Segmentation<'_> {
    /// Number of parts: distinct labels.
    pub fn parts(&self) -> usize {
        self.numbering.len()
    }
}

impl Evaluator {
    /// Prepares labels; `name` identifies them in errors.
    ///
    /// # Errors
    /// [`Error::Parameter`] if there is not one per face; [`Error::Cancelled`].
    pub fn segmentation<'a>(&self, name: &str, labels: &'a [u32]) -> Result<Segmentation<'a>> {
        check_count(name, labels.len(), self.faces)?;
        let cut = self.edges.as_ref().map(|edges| BoundaryField::of(edges, labels, &self.cancel)).transpose()?;
        Ok(Segmentation { labels, numbering: LabelIndex::of(labels), cut, evaluator: self.identity.clone() })
    }

    /// Prepares the labels of several people; errors call them "truth 1" and so on.
    ///
    /// # Errors
    /// As [`Evaluator::segmentation`].
    pub fn segmentations<'a, L: AsRef<[u32]>>(&self, truths: &'a [L]) -> Result<Vec<Segmentation<'a>>> {
        (1..).zip(truths).map(|(k, labels)| self.segmentation(&format!("truth {k}"), labels.as_ref())).collect()
    }

    /// The overlaps of two labellings of this surface.
    ///
    /// # Errors
    /// [`Error::Parameter`] if one was prepared by another evaluator (a clone of this one is the same).
    pub fn contingency(&self, labels: &Segmentation, truth: &Segmentation) -> Result<Contingency> {
        for (name, prepared) in [("labels", labels), ("truth", truth)] {
            if !Arc::ptr_eq(&prepared.evaluator, &self.identity) {
                return Err(Error::parameter(name, "another evaluator prepared it", "prepare it with this one"));
            }
        }
        Ok(count((labels.labels, &labels.numbering), (truth.labels, &truth.numbering), self.areas.as_deref()))
    }

    /// All metrics of a pair, both prepared by this evaluator.
    ///
    /// # Errors
    /// As [`Evaluator::contingency`].
    pub fn compare(&self, labels: &Segmentation, truth: &Segmentation) -> Result<Scores> {
        let scores = Scores::of_table(&self.contingency(labels, truth)?);
        let cuts = self.edges.as_ref().zip(labels.cut.as_ref()).zip(truth.cut.as_ref());
        let cut_discrepancy = cuts.and_then(|((edges, one), other)| discrepancy(edges, one, other));
        Ok(Scores { cut_discrepancy, ..scores })
    }

    /// Mean metrics of one labelling against several truths.
    ///
    /// # Errors
    /// [`Error::Parameter`] if there is no truth; as [`Evaluator::contingency`].
    pub fn compare_many(&self, labels: &Segmentation, truths: &[Segmentation]) -> Result<Scores> {
        let all: Vec<Scores> = truths.iter().map(|truth| self.compare(labels, truth)).collect::<Result<_>>()?;
        Scores::mean(&all).ok_or_else(|| Error::parameter("truth", "there is none", "give at least one labelling"))
    }

    /// Mean metrics of each person against the others, as if each in turn were evaluated.
    ///
    /// # Errors
    /// [`Error::Parameter`] if there are fewer than two; as [`Evaluator::contingency`].
    pub fn people(&self, truths: &[Segmentation]) -> Result<Scores> {
        let mut all = Vec::with_capacity(truths.len() * truths.len().saturating_sub(1));
        for (k, one) in truths.iter().enumerate() {
            for other in &truths[..k] {
                let scores = self.compare(one, other)?;
                all.extend([scores, scores.reversed()]);
            }
        }
        Scores::mean(&all).ok_or_else(|| {
            Error::parameter("truth", format!("{} to compare with each other", truths.len()), "give at least two")
        })
    }
}

/// All metrics of one pair of labellings; without a mesh every face has the same weight and there is no cut
/// discrepancy.
///
/// ```
/// use nystrom_stream::apps::evaluate::compare;
/// // The values of labels do not matter; here one face of four is in the wrong part.
/// assert_eq!(compare(None, &[7, 7, 3, 3], &[0, 0, 1, 1])?.rand, 0.);
/// assert_eq!(compare(None, &[7, 3, 3, 3], &[0, 0, 1, 1])?.rand, 0.5);
/// # Ok::<(), nystrom_stream::base::Error>(())
/// ```
///
/// # Errors
/// [`Error::Parameter`] if labels, truth and faces differ in number.
pub fn compare(mesh: Option<&Mesh>, labels: &[u32], truth: &[u32]) -> Result<Scores> {
    let faces = mesh.map_or(truth.len(), |mesh| mesh.faces.len());
    check_count("labels", labels.len(), faces)?;
    check_count("truth", truth.len(), faces)?;
    let surface = mesh.map_or_else(|| Ok(Evaluator::of_faces(faces)), Evaluator::of)?;
    surface.compare(&surface.segmentation("labels", labels)?, &surface.segmentation("truth", truth)?)
}

/// The scores of one model of a collection.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ModelScores {
    /// The model's name.
    pub model: String,
    /// The category it belongs to.
    pub category: String,
    /// Its scores, a mean over truths.
    #[serde(flatten)]
    pub scores: Scores,
    /// Number of parts; for people, their mean.
    pub parts: f64,
}

/// A line of the table: means over models.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MeanScores {
    /// The category, or a description of the summary line.
    pub name: String,
    /// Number of models.
    pub models: usize,
    /// Mean number of parts.
    pub parts: f64,
    /// Mean scores.
    #[serde(flatten)]
    pub scores: Scores,
}

/// Scores by category, over all, and next to them those of people on the same models.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ScoreTable {
    /// One line per category, in the order of their first model.
    pub categories: Vec<MeanScores>,
    /// Mean over all models; `None` if there are none.
    pub overall: Option<MeanScores>,
    /// People against other people, mean over models; `None` if not requested.
    pub people: Option<MeanScores>,
    /// Every model.
    pub models: Vec<ModelScores>,
}

/// The columns after name and number of models: title, decimals, value.
type Column = (&'static str, usize, fn(&MeanScores) -> Option<f64>);
const COLUMNS: [Column; 9] = [
    ("parts", 1, |row| Some(row.parts)),
    ("1-rand", 4, |row| Some(row.scores.rand)),
    ("by area", 4, |row| Some(row.scores.rand_area)),
    ("cut d.", 4, |row| row.scores.cut_discrepancy),
    ("hamming", 4, |row| Some(row.scores.hamming)),
    ("missing", 4, |row| Some(row.scores.missing)),
    ("false a.", 4, |row| Some(row.scores.false_alarm)),
    ("gce", 4, |row| Some(row.scores.gce)),
    ("lce", 4, |row| Some(row.scores.lce)),
];

impl ScoreTable {
    /// The table of `models`, with a line for the scores of `people` on the same models unless that is empty.
    pub fn new(models: Vec<ModelScores>, people: &[ModelScores]) -> Self {
        let mut names: Vec<&str> = Vec::new();
        for model in &models {
            if !names.contains(&model.category.as_str()) {
                names.push(&model.category);
            }
        }
        let of = |name: &&str| row(name, models.iter().filter(|model| model.category == **name));
        let categories = names.iter().filter_map(of).collect();
        Self { categories, overall: row("all models", &models), people: row("people", people), models }
    }

    /// Aligned text, one line per row, numbers to four places, `-` where a metric is undefined.
    pub fn to_text(&self) -> String {
        self.to_text_under("category", "models")
    }

    /// The same with other titles for the first two columns.
    pub fn to_text_under(&self, name: &str, count: &str) -> String {
        let sums = self.overall.iter().chain(&self.people);
        let rows: Vec<&MeanScores> = self.categories.iter().chain(sums).collect();
        let width = rows.iter().map(|row| row.name.chars().count()).max().unwrap_or(0).max(name.len());
        let mut text = format!("{name:width$} {count:>6}");
        // Writing to a string does not fail.
        for (title, _, _) in COLUMNS {
            let _ = write!(text, " {title:>8}");
        }
        for (k, row) in rows.iter().enumerate() {
            if k == self.categories.len() {
                let _ = write!(text, "\n{}", "-".repeat(width + 7 + 9 * COLUMNS.len()));
            }
            let _ = write!(text, "\n{:width$} {:>6}", row.name, row.models);
            for (_, decimals, value) in COLUMNS {
                let _ = match value(row) {
                    Some(value) => write!(text, " {value:>8.decimals$}"),
                    None => write!(text, " {:>8}", "-"),
                };
            }
        }
        text.push('\n');
        text
    }

    /// The table as JSON: `categories`, `overall`, `people`, `models`.
    ///
    /// # Errors
    /// As [`pretty`].
    pub fn to_json(&self) -> Result<String> {
        pretty("the table", self)
    }
}

/// The mean of models under a name; `None` for an empty list.
fn row<'a>(name: &str, models: impl IntoIterator<Item = &'a ModelScores>) -> Option<MeanScores> {
    let (scores, parts): (Vec<Scores>, Vec<f64>) =
        models.into_iter().map(|model| (model.scores, model.parts)).collect();
    let mean = Scores::mean(&scores)?;
    let parts_mean = parts.iter().sum::<f64>() / parts.len() as f64;
    Some(MeanScores { name: name.to_owned(), models: scores.len(), parts: parts_mean, scores: mean })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn model(name: &str, category: &str, rand: f64, cut_discrepancy: Option<f64>) -> ModelScores {
        let scores = Scores {
            rand,
            rand_area: 0.,
            cut_discrepancy,
            hamming: 0.,
            missing: 0.,
            false_alarm: 0.,
            gce: 0.,
            lce: 0.,
        };
        ModelScores { model: name.into(), category: category.into(), scores, parts: 3. }
    }

    fn table() -> ScoreTable {
        let cup = [model("1", "cup", 0.1, Some(2.)), model("3", "cup", 0.3, None)];
        let models = vec![cup[0].clone(), model("2", "armadillo", 0.5, None), cup[1].clone()];
        ScoreTable::new(models, &cup)
    }

    #[test]
    fn rows_are_means_in_order_of_appearance() {
        let table = table();
        let names: Vec<_> = table.categories.iter().map(|row| (row.name.as_str(), row.models)).collect();
        assert_eq!(names, [("cup", 2), ("armadillo", 1)]);
        assert_eq!(table.categories[0].scores.rand, 0.2);
        assert_eq!(table.categories[0].scores.cut_discrepancy, Some(2.));
        assert!((table.overall.unwrap().scores.rand - 0.3).abs() < 1e-15);
        let nothing = ScoreTable::new(Vec::new(), &[]);
        assert!(nothing.overall.is_none() && nothing.to_text().lines().count() == 1);
    }

    #[test]
    fn text_is_aligned_and_json_complete() {
        let text = table().to_text();
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), 6);
        assert!(lines.iter().all(|line| line.chars().count() == lines[0].chars().count()));
        assert!(lines[1].split_whitespace().take(4).eq(["cup", "2", "3.0", "0.2000"]));
        assert!(lines[2].contains('-') && lines[4].starts_with("all models"));
        let json: serde_json::Value = serde_json::from_str(&table().to_json().unwrap()).unwrap();
        assert_eq!(json["people"]["rand"], 0.2);
        assert_eq!(json["models"][1]["cut_discrepancy"], serde_json::Value::Null);
    }
}
