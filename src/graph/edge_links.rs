//! How the faces around an edge are linked.
//!
//! Two faces are linked to each other. Three or more, at a non-manifold edge, become a chain in which directions
//! alternate, and faces of the more frequent direction that are left over are linked to ones of the other: no link
//! contradicts the windings unless all faces have one direction. k − 1 links keep the graph sparse if a soup has a
//! million faces on one edge.
//!
//! Where faces lie in the same place with opposite windings, as at the contact of two bodies or between the materials
//! of a labelled volume, a chain would link the bodies. There each sector that faces bound from inside is one body's:
//! sorted by their angle around the edge, faces open and close sectors like brackets, and the two of each sector are
//! linked. Only what is left over is chained. A flap that hangs on a surface is closed in itself, and the surface below
//! it is linked as if it were not there; a flap inside becomes a slit ([`super::flaps`] removes both).
//!
//! Cost: nothing but the two links at an edge of two faces; a hash and a sort per face at others. Memory: 16 bytes per
//! face of the edge.

use crate::base::Result;
use crate::base::vector::{cross, dot, minus};
use crate::mesh::Mesh;
use crate::mesh::duplicates::Place;

/// Most faces left over that are linked to the same one.
const MOST_ON_ONE: usize = 4;
/// Most faces around an edge that are sorted by angle: more are no surface, and would take memory.
const MOST_SORTED: usize = 1 << 12;

/// A face's side of an edge: the corner where it starts, and its direction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct FaceSide {
    pub corner: u32,
    pub ascending: bool,
}

/// One direction of a link between two sides of an edge.
#[derive(Clone, Copy, Debug)]
pub(super) struct Match {
    /// Where the step starts.
    pub corner: u32,
    /// Its face.
    pub from: usize,
    /// The face on the other side.
    pub to: usize,
    /// Whether both faces traverse the edge in the same direction.
    pub opposite_winding: bool,
}

/// Links the faces of all `sides` of an edge, ascending by corner, in both directions. There are fewer links than
/// sides.
#[inline]
pub(super) fn link_sides(
    mesh: &Mesh,
    mut sides: impl ExactSizeIterator<Item = FaceSide>,
    mut join: impl FnMut(Match) -> Result<()>,
) -> Result<()> {
    match (sides.len(), sides.next(), sides.next()) {
        (2, Some(a), Some(b)) => link(mesh, a, b, &mut join),
        (_, Some(a), Some(b)) => link_several(mesh, [a, b].into_iter().chain(sides).collect(), &mut join),
        _ => Ok(()),
    }
}

/// Links two sides, unless they are of one face.
#[inline]
fn link(mesh: &Mesh, a: FaceSide, b: FaceSide, join: &mut impl FnMut(Match) -> Result<()>) -> Result<()> {
    let [from, to] = [a, b].map(|side| mesh.faces.face_of_corner(side.corner as usize));
    if from == to {
        return Ok(());
    }
    let opposite_winding = a.ascending == b.ascending;
    join(Match { corner: a.corner, from, to, opposite_winding })?;
    join(Match { corner: b.corner, from: to, to: from, opposite_winding })
}

#[cold]
fn link_several(mesh: &Mesh, sides: Vec<FaceSide>, join: &mut impl FnMut(Match) -> Result<()>) -> Result<()> {
    let order = if sides.len() <= MOST_SORTED { around(mesh, &sides) } else { None };
    if let Some(order) = order {
        let (sectors, mut rest) = sectors_of(&order);
        sectors.iter().try_for_each(|[a, b]| link(mesh, *a, *b, join))?;
        rest.sort_unstable_by_key(|side| side.corner);
        let is_other = |side: &FaceSide| rest.first().is_some_and(|first| first.ascending != side.ascending);
        let others: Vec<FaceSide> = sides.into_iter().filter(is_other).collect();
        return link_rest(mesh, &rest, &others, join);
    }
    let direction = sides[0].ascending;
    let (mut more, mut fewer): (Vec<FaceSide>, Vec<FaceSide>) =
        sides.into_iter().partition(|side| side.ascending == direction);
    if fewer.len() > more.len() {
        std::mem::swap(&mut more, &mut fewer);
    }
    // If there is but one direction, the chain begins with its first side.
    let chained = if fewer.is_empty() { 0 } else { more.len().min(fewer.len() + 1) };
    let (chained, rest) = more.split_at(chained);
    chained.iter().zip(&fewer).try_for_each(|(a, b)| link(mesh, *a, *b, join))?;
    fewer.iter().zip(chained.iter().skip(1)).try_for_each(|(a, b)| link(mesh, *a, *b, join))?;
    link_rest(mesh, rest, &fewer, join)
}

