//! A front from many sources in shares, which several processes compute over one work directory.
//!
//! Nodes near each other in number are near each other on the surface, so a share is a range of numbers. What it needs of
//! the rest is found out, not guessed. Nodes outside are taken to be as near to an unknown source as can be: at distance 0.
//! A front over the share from its own sources and from there labels each node by a source of its own or by the place that the
//! unknown one came in. Where a source of its own is strictly nearer, distance and label are those of one front over
//! everything, ties included: no path through the outside is as short. The places that came in are then taken
//! into the region, and what they had labelled is labelled anew, until no node of the share is labelled by them. Places are runs of as many
//! nodes as a source has on average. In a mesh in rows such a run is a piece of one row, so each time twice as many are taken, one beside
//! the other.
//!
//! A share is an array of its own with its checksum beside it, written under other names and renamed. The process that goes
//! on takes a division that is whole, in any number of shares, or else runs the front itself: the result is the same to the bit (tested).
//!
//! Cost: the share's part of the front, and that of a rim about three times the width of a source's nodes; 8 bytes per node of the
//! *whole* graph in files while it runs, of which only the region's are touched, and 8 bytes per node of the share that are kept.

use super::voronoi::{self, BlockDijkstra, Message};
use crate::base::{Error, Result};
use crate::graph::Csr;
use crate::store::manifest::FileRecord;
use crate::store::stage::key_of;
use crate::store::{Context, MappedSlice, Run, WorkDir};
use serde::{Deserialize, Serialize};
use serde_json::json;
use std::ops::Range;
use xxhash_rust::xxh3::xxh3_64;

/// Version of what a share holds.
const VERSION: u32 = 1;

/// A front from many sources that processes can share out.
#[derive(Clone, Copy, Debug)]
pub struct SharedFront<'a> {
    /// Name of its files, without ending.
    pub name: &'a str,
    /// The stage that progress is told for.
    pub stage: &'a str,
    /// The graph, whose steps are as long in both directions.
    pub graph: Csr<'a>,
    /// The key of the stage that made the graph.
    pub key: &'a str,
    /// The sources, at least one.
    pub sources: &'a [u32],
}

/// What is written beside a share when it is whole.
#[derive(Debug, Serialize, Deserialize)]
struct ShareRecord {
    front: String,
    file: FileRecord,
}

