//! What a front carries along with distances: nothing, a limit, or the owners of nodes.

/// What is carried along with distances; the plain front carries nothing.
pub(super) trait Carry {
    /// Whether a node at this distance is to be visited.
    #[inline(always)]
    fn admits(&self, _distance: f32) -> bool {
        true
    }
    /// Whether ties matter.
    #[inline(always)]
    fn ties(&self) -> bool {
        false
    }
    /// Whether `from`'s value should pass to `to` at an equal distance.
    fn wins_tie(&mut self, from: u32, to: u32) -> bool;
    /// Passes the value on.
    fn pass(&mut self, from: u32, to: u32);
}

impl Carry for () {
    #[inline(always)]
    fn wins_tie(&mut self, _: u32, _: u32) -> bool {
        false
    }
    #[inline(always)]
    fn pass(&mut self, _: u32, _: u32) {}
}

/// Nothing is carried; nodes at the limit or beyond stay as they are.
pub(super) struct Within(pub f32);

impl Carry for Within {
    #[inline(always)]
    fn admits(&self, distance: f32) -> bool {
        distance < self.0
    }
    #[inline(always)]
    fn wins_tie(&mut self, _: u32, _: u32) -> bool {
        false
    }
    #[inline(always)]
    fn pass(&mut self, _: u32, _: u32) {}
}

/// The source a node belongs to; at equal distances the smaller number wins, so the owners over final
/// distances are a unique fixed point too.
pub(super) struct Owners<'a> {
    owner: &'a mut [u32],
    /// Whether a tie was met that the node reached had won before. Its owner may be stale then: passed on by a
    /// node that was lowered since, by so little that rounding hides it here.
    pub doubtful: bool,
}

impl<'a> Owners<'a> {
    pub fn new(owner: &'a mut [u32]) -> Self {
        Self { owner, doubtful: false }
    }
}

impl Carry for Owners<'_> {
    #[inline(always)]
    fn ties(&self) -> bool {
        true
    }
    #[inline(always)]
    fn wins_tie(&mut self, from: u32, to: u32) -> bool {
        let (from, to) = (self.owner[from as usize], self.owner[to as usize]);
        self.doubtful |= from > to;
        from < to
    }
    #[inline(always)]
    fn pass(&mut self, from: u32, to: u32) {
        self.owner[to as usize] = self.owner[from as usize];
    }
}

/// Takes the owners of all nodes that a front reached (`field` (n) is neither 0 nor infinite there), so that another over
/// the same distances finds them for certain.
pub(super) fn disown(field: &[f32], owner: &mut [u32]) {
    for (owner, &distance) in owner.iter_mut().zip(field) {
        if distance > 0. && distance < f32::INFINITY {
            *owner = u32::MAX;
        }
    }
}