/// Links the sides of one direction that are left over to `others`, those of the other, but to none more than a few;
/// and further ones to each other.
fn link_rest(
    mesh: &Mesh,
    rest: &[FaceSide],
    others: &[FaceSide],
    join: &mut impl FnMut(Match) -> Result<()>,
) -> Result<()> {
    let near = rest.len().min(MOST_ON_ONE * others.len());
    rest[..near].iter().zip(others.iter().cycle()).try_for_each(|(a, b)| link(mesh, *a, *b, join))?;
    rest[near.saturating_sub(1)..].windows(2).try_for_each(|two| link(mesh, two[0], two[1], join))
}

/// `sides` by their angle around the edge; of those at the same angle, ascending ones first. `None` unless two faces
/// lie in the same place with opposite windings, and if a face has no angle.
fn around(mesh: &Mesh, sides: &[FaceSide]) -> Option<Vec<FaceSide>> {
    let place = |side: &FaceSide| mesh.place_at_edge(side.corner as usize);
    let places: Vec<Option<Place>> = sides.iter().map(place).collect();
    // The first side in each place: faces there have its angle, whatever the order of their corners.
    let mut by_place: Vec<usize> = (0..sides.len()).filter(|&k| places[k].is_some()).collect();
    by_place.sort_unstable_by_key(|&k| (places[k], k));
    let mut first: Vec<usize> = (0..sides.len()).collect();
    let mut are_opposite = false;
    for same in by_place.chunk_by(|&a, &b| places[a] == places[b]) {
        same.iter().for_each(|&k| first[k] = same[0]);
        are_opposite |= same.iter().any(|&k| sides[k].ascending != sides[same[0]].ascending);
    }
    if !are_opposite {
        return None;
    }
    let axis = {
        let [a, b, _] = corners_at(mesh, sides[0]);
        if sides[0].ascending { minus(b, a) } else { minus(a, b) }
    };
    let out = |side: FaceSide| {
        let [a, b, next] = corners_at(mesh, side);
        minus(next, if side.ascending { a } else { b })
    };
    // Perpendicular to the edge, both; their lengths stretch the angles, but keep their order.
    let up = cross(axis, out(sides[0]));
    let right = cross(up, axis);
    let (right, up) = (scaled(right)?, scaled(up)?);
    let angle = |k: usize| {
        let out = out(sides[k]);
        turn(dot(out, right), dot(out, up))
    };
    let angles = (0..sides.len()).map(|k| angle(first[k])).collect::<Option<Vec<f64>>>()?;
    let mut order: Vec<usize> = (0..sides.len()).collect();
    order.sort_by(|&a, &b| {
        let key = |k: usize| (!sides[k].ascending, sides[k].corner);
        angles[a].total_cmp(&angles[b]).then(key(a).cmp(&key(b)))
    });
    Some(order.into_iter().map(|k| sides[k]).collect())
}

/// The positions of the two ends of a side, in the direction of its face, and of the corner that follows them.
fn corners_at(mesh: &Mesh, side: FaceSide) -> [[f64; 3]; 3] {
    let corner = side.corner as usize;
    let face = mesh.faces.face_of_corner(corner);
    let slot = corner - mesh.faces.corner_range(face).start;
    mesh.faces.with(face, |corners| [0, 1, 2].map(|k| mesh.positions.get(corners[(slot + k) % corners.len()])))
}

/// `v` with a greatest coordinate of 1; `None` for a vector without direction.
fn scaled(v: [f64; 3]) -> Option<[f64; 3]> {
    let most = v.into_iter().fold(0., |most: f64, x| most.max(x.abs()));
    (most > 0. && most.is_finite()).then(|| v.map(|x| x / most))
}

/// A number from 0 to 4 that grows with the angle of (x, y), without trigonometry; `None` for no angle.
fn turn(x: f64, y: f64) -> Option<f64> {
    let sum = x.abs() + y.abs();
    if !(sum > 0. && sum.is_finite()) {
        return None;
    }
    let part = y / sum;
    Some(match (x >= 0., y >= 0.) {
        (true, true) => part,
        (false, _) => 2. - part,
        (true, false) => 4. + part,
    })
}

