//! Makes few triangles of many: pieces of faces lose every vertex that neither the mesh nor a boundary needs.
//!
//! A vertex is removed with the triangles around it, and each label's part of the hole is filled with triangles again.
//! All tests are made in barycentric coordinates of the triangle that the pieces lie on, where points on its sides are
//! exactly so, whatever its shape. New triangles have the winding of the old ones, and together their outline; so they
//! cover what these covered, once. On a side, a vertex is removed for all faces at once or not at all: no T-junctions.
//!
//! Cost: a microsecond or two per vertex.

use crate::base::tally::add_weight;
use crate::base::vector::{distance, double_area, length, triangle_distance};

/// Pieces below this share of twice the area of their triangle count as flat.
const FLAT: f64 = 1e-12;
/// How far a boundary may move, as a share of the mean distance of its vertices.
const SLACK: f64 = 0.1;
/// Most triangles around a vertex that is removed.
const MOST: usize = 64;
/// Most passes over all vertices; what cannot be removed in one may be in the next.
const PASSES: usize = 8;

/// A point of the surface: the weighted mean of one to three vertices of the mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Place {
    /// The vertices, ascending; beyond the number of them the last one again.
    pub of: [u32; 3],
    /// Their weights, of sum 1; 0 beyond their number.
    pub weights: [f64; 3],
    /// Their number: 1 at a vertex, 2 on an edge, 3 within a triangle.
    pub count: usize,
}

impl Place {
    /// At a vertex.
    pub fn vertex(v: u32) -> Self {
        Self { of: [v; 3], weights: [1., 0., 0.], count: 1 }
    }

    /// The weighted mean of several places; `None` if it is one of more than three vertices, or of none.
    pub fn mean(parts: impl IntoIterator<Item = (Self, f64)>) -> Option<Self> {
        let mut all: Vec<(u32, f64)> = Vec::with_capacity(4);
        for (place, share) in parts {
            for (v, weight) in place.of.into_iter().zip(place.weights).take(place.count) {
                add_weight(&mut all, v, share * weight);
            }
        }
        all.retain(|own| own.1 != 0.);
        all.sort_by_key(|own| own.0);
        let last = all.last().filter(|_| all.len() <= 3)?.0;
        let get = |k: usize| all.get(k).copied().unwrap_or((last, 0.));
        Some(Self { of: [0, 1, 2].map(|k| get(k).0), weights: [0, 1, 2].map(|k| get(k).1), count: all.len() })
    }

    /// Its weights at the three vertices `of`.
    pub fn within(&self, of: [u32; 3]) -> [f64; 3] {
        of.map(|v| (0..self.count).find(|&k| self.of[k] == v).map_or(0., |k| self.weights[k]))
    }
}

/// A piece.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Triangle {
    /// The face of the mesh.
    pub face: u32,
    /// Which of [`Pieces::units`] it lies on.
    pub unit: u32,
    /// Its label.
    pub label: u32,
    /// Its corners, places.
    pub corners: [u32; 3],
}

/// Pieces of faces, which cover them without T-junctions.
#[derive(Default)]
pub(super) struct Pieces {
    /// The places of their corners; vertices of the mesh first, then those that are better removed late.
    pub places: Vec<Place>,
    /// Their positions.
    pub at: Vec<[f64; 3]>,
    /// The pieces; `None` once removed.
    pub triangles: Vec<Option<Triangle>>,
    /// The triangles of the mesh that pieces lie on: a face, or one of those that a polygon consists of.
    pub units: Vec<[u32; 3]>,
}

/// The triangles around a vertex that lie on one unit and have one label.
struct Sector {
    like: Triangle,
    /// Their outline without the vertex, wound as they are.
    outline: Vec<u32>,
    /// Whether it surrounds the vertex.
    closed: bool,
}

impl Pieces {
    /// Removes what is not needed, in place.
    pub fn coalesce(&mut self) {
        let mut stars: Vec<Vec<u32>> = vec![Vec::new(); self.places.len()];
        for (t, triangle) in (0..).zip(&self.triangles) {
            triangle.iter().flat_map(|triangle| triangle.corners).for_each(|v| stars[v as usize].push(t));
        }
        let removable = self.removable(&stars);
        let mut left: Vec<u32> = (0..removable.len() as u32).rev().filter(|&v| removable[v as usize]).collect();
        for _ in 0..PASSES {
            let before = left.len();
            left.retain(|&v| !self.remove(v, &mut stars));
            if left.len() == before {
                break;
            }
        }
    }

