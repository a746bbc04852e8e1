//! Where the boundaries cross the edges of the strip.
//!
//! Every vertex of the strip gets a label, or is *tied*: the boundary passes through it. An edge between two labels is
//! crossed once. A vertex inside a part always keeps its part; one on a boundary starts with the label that has most of
//! the angle around it. Then each crossing moves along its edge to where the boundary is shortest, given its
//! neighbours. Where the crossings come to rest at a vertex, the vertex changes sides, and the boundary may move on. So
//! a boundary becomes the shortest curve in the strip of faces that touch the original boundary, and no part vanishes.
//!
//! The tied vertices are those of boundaries along a crease (two or more consecutive sharp edges), at borders of the
//! mesh (so that seams of coincident vertices stay closed), of faces other than triangles, and of faces so narrow
//! between boundaries that no vertex inside their part is near.
//!
//! Cost: [`ROUNDS`] times [`SWEEPS`] passes over the crossings, some 50 ns per crossing.

use super::strip::Strip;
use crate::base::sort::sort_by;
use crate::base::tally::add_weight;
use crate::base::vector::{MapEach, add_scaled, cross, distance, dot, double_area, length, minus, unit};
use crate::base::{Cancel, Result};

/// The cosine of 40°: a boundary between faces that turn by more is sharp.
const CREASE: f64 = 0.766;
/// How far along an edge a crossing may move towards a vertex inside a part.
const FARTHEST: f64 = 0.8;
/// A crossing nearer to an end than this share of its edge is snapped to it.
const SNAP: f64 = 0.05;
/// If all crossings around a vertex are nearer than this share, the boundary rests against the vertex.
const RESTS: f64 = 0.1;
/// Rounds of vertices changing sides.
const ROUNDS: usize = 8;
/// Passes over all crossings in each round.
const SWEEPS: usize = 32;
/// Iterations to find the point where three parts meet.
const STEPS: usize = 16;

/// The curves of a strip.
pub(super) struct Curves<'a> {
    strip: &'a Strip,
    /// The label of each vertex; `None` where it is tied.
    pub label: Vec<Option<u32>>,
    /// Position of each edge's crossing, if any: 0 at its first end, 1 at its second.
    along: Vec<f64>,
}

impl<'a> Curves<'a> {
    /// The shortest curves of `strip` that pass through those of its boundary vertices that are `tied` in the mesh.
    ///
    /// # Errors
    /// [`crate::base::Error::Cancelled`].
    pub fn of(strip: &'a Strip, tied: &[bool], cancel: &Cancel) -> Result<Self> {
        let mut curves = Self { strip, label: strip.inner.clone(), along: vec![0.5; strip.edges.len()] };
        curves.begin(&curves.tied(tied));
        let mut moved = vec![false; strip.vertices.len()];
        for round in 0..=ROUNDS {
            let crossed: Vec<u32> = (0..strip.edges.len() as u32).filter(|&e| curves.is_crossed(e)).collect();
            for sweep in 0..SWEEPS {
                cancel.check()?;
                // Alternating directions, so that changes spread both ways.
                if sweep % 2 == 0 {
                    crossed.iter().for_each(|&e| curves.shorten(e));
                } else {
                    crossed.iter().rev().for_each(|&e| curves.shorten(e));
                }
            }
            if round < ROUNDS && !curves.change_sides(&mut moved) {
                break;
            }
        }
        Ok(curves)
    }

    /// Whether the ends of an edge have different labels.
    pub fn is_crossed(&self, e: u32) -> bool {
        let [a, b] = self.strip.edges[e as usize].map_each(|v| self.label[v as usize]);
        a.is_some() && b.is_some() && a != b
    }

    /// Where an edge is crossed, snapped to an end if near.
    pub fn crossing(&self, e: u32) -> f64 {
        match self.along[e as usize] {
            t if t < SNAP => 0.,
            t if t > 1. - SNAP => 1.,
            t => t,
        }
    }

    /// The vertices that the boundary has to pass through: those `given` in the mesh, and others.
    fn tied(&self, given: &[bool]) -> Vec<bool> {
        let strip = self.strip;
        let mut tied = vec![false; strip.vertices.len()];
        let mut tie = |v: u32| tied[v as usize] = strip.inner[v as usize].is_none();
        let is_given = |v: u32| given.get(v as usize).is_some_and(|given| *given);
        (0..).zip(&strip.vertices).filter(|(_, v)| is_given(**v)).for_each(|(v, _)| tie(v));
        for f in 0..strip.len() {
            if strip.triangle(f).is_none() || self.is_narrow(f) {
                strip.face(f).iter().for_each(|&v| tie(v));
            }
        }
        let mut sharp = Vec::new();
        for (e, ends) in (0..).zip(&strip.edges) {
            if ends.iter().all(|&v| strip.inner[v as usize].is_some()) {
                continue;
            }
            match *strip.sides.of_owner(e) {
                [_] => ends.iter().for_each(|&v| tie(v)),
                [f, g] if self.is_sharp(f, g) => sharp.push((ends, [f, g])),
                _ => {}
            }
        }
        let mut count = vec![0u32; strip.vertices.len()];
        sharp.iter().flat_map(|(ends, _)| ends.iter()).for_each(|&v| count[v as usize] += 1);
        // A single sharp edge is noise.
        for (_, faces) in sharp.iter().filter(|(ends, _)| ends.iter().any(|&v| count[v as usize] > 1)) {
            faces.iter().flat_map(|&f| strip.face(f)).for_each(|&v| tie(v));
        }
        tied
    }

