//! Rigid motions of points with normals, and the motion that fits best to given pairs of points.
//!
//! Angles are exact on all machines: sines come from `libm`. Cost: some tens of operations for a point or a pair.

use crate::base::vector::{add_scaled, cross, dot, length, minus, unit};
use crate::cluster::mirror::SurfacePoint;

/// The cosine below which two directions are opposite: no rotation between them is the least.
const OPPOSITE: f64 = -0.999;

/// A point, and where a motion should take it.
#[derive(Clone, Copy, Debug)]
pub struct PointPair {
    /// The point.
    pub from: [f64; 3],
    /// Its goal.
    pub to: [f64; 3],
    /// How much it counts.
    pub weight: f64,
}

/// A rotation about one point, which is then taken to another: x ↦ to + R (x − from).
#[derive(Clone, Copy, Debug)]
pub struct RigidMotion {
    /// The rows of R.
    rotation: [[f64; 3]; 3],
    from: [f64; 3],
    to: [f64; 3],
}

impl RigidMotion {
    /// The motion with the least rotation that takes one point to another, and the unit vector `along` one to `onto`.
    /// `None` if these are opposite.
    pub fn between(from: [f64; 3], along: [f64; 3], to: [f64; 3], onto: [f64; 3]) -> Option<Self> {
        let (axis, cos) = (cross(along, onto), dot(along, onto));
        // R v = cos v + axis × v + axis (axis · v) / (1 + cos).
        let image = |v: [f64; 3]| {
            let turned = add_scaled(v.map(|x| cos * x), 1., cross(axis, v));
            add_scaled(turned, dot(axis, v) / (1. + cos), axis)
        };
        (cos > OPPOSITE).then(|| Self { rotation: rows(image), from, to })
    }

    /// The motion, followed by a rotation by `angle` about a unit vector through the image of `from`.
    pub fn turned(self, about: [f64; 3], angle: f64) -> Self {
        let turn = turn(about, angle);
        Self { rotation: rows(|v| turn(self.rotated(v))), ..self }
    }

    fn rotated(&self, v: [f64; 3]) -> [f64; 3] {
        self.rotation.map(|row| dot(row, v))
    }

    /// Where a point and its normal go.
    pub fn image(&self, point: SurfacePoint) -> SurfacePoint {
        let position = add_scaled(self.to, 1., self.rotated(minus(point.position, self.from)));
        SurfacePoint { position, normal: self.rotated(point.normal) }
    }

    /// The motion after one Gauss–Newton step towards the least sum of weight × squared distance between the images of
    /// points and their goals. `None` if the pairs do not determine it.
    pub fn improved(&self, pairs: &[PointPair]) -> Option<Self> {
        let total: f64 = pairs.iter().map(|pair| pair.weight).sum();
        let mean = |of: fn(&PointPair) -> [f64; 3]| {
            pairs.iter().fold([0.; 3], |sum, pair| add_scaled(sum, pair.weight / total, of(pair)))
        };
        let (from, to) = (mean(|pair| pair.from), mean(|pair| pair.to));
        // The rotation vector ω with Σ w (|a|² − a aᵀ) ω = Σ w a × b, a and b from the means.
        let (mut matrix, mut moment) = ([[0.; 3]; 3], [0.; 3]);
        for pair in pairs {
            let (weight, a, b) = (pair.weight, self.rotated(minus(pair.from, from)), minus(pair.to, to));
            for (i, row) in matrix.iter_mut().enumerate() {
                *row = add_scaled(*row, -weight * a[i], a);
                row[i] += weight * dot(a, a);
            }
            moment = add_scaled(moment, weight, cross(a, b));
        }
        let vector = solved(matrix, moment)?;
        let moved = Self { from, to, ..*self };
        let angle = length(vector);
        angle.is_finite().then(|| if angle > 0. { moved.turned(unit(vector), angle) } else { moved })
    }
}

