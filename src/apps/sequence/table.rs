//! Measures of several orders side by side.

use super::Measures;
use serde::Serialize;
use std::fmt::Write;

/// An order and its measures.
#[derive(Clone, Debug, Serialize)]
pub struct Compared {
    /// Its name.
    pub order: String,
    /// How well it streams.
    #[serde(flatten)]
    pub measures: Measures,
}

/// A table, a line an order.
pub fn table(orders: &[Compared]) -> String {
    let name = orders.iter().map(|one| one.order.chars().count()).max().unwrap_or(0).max(5);
    let mut out = format!(
        "{:name$}  {:>10} {:>10}  {:>10} {:>10}  {:>10} {:>10}  {:>10} {:>14}\n",
        "", "width", "", "vertex", "span", "face", "span", "", ""
    );
    let _ = writeln!(
        out,
        "{:name$}  {:>10} {:>10}  {:>10} {:>10}  {:>10} {:>10}  {:>10} {:>14}",
        "order", "largest", "mean", "largest", "mean", "largest", "mean", "bandwidth", "profile"
    );
    for Compared { order, measures: m } in orders {
        let _ = writeln!(
            out,
            "{order:name$}  {:>10} {:>10.1}  {:>10} {:>10.1}  {:>10} {:>10.1}  {:>10} {:>14}",
            m.largest_width,
            m.mean_width,
            m.largest_vertex_span,
            m.mean_vertex_span,
            m.largest_face_span,
            m.mean_face_span,
            m.bandwidth,
            m.profile
        );
    }
    out
}