/// The pairs of sides that bound a sector from inside, of sides in the `order` around the edge; and the sides that do
/// not. Behind an ascending side, which closes a sector, the angle decreases.
fn sectors_of(order: &[FaceSide]) -> (Vec<[FaceSide; 2]>, Vec<FaceSide>) {
    let n = order.len();
    let (mut open, mut is_free, mut sectors) = (Vec::new(), vec![true; n], Vec::new());
    // A sector may contain the angle where the order begins.
    for k in (0..2 * n).filter(|&k| k < n || order[k - n].ascending) {
        let k = k % n;
        if !order[k].ascending {
            open.push(k);
        } else if is_free[k]
            && let Some(first) = open.pop()
        {
            (is_free[first], is_free[k]) = (false, false);
            sectors.push([order[first], order[k]]);
        }
    }
    (sectors, (0..n).filter(|&k| is_free[k]).map(|k| order[k]).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The links at the edge from vertex 0 to vertex 1 of `mesh`, as pairs of faces, with whether windings contradict.
    fn links(points: &[[f64; 3]], faces: &[[u32; 3]]) -> Vec<(usize, usize, bool)> {
        let mesh = Mesh::from_slices(points, faces).unwrap();
        let side = |corner: u32| {
            let (face, slot) = ((corner / 3) as usize, corner as usize % 3);
            let ends = (faces[face][slot], faces[face][(slot + 1) % 3]);
            (ends.0.max(ends.1) == 1).then_some(FaceSide { corner, ascending: ends.0 < ends.1 })
        };
        let sides: Vec<FaceSide> = (0..3 * faces.len() as u32).filter_map(side).collect();
        let mut found = Vec::new();
        let join = |link: Match| {
            found.extend((link.from < link.to).then_some((link.from, link.to, link.opposite_winding)));
            Ok(())
        };
        link_sides(&mesh, sides.into_iter(), join).unwrap();
        found.sort_unstable();
        found
    }

    /// The ends of the edge, and four points around it: right, up, left, down.
    const CROSS: [[f64; 3]; 6] =
        [[0., 0., 0.], [0., 0., 1.], [1., 0., 0.5], [0., 1., 0.4], [-1., 0., 0.6], [0., -1., 0.5]];

    #[test]
    fn two_faces_are_linked_whatever_their_windings() {
        assert_eq!(links(&CROSS, &[[0, 1, 2], [1, 0, 3]]), [(0, 1, false)]);
        assert_eq!(links(&CROSS, &[[0, 1, 2], [3, 0, 1]]), [(0, 1, true)]);
        assert_eq!(links(&CROSS, &[[0, 1, 2]]), []);
    }

    /// Regression: a chain in the order of the file linked faces of one direction, and a surface of consistent winding
    /// had contradictions at its non-manifold edges.
    #[test]
    fn a_chain_alternates() {
        let up = |v: u32| [0, 1, v];
        let down = |v: u32| [1, 0, v];
        assert_eq!(links(&CROSS, &[up(2), up(3), down(4), down(5)]), [(0, 2, false), (1, 2, false), (1, 3, false)]);
        assert_eq!(links(&CROSS, &[down(2), up(3), up(4)]), [(0, 1, false), (0, 2, false)]);
        assert_eq!(links(&CROSS, &[up(2), up(3), up(4)]), [(0, 1, true), (1, 2, true)]);
        assert_eq!(links(&CROSS, &[up(2), up(3), down(5), up(4)]), [(0, 2, false), (1, 2, false), (2, 3, false)]);
        // Seven of the other direction: two are chained, four linked to the only one, the last to one of these.
        let fan: Vec<[u32; 3]> = [down(5)].into_iter().chain((0..7).map(|k| up(2 + k % 3))).collect();
        let on_one = (1..7).map(|face| (0, face, false)).chain([(6, 7, true)]);
        assert_eq!(links(&CROSS, &fan), on_one.collect::<Vec<_>>());
    }

    #[test]
    fn bodies_in_contact_are_not_linked() {
        // Above and below the plane of the contact (face 2 and 3), each with its own side of it; all wound outwards.
        let above = [[0, 1, 3], [1, 0, 2]];
        let below = [[1, 0, 5], [0, 1, 2]];
        let faces = [above[0], below[0], above[1], below[1]];
        assert_eq!(links(&CROSS, &faces), [(0, 2, false), (1, 3, false)]);
        // Three bodies around the edge, with a face each for both sides of their contacts.
        let walls = [[0, 1, 3], [1, 0, 2], [0, 1, 4], [1, 0, 3], [0, 1, 2], [1, 0, 4]];
        assert_eq!(links(&CROSS, &walls), [(0, 1, false), (2, 3, false), (4, 5, false)]);
    }

    #[test]
    fn a_flap_outside_is_closed_and_one_inside_is_a_slit() {
        // A roof over the edge, solid below; a flap above it.
        let roof = [[0, 1, 2], [1, 0, 4]];
        let flap = |v: u32| [[0, 1, v], [1, 0, v]];
        let on = |flap: [[u32; 3]; 2]| links(&CROSS, &[roof[0], roof[1], flap[0], flap[1]]);
        // From right to left, the solid is where angles grow from the descending face to the ascending one.
        assert_eq!(on(flap(3)), [(0, 1, false), (2, 3, false)]);
        assert_eq!(on(flap(5)), [(0, 3, false), (1, 2, false)]);
    }

    #[test]
    fn what_bounds_no_sector_is_chained() {
        // A sheet ends at a contact.
        let faces = [[0, 1, 3], [1, 0, 2], [0, 1, 2], [0, 1, 5]];
        let found = links(&CROSS, &faces);
        assert_eq!(found.len(), 3, "{found:?}");
        // A face without a direction.
        assert_eq!(links(&CROSS, &[[0, 1, 2], [1, 0, 2], [0, 1, 0], [1, 0, 3]]).len(), 3);
    }
}
