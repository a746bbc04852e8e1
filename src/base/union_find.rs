//! Union-find: disjoint sets whose representative is always their least member, whatever the order of unions.
//!
//! Paths are halved on the way; there is no rank, since the least member must win. [`Forest`] holds plain sets,
//! [`ParityForest`] also a bit between each member and its representative. Memory: 4 bytes per member. Own code because
//! the representative is part of results, and because parents may lie in a mapped file.

use super::{Cancel, Result};

/// A forest of disjoint sets: the parent of each member, in memory or in a mapped file.
#[derive(Clone, Debug)]
pub struct Forest<P>(P);

impl Forest<Vec<u32>> {
    /// `n` sets of one.
    pub fn new(n: usize) -> Self {
        Self((0..n as u32).collect())
    }
}

impl<'a> Forest<&'a mut [u32]> {
    /// Sets of one, whose parents lie in `parents` (n).
    pub fn over(parents: &'a mut [u32]) -> Self {
        (0u32..).zip(&mut *parents).for_each(|(i, parent)| *parent = i);
        Self(parents)
    }
}

impl<P: AsRef<[u32]> + AsMut<[u32]>> Forest<P> {
    /// Sets that `parents` (n) tell; none is greater than its child.
    pub fn of(parents: P) -> Self {
        Self(parents)
    }

    /// The least member of the set of `i`.
    #[inline]
    pub fn find(&mut self, mut i: u32) -> u32 {
        let parents = self.0.as_mut();
        while parents[i as usize] != i {
            parents[i as usize] = parents[parents[i as usize] as usize];
            i = parents[i as usize];
        }
        i
    }

    /// Joins two sets. Returns whether they were different.
    #[inline]
    pub fn join(&mut self, i: u32, j: u32) -> bool {
        let (i, j) = (self.find(i), self.find(j));
        self.0.as_mut()[i.max(j) as usize] = i.min(j);
        i != j
    }

    /// The representative of each member, in place of its parent.
    pub fn labels(mut self) -> P {
        let parents = self.0.as_mut();
        // No parent is greater than its child, so each one's own is its representative by now.
        (0..parents.len()).for_each(|i| parents[i] = parents[parents[i] as usize]);
        self.0
    }
}

/// The bit of a parent that holds the parity between a member and that parent; members have 31 bits.
pub const PARITY: u32 = 1 << 31;

/// A forest with parities, over parents that lie elsewhere. Members are added in ascending order.
#[derive(Debug)]
pub struct ParityForest<'a>(&'a mut [u32]);

impl<'a> ParityForest<'a> {
    /// No members yet; `parents` (n) need not be initialised.
    pub fn new(parents: &'a mut [u32]) -> Self {
        Self(parents)
    }

    /// Adds `i` as a set of its own.
    #[inline]
    pub fn add(&mut self, i: u32) {
        self.0[i as usize] = i;
    }

    /// The representative of `i` and the parity on the way there.
    #[inline]
    fn find(&mut self, mut i: u32) -> (u32, u32) {
        let mut parity = 0;
        loop {
            let link = self.0[i as usize];
            let up = link & !PARITY;
            if up == i {
                return (i, parity);
            }
            let above = self.0[up as usize];
            parity ^= link & PARITY;
            if above & !PARITY == up {
                return (up, parity);
            }
            // Both steps at once, for this member from now on.
            self.0[i as usize] = above ^ (link & PARITY);
            parity ^= above & PARITY;
            i = above & !PARITY;
        }
    }

    /// Joins the set of representative `mine`, which a member reaches with parity `my_parity`, with the set of `other`,
    /// which has parity `between` to that member. Returns the member's representative and parity from now on. Where
    /// both are in one set already, nothing changes, even if parities contradict.
    #[inline]
    pub fn join(&mut self, (mine, my_parity): (u32, u32), other: u32, between: u32) -> (u32, u32) {
        let (other, parity) = self.find(other);
        if other == mine {
            return (mine, my_parity);
        }
        let (low, high) = (mine.min(other), mine.max(other));
        self.0[high as usize] = low | (my_parity ^ parity ^ between);
        (low, if low == mine { my_parity } else { parity ^ between })
    }

    /// Parents as they lie, each with the parity to it; none is greater than its child.
    pub fn into_parents(self) -> &'a mut [u32] {
        self.0
    }
}

/// Members between looks at the stop flag.
const CHUNK: usize = 1 << 18;

/// Sets each of `parents` (n), which hold no greater ones, to its representative, with the parity on the way there in
/// [`PARITY`]. One ascending pass, since parents come before children.
///
/// # Errors
/// [`super::Error::Cancelled`].
pub fn flatten(parents: &mut [u32], cancel: &Cancel) -> Result<()> {
    for start in (0..parents.len()).step_by(CHUNK) {
        cancel.check()?;
        for i in start..parents.len().min(start + CHUNK) {
            let link = parents[i];
            if link & !PARITY != i as u32 {
                parents[i] = parents[(link & !PARITY) as usize] ^ (link & PARITY);
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_least_member_represents_its_set() {
        let mut sets = Forest::new(6);
        assert!(sets.join(5, 3) && sets.join(3, 4) && !sets.join(4, 5) && sets.join(2, 0));
        assert_eq!(sets.labels(), [0, 1, 0, 3, 3, 3]);
    }

    #[test]
    fn parities_add_up_along_paths() {
        let mut parents = [0; 4];
        let mut sets = ParityForest::new(&mut parents);
        (0..4).for_each(|i| sets.add(i));
        // 3 differs from 2, 2 from 1, 1 agrees with 0.
        sets.join((3, 0), 2, PARITY);
        sets.join((2, 0), 1, PARITY);
        sets.join((1, 0), 0, 0);
        assert_eq!((0..4).map(|i| sets.find(i)).collect::<Vec<_>>(), [(0, 0), (0, 0), (0, PARITY), (0, 0)]);
    }
}
