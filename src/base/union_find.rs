//! Union-find: disjoint sets whose representative is always the least member, whatever the order of unions.
//!
//! Paths are halved during a search; there is no rank, since the least member must be the root. [`Forest`] holds plain
//! sets; [`ParityForest`] also stores one bit between each member and its parent. Memory: 4 bytes per member. This is
//! our own code because results depend on the representative, and because parents may lie in a mapped file.

use super::{Cancel, Result};

/// A forest of disjoint sets: the parent of each member, in memory or in a mapped file.
#[derive(Clone, Debug)]
pub struct Forest<P>(P);

impl Forest<Vec<u32>> {
    /// `n` singletons.
    pub fn new(n: usize) -> Self {
        Self((0..n as u32).collect())
    }
}

impl<'a> Forest<&'a mut [u32]> {
    /// Singletons, with their parents stored in `parents` (n).
    pub fn over(parents: &'a mut [u32]) -> Self {
        (0u32..).zip(&mut *parents).for_each(|(i, parent)| *parent = i);
        Self(parents)
    }
}

impl<P: AsRef<[u32]> + AsMut<[u32]>> Forest<P> {
    /// The sets described by `parents` (n); no parent is greater than its child.
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

/// The bit of a parent link that holds the parity between a member and its parent; members have 31 bits.
pub const PARITY: u32 = 1 << 31;

/// A forest with parities, over a caller's array of parents. Members are added in ascending order.
#[derive(Debug)]
pub struct ParityForest<'a>(&'a mut [u32]);

impl<'a> ParityForest<'a> {
    /// No members yet; `parents` (n) may be uninitialised.
    pub fn new(parents: &'a mut [u32]) -> Self {
        Self(parents)
    }

    /// Adds `i` as a set of its own.
    #[inline]
    pub fn add(&mut self, i: u32) {
        self.0[i as usize] = i;
    }

    /// The representative of `i` and the parity of the path to it.
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
            // Path halving: the member now links to its grandparent, with the parity of both steps.
            self.0[i as usize] = above ^ (link & PARITY);
            parity ^= above & PARITY;
            i = above & !PARITY;
        }
    }

    /// Joins the set with representative `mine`, which a member reaches with parity `my_parity`, with the set of
    /// `other`, whose parity relative to that member is `between`. Returns the member's new representative and parity.
    /// If both are already in one set, nothing changes, even if the parities contradict each other.
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

    /// The array of parents, each with its parity; no parent is greater than its child.
    pub fn into_parents(self) -> &'a mut [u32] {
        self.0
    }
}

/// Members between two checks of the stop flag.
const CHUNK: usize = 1 << 18;

/// Replaces each of `parents` (n), none of which is greater than its child, by its representative, with the parity of
/// the path in [`PARITY`]. One ascending pass suffices, since parents come before children.
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