    /// Which vertices neither the mesh nor a boundary needs.
    fn removable(&self, stars: &[Vec<u32>]) -> Vec<bool> {
        let mut removable = vec![false; self.places.len()];
        let mut bends: Vec<Option<[u32; 2]>> = vec![None; self.places.len()];
        for (v, star) in stars.iter().enumerate().filter(|(v, _)| self.places[*v].count > 1) {
            let mut kinds: Vec<(u32, u32)> = self.around(star).map(|own| (own.unit, own.label)).collect();
            kinds.sort_unstable();
            kinds.dedup();
            removable[v] = kinds.windows(2).all(|two| two[0].0 != two[1].0);
            if !removable[v] && self.places[v].count == 3 {
                bends[v] = self.neighbours_on_boundary(v as u32, star);
            }
        }
        let mut seen = vec![false; bends.len()];
        for v in 0..bends.len() as u32 {
            if bends[v as usize].is_some() && !seen[v as usize] {
                let curve = curve(v, &bends);
                curve.iter().for_each(|&v| seen[v as usize] = true);
                self.straighten(&curve, &mut removable);
            }
        }
        removable
    }

    fn around<'a>(&'a self, star: &'a [u32]) -> impl Iterator<Item = &'a Triangle> + 'a {
        star.iter().filter_map(|&t| self.triangles[t as usize].as_ref())
    }

    /// The two neighbours of a vertex within a triangle on the boundary that passes through it; `None` if there are not
    /// two.
    fn neighbours_on_boundary(&self, v: u32, star: &[u32]) -> Option<[u32; 2]> {
        let mut spokes: Vec<(u32, u32)> = self
            .around(star)
            .flat_map(|own| own.corners.into_iter().filter(|&w| w != v).map(|w| (w, own.label)))
            .collect();
        spokes.sort_unstable();
        let apart = spokes.chunk_by(|a, b| a.0 == b.0).filter(|spoke| spoke.iter().any(|own| own.1 != spoke[0].1));
        let found: Vec<u32> = apart.map(|spoke| spoke[0].0).collect();
        found.try_into().ok()
    }

    /// Marks the inner vertices of a boundary `curve` that it does not need to stay where it is, by the method of
    /// Douglas and Peucker.
    fn straighten(&self, curve: &[u32], removable: &mut [bool]) {
        let at = |k: usize| self.at[curve[k] as usize];
        let long: f64 = (1..curve.len()).map(|k| distance(at(k - 1), at(k))).sum();
        let slack = SLACK * long / (curve.len() - 1).max(1) as f64;
        let mut open = vec![(0, curve.len() - 1)];
        while let Some((first, last)) = open.pop() {
            let off = |k: usize| triangle_distance([at(first), at(last), at(last)], at(k));
            let inner = (first + 1..last).map(|k| (k, off(k)));
            let Some((k, far)) = inner.max_by(|a, b| a.1.total_cmp(&b.1)) else { continue };
            if far <= slack {
                (first + 1..last).for_each(|k| removable[curve[k] as usize] = true);
            } else {
                open.extend([(first, k), (k, last)]);
            }
        }
    }

    /// Removes vertex `v`, if the hole can be filled.
    fn remove(&mut self, v: u32, stars: &mut [Vec<u32>]) -> bool {
        let star = std::mem::take(&mut stars[v as usize]);
        let Some(new) = self.filled(v, &star) else {
            stars[v as usize] = star;
            return false;
        };
        for &t in &star {
            if let Some(old) = self.triangles[t as usize].take() {
                old.corners.iter().for_each(|&w| stars[w as usize].retain(|&other| other != t));
            }
        }
        // As many triangles as before, or fewer.
        for (t, triangle) in star.into_iter().zip(new) {
            triangle.corners.iter().for_each(|&w| stars[w as usize].push(t));
            self.triangles[t as usize] = Some(triangle);
        }
        true
    }

    /// The triangles that replace those of the `star` around vertex `v`.
    fn filled(&self, v: u32, star: &[u32]) -> Option<Vec<Triangle>> {
        if star.len() > MOST {
            return None;
        }
        let mut all: Vec<Triangle> = self.around(star).copied().collect();
        all.sort_unstable_by_key(|own| (own.unit, own.label, own.corners));
        let sectors = all.chunk_by(|a, b| (a.unit, a.label) == (b.unit, b.label)).map(|own| sector(v, own));
        let sectors: Vec<Sector> = sectors.collect::<Option<_>>()?;
        let within = self.places[v as usize].count == 3;
        let fits = match &sectors[..] {
            [whole] if within => whole.closed,
            [one, other] if within => {
                let ends = |sector: &Sector| (sector.outline.first().copied(), sector.outline.last().copied());
                let ((a, b), (c, d)) = (ends(one), ends(other));
                !one.closed && !other.closed && a == d && b == c
            }
            all => !within && all.iter().all(|sector| !sector.closed),
        };
        if !fits {
            return None;
        }
        let mut new = Vec::with_capacity(star.len());
        for Sector { like, outline, .. } in &sectors {
            let filling = self.triangulated(outline, like.unit)?;
            new.extend(filling.into_iter().map(|corners| Triangle { corners, ..*like }));
        }
        (new.len() <= star.len()).then_some(new)
    }

    /// A polygon on a unit as triangles, by cutting off the best shaped ears first; `None` if that does not work out.
    fn triangulated(&self, outline: &[u32], unit: u32) -> Option<Vec<[u32; 3]>> {
        let of = self.units[unit as usize];
        let within: Vec<[f64; 3]> = outline.iter().map(|&v| self.places[v as usize].within(of)).collect();
        let turn = |[a, b, c]: [usize; 3]| turn([within[a], within[b], within[c]]);
        let mut left: Vec<usize> = (0..outline.len()).collect();
        let mut all = Vec::with_capacity(outline.len());
        // Units are wound as their pieces.
        while left.len() > 3 {
            let mut best: Option<(f64, usize)> = None;
            for k in 0..left.len() {
                let [a, b, c] = ear(&left, k);
                if turn([a, b, c]) <= FLAT {
                    continue;
                }
                let covers = |&p: &usize| {
                    ![a, b, c].contains(&p) && [[a, b, p], [b, c, p], [c, a, p]].into_iter().all(|way| turn(way) >= 0.)
                };
                let shape = self.shape([a, b, c].map(|k| outline[k]));
                if best.is_none_or(|(most, _)| shape > most) && !left.iter().any(covers) {
                    best = Some((shape, k));
                }
            }
            let k = best?.1;
            all.push(ear(&left, k).map(|k| outline[k]));
            left.remove(k);
        }
        let last = left.try_into().ok().filter(|last| turn(*last) > FLAT)?;
        all.push(last.map(|k| outline[k]));
        Some(all)
    }

    /// The height of a triangle over its longest side, relative to that side; 0 if it has no area.
    fn shape(&self, corners: [u32; 3]) -> f64 {
        let [a, b, c] = corners.map(|v| self.at[v as usize]);
        let longest = distance(a, b).max(distance(b, c)).max(distance(c, a));
        let shape = length(double_area([a, b, c])) / (longest * longest);
        if shape.is_finite() { shape } else { 0. }
    }
}

