//! A set of numbers below a bound, one bit each.
//!
//! Own code, since it is a dozen lines and its bytes are granted beforehand. Memory: n/8 bytes.

/// Which of the numbers below n are members.
#[derive(Clone, Debug)]
pub struct BitSet(Vec<u64>);

impl BitSet {
    /// No members among `n` numbers.
    pub fn new(n: usize) -> Self {
        Self(vec![0; n.div_ceil(64)])
    }

    /// Bytes of a set of `n` numbers.
    pub fn bytes(n: usize) -> u64 {
        8 * n.div_ceil(64) as u64
    }

    /// Whether `i` is a member; numbers beyond the bound are not.
    #[inline]
    pub fn has(&self, i: u32) -> bool {
        self.0.get(i as usize / 64).is_some_and(|word| word >> (i % 64) & 1 == 1)
    }

    /// Adds `i`, below the bound; whether it is new.
    #[inline]
    pub fn add(&mut self, i: u32) -> bool {
        let (word, bit) = (&mut self.0[i as usize / 64], 1 << (i % 64));
        let new = *word & bit == 0;
        *word |= bit;
        new
    }

    /// Removes `i`, below the bound.
    #[inline]
    pub fn remove(&mut self, i: u32) {
        self.0[i as usize / 64] &= !(1 << (i % 64));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn members_are_those_that_were_added_and_not_removed() {
        let mut set = BitSet::new(130);
        assert!([0, 63, 64, 129].iter().all(|&i| set.add(i)) && !set.add(64));
        set.remove(63);
        let members: Vec<u32> = (0..1000).filter(|&i| set.has(i)).collect();
        assert_eq!(members, [0, 64, 129]);
        assert_eq!(BitSet::bytes(130), 24);
    }
}
