//! Boundaries between two parts, smoothed: a mix of two labels is two numbers.
//!
//! Around a boundary, the same two labels meet everywhere, but for the junctions of three parts. So a connected piece of
//! a band that touches two labels only takes a way of its own: the strengths of both are kept side by side, fixed nodes
//! are two more places, and a sweep is two multiplications a link without a branch. The numbers are those of
//! [`super::smooth`]'s general way to the bit (tested there). Cost: one union-find over the band; 60 bytes a node.

use super::smooth::Links;
use crate::base::Result;
use crate::base::parallel::{chunk_range, fill_chunks};
use crate::store::Run;

const CHUNK: usize = 1 << 12;
const NONE: u32 = u32::MAX;
/// Stands for three labels or more.
const MANY: [u32; 2] = [NONE - 1; 2];

/// The two labels that each place of a band can ever have, ascending.
pub(super) struct Pairs {
    of: Vec<[u32; 2]>,
}

impl Pairs {
    /// Of a band whose places have the labels `own`.
    pub fn of(links: &Links, own: &[u32]) -> Self {
        let mut parent: Vec<u32> = (0..own.len() as u32).collect();
        for b in 0..own.len() {
            let mut root = find(&mut parent, b as u32);
            for link in links.around(b).iter().filter(|link| link.inside && (link.to as usize) < b) {
                let other = find(&mut parent, link.to);
                parent[root.max(other) as usize] = root.min(other);
                root = root.min(other);
            }
        }
        let mut pair = vec![[NONE; 2]; own.len()];
        for (b, &label) in own.iter().enumerate() {
            let root = find(&mut parent, b as u32) as usize;
            let beside = links.around(b).iter().filter(|link| !link.inside).map(|link| link.to);
            pair[root] = beside.chain([label]).fold(pair[root], with);
        }
        Self { of: (0..own.len()).map(|b| pair[find(&mut parent, b as u32) as usize]).collect() }
    }

    /// Whether more than two labels may meet at a place.
    #[inline]
    pub fn is_junction(&self, place: usize) -> bool {
        self.of[place] == MANY
    }

    /// Whether that is so anywhere.
    pub fn have_junctions(&self) -> bool {
        self.of.contains(&MANY)
    }

    /// The stronger label of each place after `sweeps` sweeps from `own`; nothing of use at junctions.
    ///
    /// # Errors
    /// [`crate::base::Error::Cancelled`].
    pub fn diffused(&self, links: &Links, own: &[u32], sweeps: usize, run: &Run) -> Result<Vec<u32>> {
        let m = own.len();
        let place = |b: usize, to: u32, inside: bool| {
            if inside { to } else { (m + usize::from(to == self.of[b][1])) as u32 }
        };
        let ways: Vec<(u32, f32)> = (0..m)
            .flat_map(|b| links.around(b).iter().map(move |link| (place(b, link.to, link.inside), link.weight)))
            .collect();
        let pure = |second: bool| [f32::from(!second), f32::from(second)];
        let mut now: Vec<[f32; 2]> = own.iter().zip(&self.of).map(|(&label, pair)| pure(label == pair[1])).collect();
        now.extend([pure(false), pure(true)]);
        let mut next = now.clone();
        for _ in 0..sweeps {
            let before = &now[..];
            fill_chunks(
                run.threads,
                &run.cancel,
                &mut next[..m],
                CHUNK,
                || (),
                |k, out, ()| {
                    for (slot, b) in out.iter_mut().zip(chunk_range(m, CHUNK, k)) {
                        if !self.is_junction(b) {
                            *slot = mixed(before, b, &ways[links.span(b)]);
                        }
                    }
                    Ok(())
                },
            )?;
            std::mem::swap(&mut now, &mut next);
        }
        Ok(now.iter().zip(&self.of).map(|(x, pair)| pair[usize::from(x[1] > x[0])]).collect())
    }
}

/// The strengths at place `b` after a sweep over the `ways` to its neighbours: theirs by weight, and as much of its own.
#[inline]
fn mixed(before: &[[f32; 2]], b: usize, ways: &[(u32, f32)]) -> [f32; 2] {
    let (mut strength, mut all) = ([0f32; 2], 0f32);
    let mut add = |x: [f32; 2], weight: f32| {
        strength[0] += weight * x[0];
        strength[1] += weight * x[1];
    };
    for &(to, weight) in ways {
        add(before[to as usize], weight);
        all += weight;
    }
    add(before[b], all);
    let sum = strength[0] + strength[1];
    if sum > 0. && sum < f32::INFINITY { strength.map(|s| s / sum) } else { before[b] }
}

/// `pair` and `label`, where that makes two at the most.
fn with(pair: [u32; 2], label: u32) -> [u32; 2] {
    match pair {
        MANY => MANY,
        [a, b] if a == label || b == label => pair,
        [NONE, _] => [label, NONE],
        [a, NONE] => [a.min(label), a.max(label)],
        _ => MANY,
    }
}

fn find(parent: &mut [u32], mut i: u32) -> u32 {
    while parent[i as usize] != i {
        parent[i as usize] = parent[parent[i as usize] as usize];
        i = parent[i as usize];
    }
    i
}