    /// Whether face `f` is in a narrow place: no vertex inside its part is next to a corner of it.
    fn is_narrow(&self, f: u32) -> bool {
        let strip = self.strip;
        let own = Some(strip.labels[f as usize]);
        let inside = |&v: &u32| strip.inner[v as usize] == own;
        !strip.face(f).iter().any(|&v| strip.stars.of_owner(v).iter().any(|&g| strip.face(g).iter().any(inside)))
    }

    /// Whether the edge between two faces is a boundary and sharp.
    fn is_sharp(&self, f: u32, g: u32) -> bool {
        let strip = self.strip;
        let [Some(a), Some(b)] = [f, g].map(|f| strip.triangle(f)) else { return false };
        let [n, m] = [a, b].map(|corners| unit(double_area(corners.map(|v| strip.at[v as usize]))));
        // Faces of opposite winding traverse their edge in the same direction.
        let run = |[a, b, c]: [u32; 3]| [[a, b], [b, c], [c, a]];
        let against = run(a).iter().any(|half| run(b).contains(half));
        let cosine = if against { -dot(n, m) } else { dot(n, m) };
        strip.labels[f as usize] != strip.labels[g as usize] && n != [0.; 3] && m != [0.; 3] && cosine < CREASE
    }

    /// Assigns labels to the boundary vertices that are not `tied`, so that each is connected to the inside of its
    /// part.
    fn begin(&mut self, tied: &[bool]) {
        let strip = self.strip;
        let open: Vec<u32> = (0..strip.vertices.len() as u32)
            .filter(|&v| strip.inner[v as usize].is_none() && !tied[v as usize])
            .collect();
        for &v in &open {
            self.label[v as usize] = self.shares(v).first().map(|&(label, _)| label);
        }
        // Joined: reached from the inside of the part through vertices of its label.
        let mut joined: Vec<bool> = strip.inner.iter().map(Option::is_some).collect();
        let mut queue: Vec<u32> = (0..joined.len() as u32).filter(|&v| joined[v as usize]).collect();
        for _ in 0..=ROUNDS {
            while let Some(v) = queue.pop() {
                for &w in strip.stars.of_owner(v).iter().flat_map(|&f| strip.face(f)) {
                    if !joined[w as usize] && self.label[w as usize] == self.label[v as usize] {
                        joined[w as usize] = true;
                        queue.push(w);
                    }
                }
            }
            for &v in &open {
                let beside = |label: u32| {
                    let mut near = strip.stars.of_owner(v).iter().flat_map(|&f| strip.face(f));
                    near.any(|&w| joined[w as usize] && self.label[w as usize] == Some(label))
                };
                if !joined[v as usize]
                    && let Some(&(label, _)) = self.shares(v).iter().find(|&&(label, _)| beside(label))
                {
                    (self.label[v as usize], joined[v as usize]) = (Some(label), true);
                    queue.push(v);
                }
            }
        }
        open.iter().filter(|&&v| !joined[v as usize]).for_each(|&v| self.label[v as usize] = None);
    }

