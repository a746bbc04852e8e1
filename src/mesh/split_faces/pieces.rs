//! A triangle cut where boundaries cross it. Time and memory are constant per triangle.

use crate::base::vector::{distance, double_area, length};

/// A triangle and its crossings. Points are numbered, corners included.
pub(super) struct Cut {
    /// Its corners.
    pub corners: [u32; 3],
    /// Their labels; `None` where the boundary passes through.
    pub labels: [Option<u32>; 3],
    /// The point, if any, where the edge from each corner to the next is crossed; a corner if the crossing is at an
    /// end.
    pub crossings: [Option<u32>; 3],
    /// The point where three parts meet, if they do.
    pub centre: Option<u32>,
}

impl Cut {
    /// The pieces as convex polygons with labels, without repeated points, wound like the triangle, which they cover.
    fn polygons(&self) -> Vec<(u32, Vec<u32>)> {
        let mut polygons = Vec::new();
        if let Some(centre) = self.centre {
            for k in 0..3 {
                let (Some(label), Some(before), Some(after)) =
                    (self.labels[k], self.crossings[(k + 2) % 3], self.crossings[k])
                else {
                    continue;
                };
                polygons.push((label, distinct(&[centre, before, self.corners[k], after])));
            }
        } else {
            let mut labels: Vec<u32> = self.labels.iter().flatten().copied().collect();
            labels.sort_unstable();
            labels.dedup();
            for label in labels {
                let mut points = Vec::new();
                for k in 0..3 {
                    points.extend(Some(self.corners[k]).filter(|_| self.labels[k].is_none_or(|own| own == label)));
                    points.extend(self.crossings[k]);
                }
                polygons.push((label, distinct(&points)));
            }
        }
        polygons.retain(|(_, points)| points.len() >= 3);
        polygons
    }

    /// The pieces as triangles with labels, largest first; `at` gives the position of a point.
    pub fn triangles(&self, at: impl Fn(u32) -> [f64; 3]) -> Vec<(u32, [u32; 3])> {
        let mut all = Vec::new();
        for (label, points) in self.polygons() {
            match points[..] {
                [a, b, c, d] => {
                    let ways = [[[a, b, c], [a, c, d]], [[a, b, d], [b, c, d]]];
                    // Two corners share an edge of the triangle, which may be cut.
                    let edge = |a, b| self.corners.contains(&a) && self.corners.contains(&b);
                    // Where three parts meet, a fan from that point: the polygon may have a notch there.
                    let second = self.centre.is_none()
                        && !edge(b, d)
                        && (edge(a, c) || worst(ways[1], &at) > worst(ways[0], &at));
                    all.extend(ways[usize::from(second)].map(|corners| (label, corners)));
                }
                [a, b, c] => all.push((label, [a, b, c])),
                _ => {}
            }
        }
        let area = |corners: &[u32; 3]| length(double_area(corners.map(&at)));
        let mut largest = 0;
        for k in 1..all.len() {
            if area(&all[k].1) > area(&all[largest].1) {
                largest = k;
            }
        }
        if !all.is_empty() {
            all.swap(0, largest);
        }
        all
    }
}

/// `points` without repetitions of cyclic neighbours.
fn distinct(points: &[u32]) -> Vec<u32> {
    let mut kept = points.to_vec();
    kept.dedup();
    while kept.len() > 1 && kept.first() == kept.last() {
        kept.pop();
    }
    kept
}

/// The height of the flatter of two triangles over its longest side, relative to that side.
fn worst(triangles: [[u32; 3]; 2], at: &impl Fn(u32) -> [f64; 3]) -> f64 {
    let shape = |corners: [u32; 3]| {
        let [a, b, c] = corners.map(at);
        let longest = distance(a, b).max(distance(b, c)).max(distance(c, a));
        length(double_area([a, b, c])) / (longest * longest)
    };
    shape(triangles[0]).min(shape(triangles[1]))
}
