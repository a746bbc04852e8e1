//! Scores of many models as a table by category, for reading and as JSON.

use super::Scores;
use crate::base::{Error, Result};
use serde::Serialize;
use std::fmt::Write;

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
    /// Number of parts; for people their mean.
    pub parts: f64,
}

/// A line of the table: means over models.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// The category, or what the line sums up.
    pub name: String,
    /// Number of models.
    pub models: usize,
    /// Mean number of parts.
    pub parts: f64,
    /// Mean scores.
    #[serde(flatten)]
    pub scores: Scores,
}

/// Scores by category, over all, and beside them those of people on the same models.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Table {
    /// A line a category, in the order of their first model.
    pub categories: Vec<Row>,
    /// Mean over all models; absent where there are none.
    pub overall: Option<Row>,
    /// People against other people, mean over models; absent where not asked for.
    pub people: Option<Row>,
    /// Every model.
    pub models: Vec<ModelScores>,
}

/// The columns behind name and number of models: title, decimals, value.
type Column = (&'static str, usize, fn(&Row) -> Option<f64>);
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

impl Table {
    /// The table of `models`, with a line for `people`'s scores of the same models unless empty.
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

    /// Aligned text, a line a row, numbers to four places, `-` where a metric is undefined.
    pub fn to_text(&self) -> String {
        self.to_text_under("category", "models")
    }

    /// The same under other titles of the first two columns.
    pub fn to_text_under(&self, name: &str, count: &str) -> String {
        let sums = self.overall.iter().chain(&self.people);
        let rows: Vec<&Row> = self.categories.iter().chain(sums).collect();
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
    /// [`Error::Parameter`] where the serialiser refuses it, which no finite table makes it do.
    pub fn to_json(&self) -> Result<String> {
        serde_json::to_string_pretty(self)
            .map_err(|error| Error::parameter("table", error.to_string(), "report this as a fault"))
    }
}

/// The mean of models under a name; `None` of nothing.
fn row<'a>(name: &str, models: impl IntoIterator<Item = &'a ModelScores>) -> Option<Row> {
    let (scores, parts): (Vec<Scores>, Vec<f64>) =
        models.into_iter().map(|model| (model.scores, model.parts)).collect();
    let mean = Scores::mean(&scores)?;
    let parts_mean = parts.iter().sum::<f64>() / parts.len() as f64;
    Some(Row { name: name.to_owned(), models: scores.len(), parts: parts_mean, scores: mean })
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

    fn table() -> Table {
        let cup = [model("1", "cup", 0.1, Some(2.)), model("3", "cup", 0.3, None)];
        let models = vec![cup[0].clone(), model("2", "armadillo", 0.5, None), cup[1].clone()];
        Table::new(models, &cup)
    }

    #[test]
    fn rows_are_means_in_order_of_appearance() {
        let table = table();
        let names: Vec<_> = table.categories.iter().map(|row| (row.name.as_str(), row.models)).collect();
        assert_eq!(names, [("cup", 2), ("armadillo", 1)]);
        assert_eq!(table.categories[0].scores.rand, 0.2);
        assert_eq!(table.categories[0].scores.cut_discrepancy, Some(2.));
        assert!((table.overall.unwrap().scores.rand - 0.3).abs() < 1e-15);
        let nothing = Table::new(Vec::new(), &[]);
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
