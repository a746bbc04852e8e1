//! Measurements of parts as a table: comma-separated values with a header, one row per label.

use super::sums::Measures;
use crate::base::printable::Significant;
use crate::mesh::ply::labelled::colour_of;
use std::collections::BTreeMap;

/// The last columns of the table.
const LAST: [&str; 8] =
    ["spread1", "spread2", "spread3", "open_edges", "expected_agreement", "colour", "neighbours", "name"];

/// A field of the table; quoted if necessary.
fn quoted(word: &str) -> String {
    if word.contains([',', '"', '\n', '\r']) { format!("\"{}\"", word.replace('"', "\"\"")) } else { word.into() }
}

/// A field that holds a number; very large and very small ones have an exponent.
fn number(x: f64) -> String {
    Significant(x).to_string()
}

/// The table of `measures`, one row per distinct label, as comma-separated values with a header; parts may have
/// `names`, and an `agreement`: the share of people expected to have them.
pub fn table(measures: &BTreeMap<u32, Measures>, colours: &[[u8; 3]], names: &[String], agreement: &[f64]) -> String {
    let axes = ["x", "y", "z"];
    let three = |name: &str| axes.map(|axis| format!("{name}_{axis}"));
    let mut header = vec!["label".to_string(), "faces".into(), "area".into(), "volume".into()];
    header.extend(
        [three("min"), three("max"), three("centroid"), three("axis1"), three("axis2"), three("axis3")].concat(),
    );
    header.extend(LAST.map(String::from));
    let mut text = header.join(",") + "\n";
    for (&label, part) in measures {
        let mut row = vec![label.to_string(), part.faces.to_string(), number(part.area)];
        row.push(part.volume.map_or(String::new(), number));
        let bounds = part.bounds.map_or([const { None }; 6], |[low, high]| {
            let mut all = [None; 6];
            (0..3).for_each(|k| (all[k], all[k + 3]) = (Some(low[k]), Some(high[k])));
            all
        });
        row.extend(bounds.map(|x| x.map_or(String::new(), number)));
        row.extend(part.centroid.iter().chain(part.axes.iter().flatten()).chain(&part.spread).map(|x| number(*x)));
        row.push(part.open_edges.to_string());
        let place = label as usize;
        row.push(agreement.get(place).map_or(String::new(), |share| format!("{share:.3}")));
        let [r, g, b] = colour_of(colours, label);
        row.push(format!("#{r:02x}{g:02x}{b:02x}"));
        row.push(part.neighbours.iter().map(|other| other.label.to_string()).collect::<Vec<_>>().join(" "));
        row.push(names.get(place).map_or(String::new(), |name| quoted(name)));
        text += &(row.join(",") + "\n");
    }
    text
}
