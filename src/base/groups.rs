//! Lists of items by owner, one after the other in one array: the faces of each vertex, the neighbours of each cell.
//!
//! Two passes over the pairs, without a sort; 4 bytes per owner beside the items.

/// Lists of items, one per owner.
#[derive(Clone, Debug)]
pub struct Groups<T> {
    starts: Vec<u32>,
    items: Vec<T>,
}

impl<T: Copy + Default> Groups<T> {
    /// Builds `count` lists from `pairs` (owner, item), whose order the lists keep.
    ///
    /// ```
    /// use nystrom_stream::base::groups::Groups;
    /// let groups = Groups::of(3, [(2, 'a'), (0, 'b'), (2, 'c')].into_iter());
    /// assert_eq!([0, 1, 2].map(|owner| groups.of_owner(owner)), [&['b'][..], &[], &['a', 'c']]);
    /// ```
    pub fn of(count: usize, pairs: impl Iterator<Item = (u32, T)> + Clone) -> Self {
        let mut starts = vec![0u32; count + 1];
        pairs.clone().for_each(|(owner, _)| starts[owner as usize + 1] += 1);
        (0..count).for_each(|k| starts[k + 1] += starts[k]);
        let (mut next, mut items) = (starts.clone(), vec![T::default(); starts[count] as usize]);
        for (owner, item) in pairs {
            items[next[owner as usize] as usize] = item;
            next[owner as usize] += 1;
        }
        Self { starts, items }
    }

    /// The items of `owner`.
    #[inline]
    pub fn of_owner(&self, owner: u32) -> &[T] {
        &self.items[self.starts[owner as usize] as usize..self.starts[owner as usize + 1] as usize]
    }
}
