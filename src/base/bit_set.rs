//! A set of numbers below a bound, one bit each, and one whose members are numbered.
//!
//! Own code, since it is short and its bytes are granted beforehand. Memory: n/8 bytes, n/4 for the numbered one.

/// Which of the numbers below n are members.
#[derive(Clone, Debug, Default)]
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

impl From<Vec<u64>> for BitSet {
    /// The numbers whose bits are set, the lowest bit of each word first.
    fn from(words: Vec<u64>) -> Self {
        Self(words)
    }
}

/// A set whose members are numbered from 0 in ascending order.
#[derive(Clone, Debug, Default)]
pub struct RankedSet {
    members: BitSet,
    /// Words with members, ascending.
    words: Vec<u32>,
    /// Number of members before each word, where that has any.
    before: Vec<u32>,
    count: u32,
}

impl RankedSet {
    /// The members of `members`, numbered.
    pub fn of(members: BitSet) -> Self {
        let words = (0u32..).zip(&members.0).filter(|(_, bits)| **bits != 0).map(|(word, _)| word).collect();
        let mut set = Self { before: vec![0; members.0.len()], words, members, count: 0 };
        set.number();
        set
    }

    /// Bytes of a set of `n` numbers.
    pub fn bytes(n: usize) -> u64 {
        16 * n.div_ceil(64) as u64
    }

    /// Replaces the members by those that `fill` passes on; takes time in proportion to both.
    pub fn refill<R>(&mut self, fill: impl FnOnce(&mut dyn FnMut(u32)) -> R) -> R {
        let Self { members, words, .. } = self;
        words.drain(..).for_each(|word| members.0[word as usize] = 0);
        let filled = fill(&mut |i| {
            if members.0[i as usize / 64] == 0 {
                words.push(i / 64);
            }
            members.add(i);
        });
        words.sort_unstable();
        self.number();
        filled
    }

    fn number(&mut self) {
        self.count = 0;
        for &word in &self.words {
            self.before[word as usize] = self.count;
            self.count += self.members.0[word as usize].count_ones();
        }
    }

    /// Number of members.
    pub fn count(&self) -> u32 {
        self.count
    }

    /// The number of the member `i`; `None` for others.
    #[inline]
    pub fn rank(&self, i: u32) -> Option<u32> {
        let (word, bit) = (i as usize / 64, i % 64);
        self.members.has(i).then(|| self.before[word] + (self.members.0[word] & ((1 << bit) - 1)).count_ones())
    }

    /// The members in order.
    pub fn iter(&self) -> impl Iterator<Item = u32> {
        let rest = |&bits: &u64| Some(bits & (bits - 1)).filter(|&rest| rest != 0);
        self.words.iter().flat_map(move |&word| {
            let (first, bits) = (64 * word, self.members.0[word as usize]);
            let words = std::iter::successors(Some(bits).filter(|&bits| bits != 0), rest);
            words.map(move |bits| first + bits.trailing_zeros())
        })
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

    #[test]
    fn members_are_numbered_in_order() {
        let members = [0, 63, 64, 129];
        let mut set = RankedSet::of(BitSet::new(130));
        assert_eq!((set.count(), set.iter().next(), set.rank(64)), (0, None, None));
        for of in [&members[..], &members[1..3]] {
            set.refill(|add| of.iter().for_each(|&i| add(i)));
            assert_eq!((set.iter().collect::<Vec<_>>(), set.count()), (of.to_vec(), of.len() as u32));
            let ranks: Vec<Option<u32>> = (0..200).map(|i| set.rank(i)).collect();
            assert_eq!(ranks.iter().flatten().copied().collect::<Vec<_>>(), (0..of.len() as u32).collect::<Vec<_>>());
            assert!((0..200).all(|i| ranks[i as usize].is_some() == of.contains(&i)));
        }
        assert_eq!(RankedSet::bytes(130), 48);
    }
}