/// The corner `k` of a polygon and those beside it.
fn ear(polygon: &[usize], k: usize) -> [usize; 3] {
    let n = polygon.len();
    [polygon[(k + n - 1) % n], polygon[k], polygon[(k + 1) % n]]
}

/// Twice the area of a triangle in barycentric coordinates; exactly 0 if all are on one side of the unit.
pub(super) fn turn([a, b, c]: [[f64; 3]; 3]) -> f64 {
    a[0] * (b[1] * c[2] - b[2] * c[1]) - b[0] * (a[1] * c[2] - a[2] * c[1]) + c[0] * (a[1] * b[2] - a[2] * b[1])
}

/// The outline of the triangles `own` around `v`; `None` unless it is one line.
fn sector(v: u32, own: &[Triangle]) -> Option<Sector> {
    let mut sides = Vec::with_capacity(own.len());
    for triangle in own {
        let k = triangle.corners.iter().position(|&w| w == v)?;
        sides.push([1, 2].map(|j| triangle.corners[(k + j) % 3]));
    }
    let first = sides.iter().position(|side| sides.iter().all(|other| other[1] != side[0]));
    let start = sides[first.unwrap_or(0)][0];
    let mut outline = vec![start];
    while let Some(k) = sides.iter().position(|side| Some(&side[0]) == outline.last()) {
        outline.push(sides.swap_remove(k)[1]);
    }
    let closed = outline.len() > 1 && outline.last() == Some(&start);
    if closed {
        outline.pop();
    }
    (sides.is_empty() && outline.len() > 2).then_some(Sector { like: own[0], outline, closed })
}

/// The boundary through `v`, along vertices with two neighbours on it, from one end to the other; of a closed one,
/// from a vertex around to the one before it.
fn curve(v: u32, bends: &[Option<[u32; 2]>]) -> Vec<u32> {
    let mut line = vec![v];
    for way in 0..2 {
        while let [.., last] = line[..]
            && let Some(next) = bends[last as usize]
        {
            let before = line.len().checked_sub(2).map(|k| line[k]);
            let onward = match before {
                None => next[way],
                Some(before) if next[0] == before => next[1],
                Some(_) => next[0],
            };
            if onward == v || line.len() > bends.len() {
                return line;
            }
            line.push(onward);
        }
        line.reverse();
    }
    line
}
