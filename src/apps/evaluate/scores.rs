//! All metrics of a pair of labellings, of one against many, and of people against each other.

use super::contingency::{Contingency, Numbering, check_count, count};
use super::cuts::{Cut, discrepancy};
use super::regions::{consistency, hamming, rand, rand_area};
use super::surface::Surface;
use crate::base::{Error, Result};
use crate::mesh::Mesh;
use serde::Serialize;

/// The metrics of labels against a truth; 0 is equal, lower is better, all but the cut
/// discrepancy below 1.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Scores {
    /// 1 − Rand index over pairs of faces.
    pub rand: f64,
    /// 1 − Rand index, pairs weighted by their areas.
    pub rand_area: f64,
    /// Sum of the two mean distances between cuts over the mean radius; `None` without a mesh, or
    /// where only one of the two has cuts. In a mean: over the pairs that have one.
    pub cut_discrepancy: Option<f64>,
    /// Mean of `missing` and `false_alarm`.
    pub hamming: f64,
    /// Share of the area that lies outside the best-covering part of its truth part.
    pub missing: f64,
    /// Share of the area that lies outside the best-covering truth part of its part.
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

    /// The mean of each metric; `None` of nothing.
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

    /// The same pair judged the other way round.
    pub fn reversed(self) -> Self {
        Self { missing: self.false_alarm, false_alarm: self.missing, ..self }
    }
}

/// A labelling made ready for comparisons: parts numbered, distances to its cuts known.
#[derive(Clone, Debug)]
pub struct Segmentation<'a> {
    labels: &'a [u32],
    numbering: Numbering,
    cut: Option<Cut>,
}

impl Segmentation<'_> {
    /// Number of parts: labels that occur.
    pub fn parts(&self) -> usize {
        self.numbering.len()
    }
}

impl Surface {
    /// Makes labels ready; `name` is what an error calls them.
    ///
    /// # Errors
    /// [`Error::Parameter`] where they are not one a face.
    pub fn segmentation<'a>(&self, name: &str, labels: &'a [u32]) -> Result<Segmentation<'a>> {
        check_count(name, labels.len(), self.faces)?;
        let cut = self.edges.as_ref().map(|edges| Cut::of(edges, labels));
        Ok(Segmentation { labels, numbering: Numbering::of(labels), cut })
    }

    /// Makes several people's labels ready; errors call them "truth 1" and so on.
    ///
    /// # Errors
    /// As [`Surface::segmentation`].
    pub fn segmentations<'a, L: AsRef<[u32]>>(&self, truths: &'a [L]) -> Result<Vec<Segmentation<'a>>> {
        (1..).zip(truths).map(|(k, labels)| self.segmentation(&format!("truth {k}"), labels.as_ref())).collect()
    }

    /// The overlaps of two labellings of this surface.
    pub fn contingency(&self, labels: &Segmentation, truth: &Segmentation) -> Contingency {
        count((labels.labels, &labels.numbering), (truth.labels, &truth.numbering), self.areas.as_deref())
    }

    /// All metrics of a pair.
    pub fn compare(&self, labels: &Segmentation, truth: &Segmentation) -> Scores {
        let cuts = self.edges.as_ref().zip(labels.cut.as_ref()).zip(truth.cut.as_ref());
        let cut_discrepancy = cuts.and_then(|((edges, one), other)| discrepancy(edges, one, other));
        Scores { cut_discrepancy, ..Scores::of_table(&self.contingency(labels, truth)) }
    }

    /// Mean metrics of one labelling against several truths.
    ///
    /// # Errors
    /// [`Error::Parameter`] where there is no truth.
    pub fn compare_many(&self, labels: &Segmentation, truths: &[Segmentation]) -> Result<Scores> {
        let all: Vec<Scores> = truths.iter().map(|truth| self.compare(labels, truth)).collect();
        Scores::mean(&all).ok_or_else(|| Error::parameter("truth", "there is none", "give at least one labelling"))
    }

    /// Mean metrics of each person against the others, as if each in turn were judged.
    ///
    /// # Errors
    /// [`Error::Parameter`] where there are fewer than two.
    pub fn people(&self, truths: &[Segmentation]) -> Result<Scores> {
        let mut all = Vec::with_capacity(truths.len() * truths.len().saturating_sub(1));
        for (k, one) in truths.iter().enumerate() {
            for other in &truths[..k] {
                let scores = self.compare(one, other);
                all.extend([scores, scores.reversed()]);
            }
        }
        Scores::mean(&all).ok_or_else(|| {
            Error::parameter("truth", format!("{} to compare with each other", truths.len()), "give at least two")
        })
    }
}

/// All metrics of one pair of labellings; without a mesh every face weighs the same and there is
/// no cut discrepancy.
///
/// # Errors
/// [`Error::Parameter`] where labels, truth and faces differ in number.
pub fn compare(mesh: Option<&Mesh>, labels: &[u32], truth: &[u32]) -> Result<Scores> {
    let faces = mesh.map_or(truth.len(), |mesh| mesh.faces.len());
    check_count("labels", labels.len(), faces)?;
    check_count("truth", truth.len(), faces)?;
    let surface = mesh.map_or_else(|| Ok(Surface::of_faces(faces)), Surface::of)?;
    Ok(surface.compare(&surface.segmentation("labels", labels)?, &surface.segmentation("truth", truth)?))
}
