//! A front from many sources, divided into shares that several processes compute over one work directory.
//!
//! A share is a range of node numbers: nodes close in number are close on the surface. A share also depends on nodes
//! outside it, and which ones is determined as follows. All nodes outside start at distance 0, as if an unknown source
//! were there: no true distance is less. A front from there and from the share's own sources labels each node with one
//! of its own sources, or with the place where the path entered from outside. If an own source is strictly nearer,
//! distance and label are those of one front over everything, ties included, because no path through the outside is
//! shorter. The places where paths entered are then added to the region, and the nodes labelled by them are labelled
//! again, until none of them labels a node of the share. Nodes that neither a source nor the outside reaches are
//! unreachable. A place is a run of about as many nodes as a source has on average. If the faces of a mesh are ordered
//! in rows, such a run is a piece of one row, so each round adds twice as many layers of adjacent runs.
//!
//! A share is an array with its checksum in a separate file; both are written under temporary names and renamed. The
//! process that continues uses any complete division, whatever its number of shares, or else runs the front itself: the
//! result is the same to the bit (tested).
//!
//! Cost: the share's part of the front, plus that of a rim about three times as wide as the region of a source. On
//! disk, 8 bytes per node of the *whole* graph while it runs, of which only those of the region are touched; 8 bytes
//! per node of the share are kept.

use super::block_front::{Initial, Message, VisitedPieces};
use super::voronoi::{self, BlockDijkstra};
use crate::base::printable::counted;
use crate::base::{Error, Result};
use crate::graph::Csr;
use crate::store::manifest::{FileRecord, checksum_of};
use crate::store::stage::key_of;
use crate::store::{Context, MappedSlice, Run, WorkDir};
use serde::{Deserialize, Serialize};
use serde_json::json;
use std::ops::Range;

/// Version of the content of a share.
const VERSION: u32 = 2;
/// Minimum and maximum length of a run of nodes.
const GRAINS: [usize; 2] = [64, 1 << 16];

/// A front from many sources that processes can share out.
#[derive(Clone, Copy, Debug)]
pub struct SharedFront<'a> {
    /// Name of its files, without extension.
    pub name: &'a str,
    /// The stage for which progress is reported.
    pub stage: &'a str,
    /// The graph; its weights must be symmetric.
    pub graph: Csr<'a>,
    /// The key of the stage that made the graph.
    pub key: &'a str,
    /// The sources, at least one.
    pub sources: &'a [u32],
    /// Their labels; by default the label of a source is its index.
    pub labels: Option<&'a [u32]>,
    /// Nodes at this distance or beyond are not visited.
    pub limit: f32,
}

/// The labels of nodes that a front does not enter, which are at distance 0; the sources are among them.
pub type Fixed<'a> = dyn Fn(usize) -> Option<u32> + Sync + 'a;

/// All shares of a front.
#[derive(Debug)]
pub struct Shares {
    /// The first node of each share, followed by the number of nodes.
    bounds: Vec<usize>,
    /// For each share its labels, then the bits of its distances.
    shares: Vec<MappedSlice<u32>>,
}

impl Shares {
    /// The distance of `node`; infinite if the front did not reach it.
    pub fn distance(&self, node: usize) -> f32 {
        let shard = self.bounds.partition_point(|first| *first <= node) - 1;
        let share = &self.shares[shard];
        f32::from_bits(share[share.len() / 2 + node - self.bounds[shard]])
    }

    /// Each share's nodes, their labels and the bits of their distances.
    fn each(&self) -> impl Iterator<Item = (Range<usize>, &[u32], &[u32])> {
        self.bounds.windows(2).zip(&self.shares).map(|(own, share)| {
            let (labels, distances) = share.split_at(share.len() / 2);
            (own[0]..own[1], labels, distances)
        })
    }
}

/// Written beside a complete share.
#[derive(Debug, Serialize, Deserialize)]
struct ShareRecord {
    front: String,
    file: FileRecord,
}