/// The rotation of vectors by `angle` about a unit vector.
pub fn turn(about: [f64; 3], angle: f64) -> impl Fn([f64; 3]) -> [f64; 3] {
    // The system's sine may differ between processors.
    let (sin, cos) = libm::sincos(angle);
    move |v| {
        let up = dot(v, about);
        let flat = add_scaled(v, -up, about).map(|x| x * cos);
        add_scaled(add_scaled(flat, sin, cross(about, v)), up, about)
    }
}

/// The rows of the matrix of a linear map.
fn rows(map: impl Fn([f64; 3]) -> [f64; 3]) -> [[f64; 3]; 3] {
    let [x, y, z] = [map([1., 0., 0.]), map([0., 1., 0.]), map([0., 0., 1.])];
    [0, 1, 2].map(|i| [x[i], y[i], z[i]])
}

/// x with `matrix` x = `right`, for a symmetric matrix; `None` if it is singular.
fn solved([a, b, c]: [[f64; 3]; 3], right: [f64; 3]) -> Option<[f64; 3]> {
    let inverse = [cross(b, c), cross(c, a), cross(a, b)];
    let determinant = dot(a, inverse[0]);
    let largest = [a, b, c].map(length).into_iter().fold(0., f64::max);
    let is_regular = determinant.abs() > 1e-9 * largest.powi(3);
    is_regular.then(|| inverse.map(|column| dot(column, right) / determinant))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::{stream, unit as uniform};
    use crate::base::vector::distance;

    fn near(a: [f64; 3], b: [f64; 3]) -> bool {
        distance(a, b) < 1e-9
    }

    #[test]
    fn one_direction_is_taken_to_another() {
        let (along, onto) = (unit([1., 2., -1.]), unit([-0.3, 1., 2.]));
        let motion = RigidMotion::between([1., 0., 0.], along, [0., 5., 0.], onto).unwrap();
        let start = SurfacePoint { position: add_scaled([1., 0., 0.], 2., along), normal: along };
        for angle in [0., 1., 4.] {
            let image = motion.turned(onto, angle).image(start);
            assert!(near(image.normal, onto) && near(image.position, add_scaled([0., 5., 0.], 2., onto)));
        }
        let quarter = motion.turned(onto, std::f64::consts::FRAC_PI_2);
        let across = unit(cross(along, [0., 0., 1.]));
        let [before, after] =
            [motion, quarter].map(|motion| motion.image(SurfacePoint { normal: across, ..start }).normal);
        assert!(near(after, cross(onto, before)));
        assert!(RigidMotion::between([0.; 3], along, [0.; 3], along.map(|x| -x)).is_none());
    }

    #[test]
    fn steps_lead_to_the_motion_of_the_pairs() {
        let mut random = stream(1, "test");
        let mut point = || [0; 3].map(|_| uniform(&mut random) - 0.5);
        let truth = RigidMotion::between(point(), unit(point()), point(), unit([0.2, 1., 0.1])).unwrap();
        let truth = truth.turned(unit([0.2, 1., 0.1]), 0.3);
        let image = |motion: &RigidMotion, x| motion.image(SurfacePoint { position: x, normal: [0.; 3] }).position;
        let pairs: Vec<_> = (0..9)
            .map(|_| point())
            .map(|from| PointPair { from, to: image(&truth, from), weight: 1. + from[0] })
            .collect();
        let mut found = truth.turned(unit([1., -1., 0.4]), 0.6);
        for _ in 0..6 {
            found = found.improved(&pairs).unwrap();
        }
        assert!(pairs.iter().all(|pair| near(image(&found, pair.from), pair.to)));
        // Points in a line do not determine a motion, nor does none.
        let on_line = |x| PointPair { from: [x, 0., 0.], to: [0., x, 0.], weight: 1. };
        let line = [0., 1., 2., 3.].map(on_line);
        assert!(found.improved(&line).is_none() && found.improved(&[]).is_none());
    }
}