impl SharedFront<'_> {
    /// Nodes in a run that comes into a region as a whole.
    fn grain(&self) -> usize {
        self.graph.len().div_ceil(self.sources.len().max(1)).max(1)
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

    /// What identifies the front, in whatever shares.
    fn identity(&self) -> String {
        let sources = xxh3_64(bytemuck::cast_slice(self.sources));
        key_of("shared front", VERSION, &json!({"graph": self.key, "sources": format!("{sources:016x}")}))
    }

    /// What [`voronoi::nearest_source`] gives: from the shares in the work directory, where those of a division are all there, else by
    /// running the front. The shares are removed.
    ///
    /// # Errors
    /// [`Error::Io`], [`Error::Cancelled`].
    pub fn nearest_source(&self, field: &mut [f32], label: &mut [u32], context: Context<'_>) -> Result<()> {
        let found = if context.work.is_temporary() { Vec::new() } else { self.divisions(context.work)? };
        let whole = found.iter().find_map(|&of| {
            let shares: Option<Vec<_>> = (0..of).map(|shard| self.finished(shard, of, context.work)).collect();
            Some((of, shares?))
        });
        match whole {
            Some((of, shares)) => {
                for (shard, share) in shares.iter().enumerate() {
                    let own = self.own(shard, of);
                    let (labels, distances) = share.split_at(own.len());
                    label[own.clone()].copy_from_slice(labels);
                    field[own].iter_mut().zip(distances).for_each(|(d, bits)| *d = f32::from_bits(*bits));
                }
                context.run.progress.note(&format!("{}: put together from {of} shares", self.name));
            }
            None => {
                if let Some(of) = found.first() {
                    let problem = format!("not all {of} shares are there, whole and of these options");
                    context.run.progress.note(&format!("{}: {problem}; computed without them", self.name));
                }
                voronoi::nearest_source(self.graph, self.sources, field, label, context.run)?;
            }
        }
        for of in found {
            for shard in 0..of {
                ["json", "npy"].iter().for_each(|end| context.work.remove(&format!("{}.{end}", self.stem(shard, of))));
            }
        }
        Ok(())
    }

    /// Into how many shares the front was divided, as far as files tell.
    fn divisions(&self, work: &WorkDir) -> Result<Vec<usize>> {
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

    /// The name of a share's files, without ending.
    fn stem(&self, shard: usize, of: usize) -> String {
        format!("{}-{shard}-of-{of}", self.name)
    }

    /// A share that is finished and of this front: labels of its nodes, then the bits of their distances.
    fn finished(&self, shard: usize, of: usize, work: &WorkDir) -> Option<MappedSlice<u32>> {
        let (stem, own) = (self.stem(shard, of), self.own(shard, of));
        let record: ShareRecord = work.read_json(&format!("{stem}.json")).ok()?;
        let array = format!("{stem}.npy");
        if record.front != self.identity() || work.unharmed(&array, &record.file).is_err() {
            return None;
        }
        let share = work.open_array::<u32>(&array).ok().filter(|share| share.len() == 2 * own.len())?;
        let known = |label: &u32| *label == u32::MAX || (*label as usize) < self.sources.len();
        share[..own.len()].iter().all(known).then_some(share)
    }

    /// Computes share `shard` of `of`, or finds it done; how many nodes it has.
    ///
    /// # Errors
    /// [`Error::Parameter`] for a share that does not exist, [`Error::Io`], [`Error::Cancelled`].
    pub fn share(&self, (shard, of): (usize, usize), context: Context<'_>) -> Result<usize> {
        if shard >= of || of > self.grains() {
            let problem = format!("{shard}/{of} is no share of {} runs of faces", self.grains());
            return Err(Error::parameter("--shard", problem, "count shares from 0, and make fewer"));
        }
        let Context { work, run } = context;
        let (own, stem) = (self.own(shard, of), self.stem(shard, of));
        if self.finished(shard, of, work).is_some() {
            run.progress.note(&format!("{}: shard {shard}/{of} is done already", self.name));
            return Ok(own.len());
        }
        let make = || {
            let n = self.graph.len();
            let names = ["distances.tmp", "labels.tmp"].map(|end| format!("{stem}.{end}"));
            let mut share = work.array::<u32>(&format!("{stem}.npy"), &[2, own.len()])?;
            {
                // Zero outside of the region: nearer than any path, and of the unknown source.
                let mut field = work.array::<f32>(&names[0], &[n])?;
                let mut label = work.array::<u32>(&names[1], &[n])?;
                self.compute(own.clone(), field.data(), label.data(), run)?;
                let (labels, distances) = share.data().split_at_mut(own.len());
                let first = self.grains() as u32;
                // Of a damaged graph, nodes may end up without a source.
                let known = |label: &u32| if *label == u32::MAX { *label } else { label.wrapping_sub(first) };
                labels.iter_mut().zip(&label.data()[own.clone()]).for_each(|(to, label)| *to = known(label));
                distances.iter_mut().zip(&field.data()[own.clone()]).for_each(|(to, d)| *to = d.to_bits());
            }
            names.iter().for_each(|name| work.remove(&format!("{name}.partial")));
            share.finish(false)?;
            let file = work.sealed(&format!("{stem}.npy"))?;
            work.write_json(&format!("{stem}.json"), &ShareRecord { front: self.identity(), file })
        };
        run.stage(self.stage, "faces", own.len() as u64, make)?;
        Ok(own.len())
    }

    /// The front as far as the nodes `own` need it. Both arrays (n) are 0 before. Then the label of source k is k + the
    /// number of grains; that of the unknown source is the grain that it came from.
    fn compute(&self, own: Range<usize>, field: &mut [f32], label: &mut [u32], run: &Run) -> Result<()> {
        let (grain, grains) = (self.grain(), self.grains() as u32);
        let mut inside = vec![false; grains as usize];
        inside[own.start / grain..own.end.div_ceil(grain)].fill(true);
        let front = BlockDijkstra::within_budget(self.graph, run);
        let mut stale = false;
        let (mut grown, mut layers) = (true, 1);
        while grown {
            run.fill_two(
                (&mut *field, &mut *label),
                grain,
                || (),
                |k, field, label, ()| {
                    for (d, label) in
                        field.iter_mut().zip(label).filter(|(_, label)| inside[k] && !is_known(**label, grains))
                    {
                        (*d, *label) = (f32::INFINITY, u32::MAX);
                    }
                    Ok(())
                },
            )?;
            let messages = self.messages(&inside, field, label, run)?;
            stale |= front.propagate(messages, f32::INFINITY, field, label)?;
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
            // Once more over the final distances, as in `BlockDijkstra::nearest_source`: no known label was too large.
            run.fill_chunks(
                label,
                grain,
                || (),
                |k, label, ()| {
                    if inside[k] {
                        label.fill(u32::MAX);
                    }
                    Ok(())
                },
            )?;
            let messages = self.messages(&inside, field, label, run)?;
            front.propagate(messages, f32::INFINITY, field, label)?;
        }
        Ok(())
    }

    /// Takes the grains beside those of `rim` into the region; which these are.
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

    /// What comes to the nodes `inside` that have no label: from sources, from beside them, from outside.
    fn messages(&self, inside: &[bool], field: &[f32], label: &[u32], run: &Run) -> Result<Vec<Message<u32>>> {
        let grain = self.grain();
        let entering = run.map_ranges(label.len(), grain, |range| {
            let mut messages = Vec::new();
            if !inside[range.start / grain] {
                return Ok(messages);
            }
            for node in range.filter(|&node| label[node] == u32::MAX) {
                for (from, weight) in self.graph.neighbours(node as u32) {
                    let (from, node) = (from as usize, node as u32);
                    if !inside[from / grain] {
                        messages.push(Message { node, distance: weight, label: (from / grain) as u32 });
                    } else if label[from] != u32::MAX {
                        messages.push(Message { node, distance: field[from] + weight, label: label[from] });
                    }
                }
            }
            Ok(messages)
        })?;
        let mut messages = entering.concat();
        let first = self.grains() as u32;
        for (&node, k) in self.sources.iter().zip(first..) {
            if inside[node as usize / grain] && label[node as usize] == u32::MAX {
                messages.push(Message { node, distance: 0., label: k });
            }
        }
        Ok(messages)
    }
}

/// Whether `label` is that of a source inside of the region.
fn is_known(label: u32, grains: u32) -> bool {
    label >= grains && label != u32::MAX
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::{below, stream};
    use crate::graph::OwnedRowStarts;

    #[test]
    fn shares_are_the_front_over_everything() {
        // A grid whose steps are few different lengths: paths tie everywhere.
        let (w, h) = (60usize, 70usize);
        let n = w * h;
        let mut random = stream(7, "lengths");
        let step: Vec<[f32; 2]> =
            (0..n).map(|_| [(); 2].map(|()| [0.25, 0.5, 0.1, 3.][below(&mut random, 4)])).collect();
        let (mut degrees, mut indices, mut weights) = (Vec::new(), Vec::new(), Vec::new());
        for i in 0..n {
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
        let starts = OwnedRowStarts::of(degrees);
        let graph = Csr::new(starts.view(), &indices, &weights);
        let run = Run::new(&());
        for sources in [1usize, 3, 40, 400] {
            let mut sources: Vec<u32> = (0..sources).map(|_| below(&mut random, n) as u32).collect();
            sources.sort_unstable();
            let front = SharedFront { name: "front", stage: "front", graph, key: "key", sources: &sources };
            let (mut field, mut label) = (vec![0f32; n], vec![0u32; n]);
            voronoi::nearest_source(graph, &sources, &mut field, &mut label, &run).unwrap();
            for of in [1, 2, 3, 5].into_iter().filter(|of| *of <= front.grains()) {
                let folder = tempfile::tempdir().unwrap();
                let work = WorkDir::open(folder.path()).unwrap();
                let context = Context::new(&work, &run);
                for shard in (0..of).rev() {
                    assert_eq!(front.share((shard, of), context).unwrap(), front.own(shard, of).len());
                }
                assert!(front.share((of, of), context).is_err() && front.share((0, n + 1), context).is_err());
                let whole = (0..of).all(|shard| front.finished(shard, of, &work).is_some());
                let other = SharedFront { key: "other", ..front };
                assert!(whole && other.finished(0, of, &work).is_none());
                let (mut distances, mut labels) = (vec![0f32; n], vec![0u32; n]);
                front.nearest_source(&mut distances, &mut labels, context).unwrap();
                assert!(distances == field && labels == label, "{} sources, {of} shares", sources.len());
                assert!(front.divisions(&work).unwrap().is_empty());
            }
        }
    }
}