impl SharedFront<'_> {
    /// Number of nodes in a run, which is added to a region as a whole: a power of two, for fast division.
    fn grain(&self) -> usize {
        self.graph.len().div_ceil(self.sources.len().clamp(GRAINS[0], GRAINS[1])).next_power_of_two()
    }

    /// Number of such runs.
    fn grains(&self) -> usize {
        self.graph.len().div_ceil(self.grain())
    }

    /// The nodes of share `shard` of `of`.
    fn own(&self, shard: usize, of: usize) -> Range<usize> {
        let bound = |k: usize| (self.grains() * k / of * self.grain()).min(self.graph.len());
        bound(shard)..bound(shard + 1)
    }

    /// A hash that identifies the front, independent of the division; its fixed nodes are not in it.
    fn identity(&self) -> String {
        let hash = |numbers: &[u32]| checksum_of(bytemuck::cast_slice(numbers));
        let (sources, labels, limit) = (hash(self.sources), self.labels.map(hash), self.limit.to_bits());
        let inputs = json!({"graph": self.key, "sources": sources, "labels": labels, "limit": limit});
        key_of("shared front", VERSION, &inputs)
    }

    /// The result of [`voronoi::nearest_source`]: from the shares in the work directory if a division is complete
    /// there, else by running the front. The shares are removed.
    ///
    /// # Errors
    /// [`Error::Io`], [`Error::Cancelled`].
    pub fn nearest_source(&self, field: &mut [f32], label: &mut [u32], context: Context<'_>) -> Result<()> {
        match self.found(|_| true, context)? {
            Some(shares) => {
                for (own, labels, distances) in shares.each() {
                    label[own.clone()].copy_from_slice(labels);
                    field[own].iter_mut().zip(distances).for_each(|(d, bits)| *d = f32::from_bits(*bits));
                }
            }
            None => voronoi::nearest_source(self.graph, self.sources, field, label, context.run)?,
        }
        self.discard(context.work)
    }

    /// The same for [`voronoi::within_fresh`].
    ///
    /// # Errors
    /// As [`SharedFront::nearest_source`].
    pub fn within_fresh(&self, field: &mut [f32], context: Context<'_>) -> Result<VisitedPieces> {
        let visited = match self.found(|_| true, context)? {
            Some(shares) => {
                for (own, _, distances) in shares.each() {
                    field[own].iter_mut().zip(distances).for_each(|(d, bits)| *d = f32::from_bits(*bits));
                }
                VisitedPieces::everything(field.len())
            }
            None => voronoi::within_fresh(self.graph, self.sources, self.limit, field, context.run)?,
        };
        self.discard(context.work)?;
        Ok(visited)
    }

    /// The same for [`voronoi::propagate_labels`]; `label` holds the labels of the sources too. Shares that were made
    /// with other fixed nodes are not used.
    ///
    /// # Errors
    /// As [`SharedFront::nearest_source`].
    pub fn propagate_labels(&self, field: &mut [f32], label: &mut [u32], context: Context<'_>) -> Result<()> {
        // All steps are longer than 0, so only fixed nodes are at distance 0.
        let is_same = |(node, (new, bits)): (usize, (&u32, &u32))| match field[node] == 0. {
            true => *bits == 0 && *new == label[node],
            false => *bits != 0,
        };
        let fits = |shares: &Shares| {
            shares.each().all(|(own, labels, distances)| own.zip(labels.iter().zip(distances)).all(is_same))
        };
        match self.found(fits, context)? {
            Some(shares) => {
                for (own, labels, distances) in shares.each() {
                    for (node, (new, bits)) in own.zip(labels.iter().zip(distances)) {
                        if *new != u32::MAX {
                            (label[node], field[node]) = (*new, f32::from_bits(*bits));
                        }
                    }
                }
            }
            None => voronoi::propagate_labels(self.graph, self.sources, field, label, context.run)?,
        }
        self.discard(context.work)
    }

    /// All shares of a division, if one is complete.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn shares(&self, work: &WorkDir) -> Result<Option<Shares>> {
        let whole = |of: usize| {
            let shares = (0..of).map(|shard| self.finished(shard, of, work)).collect::<Option<_>>()?;
            let bounds = (0..of).map(|shard| self.own(shard, of).start).chain([self.graph.len()]).collect();
            Some(Shares { bounds, shares })
        };
        Ok(self.divisions(work)?.into_iter().find_map(whole))
    }

    /// The same if they are as `fits` wants them, with a progress report.
    fn found(&self, fits: impl Fn(&Shares) -> bool, context: Context<'_>) -> Result<Option<Shares>> {
        let Context { work, run } = context;
        let found = self.shares(work)?.filter(fits);
        if let Some(Shares { shares, .. }) = &found {
            run.progress.note_of_work(&format!("{}: combined from {}", self.name, counted(shares.len(), "share")));
        } else if let Some(of) = self.divisions(work)?.first() {
            let problem = format!("not all {of} shares are present, complete and made with these options");
            run.progress.note_of_work(&format!("{}: {problem}; computed without them", self.name));
        }
        Ok(found)
    }

    /// Removes all shares.
    fn discard(&self, work: &WorkDir) -> Result<()> {
        for of in self.divisions(work)? {
            for shard in 0..of {
                ["json", "npy"].iter().for_each(|end| work.remove(&format!("{}.{end}", self.stem(shard, of))));
            }
        }
        Ok(())
    }

    /// The numbers of shares of the divisions for which there are files.
    fn divisions(&self, work: &WorkDir) -> Result<Vec<usize>> {
        if work.is_temporary() {
            return Ok(Vec::new());
        }
        let entries = std::fs::read_dir(work.path()).map_err(Error::io(work.path(), "list"))?;
        let of = |name: &str| {
            let (shard, of) =
                name.strip_prefix(self.name)?.strip_prefix('-')?.strip_suffix(".json")?.split_once("-of-")?;
            let (shard, of): (usize, usize) = (shard.parse().ok()?, of.parse().ok()?);
            (shard < of && of <= self.grains()).then_some(of)
        };
        let mut found: Vec<usize> =
            entries.flatten().filter_map(|entry| of(&entry.file_name().to_string_lossy())).collect();
        found.sort_unstable();
        found.dedup();
        Ok(found)
    }

    /// The name of a share's files, without extension.
    fn stem(&self, shard: usize, of: usize) -> String {
        format!("{}-{shard}-of-{of}", self.name)
    }

    /// A finished share of this front: labels of its nodes, then the bits of their distances.
    fn finished(&self, shard: usize, of: usize, work: &WorkDir) -> Option<MappedSlice<u32>> {
        let (stem, own) = (self.stem(shard, of), self.own(shard, of));
        let record: ShareRecord = work.read_json(&format!("{stem}.json")).ok()?;
        let array = format!("{stem}.npy");
        if record.front != self.identity() || work.integrity_error(&array, &record.file).is_some() {
            return None;
        }
        let share = work.open_array::<u32>(&array).ok().filter(|share| share.len() == 2 * own.len())?;
        let most =
            self.labels.map_or(self.sources.len() as u32 - 1, |labels| labels.iter().copied().max().unwrap_or(0));
        let known = |label: &u32| *label == u32::MAX || *label <= most;
        share[..own.len()].iter().all(known).then_some(share)
    }

    /// Computes share `shard` of `of`, or finds it finished; returns its number of nodes. The front does not enter
    /// nodes that are `fixed`.
    ///
    /// # Errors
    /// [`Error::Parameter`] for a share that does not exist, [`Error::Io`], [`Error::Cancelled`].
    pub fn share(&self, (shard, of): (usize, usize), fixed: &Fixed<'_>, context: Context<'_>) -> Result<usize> {
        if shard >= of || of > self.grains() {
            let problem = format!("{shard}/{of} is not a share of {} runs of faces", self.grains());
            return Err(Error::parameter("shard", problem, "count shares from 0, and use fewer"));
        }
        let Context { work, run } = context;
        let (own, stem) = (self.own(shard, of), self.stem(shard, of));
        if self.finished(shard, of, work).is_some() {
            run.progress.note_of_work(&format!("{}: shard {shard}/{of} is already done", self.name));
            return Ok(own.len());
        }
        let make = || {
            let n = self.graph.len();
            let names = ["distances.tmp", "labels.tmp"].map(|end| format!("{stem}.{end}"));
            let mut share = work.array::<u32>(&format!("{stem}.npy"), &[2, own.len()])?;
            {
                // Zero outside the region: nearer than any path, from the unknown source.
                let mut field = work.array::<f32>(&names[0], &[n])?;
                let mut label = work.array::<u32>(&names[1], &[n])?;
                self.compute(own.clone(), fixed, (field.data(), label.data()), run)?;
                let (labels, distances) = share.data().split_at_mut(own.len());
                let first = self.grains() as u32;
                // Nodes that the front does not reach have no label.
                let known = |label: &u32| if *label == u32::MAX { *label } else { label.wrapping_sub(first) };
                labels.iter_mut().zip(&label.data()[own.clone()]).for_each(|(to, label)| *to = known(label));
                distances.iter_mut().zip(&field.data()[own.clone()]).for_each(|(to, d)| *to = d.to_bits());
            }
            share.finish(false)?;
            let file = work.file_record(&format!("{stem}.npy"))?;
            work.write_json(&format!("{stem}.json"), &ShareRecord { front: self.identity(), file })
        };
        run.stage(self.stage, "faces", own.len() as u64, make)?;
        Ok(own.len())
    }

    /// Runs the front as far as the nodes `own` need it. Both arrays (n) must be 0. Afterwards, labels of sources are
    /// offset by the number of grains; a smaller label is the grain where the path entered from outside.
    fn compute(
        &self,
        own: Range<usize>,
        fixed: &Fixed<'_>,
        (field, label): (&mut [f32], &mut [u32]),
        run: &Run,
    ) -> Result<()> {
        let (grain, grains) = (self.grain(), self.grains() as u32);
        let mut inside = vec![false; grains as usize];
        inside[own.start / grain..own.end.div_ceil(grain)].fill(true);
        let front = BlockDijkstra::within_budget(self.graph, run);
        // Clears the nodes inside that no known source has labelled; returns which grains have some.
        let clear = |inside: &[bool], field: &mut [f32], label: &mut [u32]| {
            let clear = |k: usize, field: &mut [f32], label: &mut [u32], (): &mut ()| {
                let mut any = false;
                if !inside[k] {
                    // Left untouched: these pages do not exist yet.
                    return Ok(any);
                }
                for (node, (d, label)) in (k * grain..).zip(field.iter_mut().zip(label)) {
                    if *label < grains {
                        (*d, *label) = fixed(node).map_or((f32::INFINITY, u32::MAX), |own| (0., own + grains));
                        any = true;
                    }
                }
                Ok(any)
            };
            run.fill_two((field, label), grain, || (), clear)
        };
        let mut stale = false;
        let (mut grown, mut layers) = (true, 1);
        while grown {
            let cleared = clear(&inside, field, label)?;
            let messages = self.messages((&inside, &cleared), field, label, run)?;
            stale |= !front.propagate(messages, self.limit, Initial::Given, field, label)?.is_empty();
            let mut rim = Vec::new();
            for &label in label[own.clone()].iter().filter(|label| **label < grains) {
                if !std::mem::replace(&mut inside[label as usize], true) {
                    rim.push(label as usize);
                }
            }
            grown = !rim.is_empty();
            for _ in 1..layers {
                rim = self.around(&rim, &mut inside);
            }
            layers *= 2;
        }
        if stale {
            // Labels once more over the final distances, as in `BlockDijkstra::nearest_source`: no known label was too
            // large.
            let relabel = |k: usize, label: &mut [u32], (): &mut ()| {
                if inside[k] {
                    let own = |node: usize| fixed(node).map_or(u32::MAX, |own| own + grains);
                    (k * grain..).zip(label).for_each(|(node, label)| *label = own(node));
                }
                Ok(())
            };
            run.fill_chunks(label, grain, || (), relabel)?;
            let messages = self.messages((&inside, &inside), field, label, run)?;
            front.propagate(messages, self.limit, Initial::Given, field, label)?;
        }
        Ok(())
    }

    /// Adds the grains adjacent to those of `rim` to the region; returns the new ones.
    fn around(&self, rim: &[usize], inside: &mut [bool]) -> Vec<usize> {
        let grain = self.grain();
        let mut found = Vec::new();
        for &k in rim {
            for node in k * grain..((k + 1) * grain).min(self.graph.len()) {
                for (to, _) in self.graph.neighbours(node as u32) {
                    let to = to as usize / grain;
                    if !std::mem::replace(&mut inside[to], true) {
                        found.push(to);
                    }
                }
            }
        }
        found
    }

    /// The messages to unlabelled nodes in the `cleared` grains inside: from sources, from neighbours inside, from
    /// outside.
    fn messages(
        &self,
        (inside, cleared): (&[bool], &[bool]),
        field: &[f32],
        label: &[u32],
        run: &Run,
    ) -> Result<Vec<Message<u32>>> {
        let grain = self.grain();
        let shift = grain.trailing_zeros();
        let entering = run.map_ranges(label.len(), grain, |range| {
            let mut messages = Vec::new();
            if !cleared[range.start / grain] {
                return Ok(messages);
            }
            for node in range.filter(|&node| label[node] == u32::MAX) {
                for (from, weight) in self.graph.neighbours(node as u32) {
                    let (from, node) = (from as usize, node as u32);
                    let (distance, label) = match inside[from >> shift] {
                        false => (weight, (from >> shift) as u32),
                        true => (field[from] + weight, label[from]),
                    };
                    if label != u32::MAX && distance < self.limit {
                        messages.push(Message { node, distance, label });
                    }
                }
            }
            Ok(messages)
        })?;
        let mut messages = entering.concat();
        let first = self.grains() as u32;
        for (k, &node) in self.sources.iter().enumerate() {
            if cleared[node as usize / grain] && label[node as usize] == u32::MAX {
                let label = first + self.labels.map_or(k as u32, |labels| labels[k]);
                messages.push(Message { node, distance: 0., label });
            }
        }
        Ok(messages)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::{Random, below, stream};
    use crate::graph::OwnedRowStarts;

    /// A grid with few different edge lengths: paths tie everywhere.
    const WIDTH: usize = 60;
    const HEIGHT: usize = 70;

    fn grid(random: &mut Random) -> (OwnedRowStarts, Vec<u32>, Vec<f32>) {
        let (w, h) = (WIDTH, HEIGHT);
        let step: Vec<[f32; 2]> =
            (0..w * h).map(|_| [(); 2].map(|()| [0.25, 0.5, 0.1, 3.][below(random, 4)])).collect();
        let (mut degrees, mut indices, mut weights) = (Vec::new(), Vec::new(), Vec::new());
        for i in 0..w * h {
            let (x, y) = (i % w, i / w);
            let around = [
                (y > 0).then(|| (i - w, step[i - w][1])),
                (x > 0).then(|| (i - 1, step[i - 1][0])),
                (x + 1 < w).then(|| (i + 1, step[i][0])),
                (y + 1 < h).then(|| (i + w, step[i][1])),
            ];
            let before = indices.len();
            for (to, length) in around.into_iter().flatten() {
                indices.push(to as u32);
                weights.push(length);
            }
            degrees.push(indices.len() - before);
        }
        (OwnedRowStarts::of(degrees), indices, weights)
    }

    /// Computes `front` in shares, and combines them by `take`.
    fn in_shares(front: &SharedFront<'_>, of: usize, fixed: &Fixed<'_>, take: impl FnOnce(Context<'_>)) {
        let folder = tempfile::tempdir().unwrap();
        let (work, run) = (WorkDir::open(folder.path()).unwrap(), Run::new(&()));
        let context = Context::new(&work, &run);
        assert!(front.shares(&work).unwrap().is_none());
        for shard in (0..of).rev() {
            assert_eq!(front.share((shard, of), fixed, context).unwrap(), front.own(shard, of).len());
        }
        for none in [(of, of), (0, front.graph.len() + 1)] {
            assert!(front.share(none, fixed, context).is_err());
        }
        let other = SharedFront { key: "other", ..*front };
        assert!(front.shares(&work).unwrap().is_some() && other.shares(&work).unwrap().is_none());
        take(context);
        assert!(front.divisions(&work).unwrap().is_empty());
    }

    #[test]
    fn shares_are_the_front_over_everything() {
        let mut random = stream(7, "lengths");
        let (starts, indices, weights) = grid(&mut random);
        let graph = Csr::new(starts.view(), &indices, &weights);
        let (n, run) = (graph.len(), Run::new(&()));
        for count in [1usize, 3, 40, 400] {
            let mut sources: Vec<u32> = (0..count).map(|_| below(&mut random, n) as u32).collect();
            sources.sort_unstable();
            let infinite = f32::INFINITY;
            let front = SharedFront {
                name: "front",
                stage: "front",
                graph,
                key: "key",
                sources: &sources,
                labels: None,
                limit: infinite,
            };
            let (mut field, mut label) = (vec![0f32; n], vec![0u32; n]);
            voronoi::nearest_source(graph, &sources, &mut field, &mut label, &run).unwrap();
            let near = SharedFront { limit: 2.3, ..front };
            let mut depth = vec![infinite; n];
            voronoi::within(graph, &sources, near.limit, &mut depth, &run).unwrap();
            // A third of the grid, in stripes, is fixed.
            let fixed = |node: usize| (node % WIDTH % 15 < 5).then_some((node % WIDTH / 15 + node / WIDTH / 20) as u32);
            let start: Vec<f32> = (0..n).map(|node| fixed(node).map_or(infinite, |_| 0.)).collect();
            let named: Vec<u32> = (0..n).map(|node| fixed(node).unwrap_or(99)).collect();
            let beside = |node: &u32| graph.neighbours(*node).any(|(to, _)| start[to as usize] > 0.);
            let edge: Vec<u32> = (0..n as u32).filter(|node| start[*node as usize] == 0. && beside(node)).collect();
            let labels: Vec<u32> = edge.iter().map(|node| named[*node as usize]).collect();
            let band = SharedFront { sources: &edge, labels: Some(&labels), ..front };
            let (mut band_field, mut band_label) = (start.clone(), named.clone());
            voronoi::propagate_labels(graph, &edge, &mut band_field, &mut band_label, &run).unwrap();
            for of in [1, 2, 3, 5] {
                let (mut distances, mut found) = (vec![0f32; n], vec![0u32; n]);
                in_shares(&front, of, &|_| None, |context| {
                    front.nearest_source(&mut distances, &mut found, context).unwrap();
                });
                assert!(distances == field && found == label, "{count} sources, {of} shares");
                let mut distances = vec![0f32; n];
                in_shares(&near, of, &|_| None, |context| {
                    let shares = near.shares(context.work).unwrap().unwrap();
                    assert!((0..n).all(|node| shares.distance(node) == depth[node]), "{count} sources, {of} shares");
                    near.within_fresh(&mut distances, context).unwrap();
                });
                assert!(distances == depth, "{count} sources, {of} shares");
                let (mut distances, mut found) = (start.clone(), named.clone());
                in_shares(&band, of, &fixed, |context| {
                    band.propagate_labels(&mut distances, &mut found, context).unwrap();
                });
                assert!(distances == band_field && found == band_label, "{count} sources, {of} shares");
                // With another label where no source is: shares are not used that were made without it.
                let Some(inner) = (0..n).find(|node| start[*node] == 0. && !edge.contains(&(*node as u32))) else {
                    panic!("the stripes have no inside");
                };
                let (mut distances, mut found) = (start.clone(), named.clone());
                found[inner] = 77;
                in_shares(&band, of, &fixed, |context| {
                    band.propagate_labels(&mut distances, &mut found, context).unwrap();
                });
                assert!(distances == band_field && found[inner] == 77, "{count} sources, {of} shares");
            }
        }
    }
}