    /// The labels around a vertex with their shares of the angle, greatest first.
    fn shares(&self, v: u32) -> Vec<(u32, f64)> {
        let strip = self.strip;
        let mut shares: Vec<(u32, f64)> = Vec::new();
        for &f in strip.stars.of_owner(v) {
            let Some(corners) = strip.triangle(f) else { continue };
            let Some(k) = corners.iter().position(|&w| w == v) else { continue };
            let [a, b] = [1, 2].map(|j| minus(strip.at[corners[(k + j) % 3] as usize], strip.at[v as usize]));
            let angle = length(cross(a, b)).atan2(dot(a, b));
            let angle = if angle.is_finite() { angle } else { 0. };
            add_weight(&mut shares, strip.labels[f as usize], angle);
        }
        sort_by(&mut shares, |a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
        shares
    }

    /// Where an edge is crossed.
    #[inline]
    fn point(&self, e: u32) -> [f64; 3] {
        let [a, b] = self.strip.edges[e as usize].map_each(|v| self.strip.at[v as usize]);
        add_scaled(a, self.along[e as usize], minus(b, a))
    }

    /// Where the boundary that crosses edge `e` leaves the face `f`.
    fn beyond(&self, e: u32, f: u32) -> Option<[f64; 3]> {
        let strip = self.strip;
        let corners = strip.triangle(f)?;
        let edges: [u32; 3] = strip.edge_of[strip.range(f)].try_into().ok()?;
        let k = edges.iter().position(|&own| own == e)?;
        let opposite = corners[(k + 2) % 3];
        if self.label[opposite as usize].is_none() {
            return Some(strip.at[opposite as usize]);
        }
        let crossing = |e: u32| self.is_crossed(e).then(|| self.point(e));
        match (crossing(edges[(k + 1) % 3]), crossing(edges[(k + 2) % 3])) {
            (Some(p), Some(q)) => {
                let all = [self.point(e), p, q];
                Some(mixed(all, meeting(all)))
            }
            (p, q) => p.or(q),
        }
    }

    /// Moves the crossing of an edge to where the boundary there is shortest.
    fn shorten(&mut self, e: u32) {
        let strip = self.strip;
        let [a, b] = strip.edges[e as usize];
        let (from, way) = (strip.at[a as usize], minus(strip.at[b as usize], strip.at[a as usize]));
        let all = length(way);
        let here = self.point(e);
        // The foot point on the edge and the distance from its line, for all points that the crossing is connected to.
        let joined = strip.sides.of_owner(e).iter().filter_map(|&f| {
            let to = self.beyond(e, f)?;
            let foot = dot(minus(to, from), way) / (all * all);
            Some((foot, distance(add_scaled(from, foot, way), to), distance(here, to)))
        });
        let ends: Vec<(f64, f64, f64)> = joined.collect();
        let (mut sum, mut weights) = (0., 0.);
        for &(foot, height, far) in &ends {
            // With two neighbours, the straight line after unfolding both sides into a plane; else one Weiszfeld step.
            let weight = if ends.len() == 2 { 1. / height.max(1e-9 * all) } else { 1. / far.max(1e-9 * all) };
            (sum, weights) = (sum + weight * foot, weights + weight);
        }
        let farthest = |v: u32| if strip.inner[v as usize].is_some() { FARTHEST } else { 1. };
        let best = sum / weights;
        if best.is_finite() {
            self.along[e as usize] = best.clamp(1. - farthest(a), farthest(b));
        }
    }

    /// Lets each vertex that the boundary rests against change sides once; returns whether any did.
    fn change_sides(&mut self, moved: &mut [bool]) -> bool {
        let strip = self.strip;
        let mut any = false;
        for v in 0..strip.vertices.len() as u32 {
            if strip.inner[v as usize].is_some() || moved[v as usize] {
                continue;
            }
            if let Some(label) = self.other_side(v) {
                self.label[v as usize] = Some(label);
                (moved[v as usize], any) = (true, true);
                for e in self.edges_at(v).filter(|&e| self.is_crossed(e)).collect::<Vec<_>>() {
                    let first = strip.edges[e as usize][0] == v;
                    self.along[e as usize] = if first { SNAP } else { 1. - SNAP };
                }
            }
        }
        any
    }

    /// The edges at a vertex; most of them appear twice.
    fn edges_at(&self, v: u32) -> impl Iterator<Item = u32> + '_ {
        let strip = self.strip;
        let all = strip.stars.of_owner(v).iter().flat_map(|&f| &strip.edge_of[strip.range(f)]);
        all.copied().filter(move |&e| strip.edges[e as usize].contains(&v))
    }

    /// The label that vertex `v` gets if it changes sides: `None` unless a boundary of two parts passes it exactly once
    /// and rests against it.
    fn other_side(&self, v: u32) -> Option<u32> {
        let strip = self.strip;
        let own = self.label[v as usize]?;
        let (mut other, mut changes) = (None, 0);
        for &f in strip.stars.of_owner(v) {
            let around = strip.triangle(f)?.into_iter().filter(|&w| w != v);
            let mut met = [None; 2];
            for (slot, w) in met.iter_mut().zip(around) {
                let label = self.label[w as usize]?;
                if label != own && *other.get_or_insert(label) != label {
                    return None;
                }
                *slot = Some(label);
            }
            changes += usize::from(met[0] != met[1]);
        }
        let mut crossed = self.edges_at(v).filter(|&e| self.is_crossed(e));
        let rests = crossed.all(|e| {
            let t = self.along[e as usize];
            (if strip.edges[e as usize][0] == v { t } else { 1. - t }) < RESTS
        });
        other.filter(|_| changes == 2 && rests)
    }
}

/// The mean of three points with `weights` of sum 1.
pub(super) fn mixed(points: [[f64; 3]; 3], weights: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|axis| (0..3).map(|k| weights[k] * points[k][axis]).sum())
}

/// The barycentric weights, relative to the crossings of a triangle's three edges, of the point where three parts meet
/// in it: approximately the point with the least sum of distances to them.
pub(super) fn meeting(crossings: [[f64; 3]; 3]) -> [f64; 3] {
    let mut weights = [1. / 3.; 3];
    for _ in 0..STEPS {
        let at = mixed(crossings, weights);
        let pull = crossings.map(|q| 1. / distance(at, q));
        let sum: f64 = pull.iter().sum();
        if !sum.is_finite() || sum <= 0. {
            break;
        }
        weights = pull.map(|x| x / sum);
    }
    weights
}
