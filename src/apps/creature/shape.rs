//! The creature's body as an implicit surface: round limbs around spines, softly joined.
//!
//! A *spine* is a line segment with a varying radius; a *part* is a smooth union of spines; the creature is the union
//! of its parts with a fillet of [`FILLET`] where two of them meet. The surface is where [`Shape::whole`] is zero,
//! negative inside. The points equally near to two parts form the bottom of the valley between them: the border of the
//! true segmentation. Units are arbitrary; the creature is about 4 long. Cost: some 10 ns per spine and evaluation.

use nalgebra::Vector3;

/// A point or a vector.
pub(super) type Vec3 = Vector3<f64>;

/// Names of the parts; a part's label is its index here.
pub(super) const NAMES: [&str; 10] = [
    "body",
    "neck",
    "head",
    "left ear",
    "right ear",
    "left foreleg",
    "right foreleg",
    "left hind leg",
    "right hind leg",
    "tail",
];

/// Width of the fillet between parts: their distance fields blend where they differ by less.
pub(super) const FILLET: f64 = 0.04;

/// Width of the blend between the spines of one part.
const BLEND: f64 = 0.03;

/// A value and its gradient.
#[derive(Clone, Copy, Debug)]
pub(super) struct Field {
    pub value: f64,
    pub gradient: Vec3,
}

/// The smooth minimum of two fields (quadratic, once continuously differentiable).
#[inline]
fn join(a: Field, b: Field, width: f64) -> Field {
    let (low, high) = if a.value <= b.value { (a, b) } else { (b, a) };
    let h = 1.0 - (high.value - low.value) / width;
    if h <= 0.0 {
        return low;
    }
    Field {
        value: low.value - 0.25 * width * h * h,
        gradient: low.gradient + (high.gradient - low.gradient) * (0.5 * h),
    }
}

/// A segment with a radius that changes smoothly from one end to the other.
#[derive(Clone, Debug)]
struct Spine {
    start: Vec3,
    along: Vec3,
    inverse: f64,
    radius: f64,
    growth: f64,
}

impl Spine {
    fn new(start: [f64; 3], radius: f64, end: [f64; 3], end_radius: f64) -> Self {
        let start = Vec3::from(start);
        let along = Vec3::from(end) - start;
        Self { start, along, inverse: 1.0 / along.norm_squared(), radius, growth: end_radius - radius }
    }

    #[inline]
    fn field(&self, x: &Vec3) -> Field {
        let w = x - self.start;
        let t = (w.dot(&self.along) * self.inverse).clamp(0.0, 1.0);
        let out = w - self.along * t;
        let length = out.norm().max(1e-12);
        let slope = 6.0 * t * (1.0 - t) * self.growth;
        Field {
            value: length - self.radius - t * t * (3.0 - 2.0 * t) * self.growth,
            gradient: out / length - self.along * (slope * self.inverse),
        }
    }
}

/// A set of parts, one bit each.
pub(super) type PartSet = u16;

/// Every part.
#[cfg(test)]
pub(super) const ALL: PartSet = (1 << NAMES.len()) - 1;

/// The creature as an implicit surface.
#[derive(Clone, Debug)]
pub(super) struct Shape {
    parts: Vec<Vec<Spine>>,
}

impl Shape {
    /// The quadruped: x forward, y to its left, z up.
    pub fn quadruped() -> Self {
        let chain = |points: &[([f64; 3], f64)]| -> Vec<Spine> {
            points.windows(2).map(|w| Spine::new(w[0].0, w[0].1, w[1].0, w[1].1)).collect()
        };
        let leg = |x: f64, side: f64, bend: f64| {
            chain(&[
                ([x, 0.29 * side, -0.24], 0.20),
                ([x + bend, 0.31 * side, -0.66], 0.15),
                ([x - 0.4 * bend, 0.32 * side, -1.12], 0.13),
                ([x - 0.4 * bend + 0.09, 0.32 * side, -1.14], 0.135),
            ])
        };
        let ear = |side: f64| {
            chain(&[
                ([1.30, 0.17 * side, 1.06], 0.085),
                ([1.17, 0.34 * side, 1.36], 0.105),
                ([1.10, 0.43 * side, 1.52], 0.08),
            ])
        };
        Self {
            parts: vec![
                chain(&[([-0.74, 0.0, 0.02], 0.40), ([0.0, 0.0, -0.02], 0.41), ([0.72, 0.0, 0.04], 0.44)]),
                chain(&[([0.86, 0.0, 0.22], 0.25), ([1.30, 0.0, 0.80], 0.185)]),
                chain(&[([1.36, 0.0, 0.90], 0.30), ([1.80, 0.0, 0.76], 0.17)]),
                ear(1.0),
                ear(-1.0),
                leg(0.66, 1.0, -0.04),
                leg(0.66, -1.0, -0.04),
                leg(-0.70, 1.0, 0.08),
                leg(-0.70, -1.0, 0.08),
                chain(&[
                    ([-1.02, 0.0, 0.16], 0.13),
                    ([-1.40, 0.0, 0.30], 0.11),
                    ([-1.70, 0.0, 0.28], 0.105),
                    ([-1.96, 0.0, 0.16], 0.09),
                ]),
            ],
        }
    }

    /// A single part.
    #[inline]
    pub fn part(&self, part: usize, x: &Vec3) -> Field {
        let spines = &self.parts[part];
        let first = spines[0].field(x);
        spines[1..].iter().fold(first, |sum, spine| join(sum, spine.field(x), BLEND))
    }

    /// The union of some parts. The same to the bit as that of all of them, wherever the omitted parts are farther than
    /// the others by two fillets.
    #[inline]
    pub fn whole(&self, parts: PartSet, x: &Vec3) -> Field {
        let mut sum = Field { value: f64::INFINITY, gradient: Vec3::zeros() };
        let mut rest = parts;
        while rest != 0 {
            let field = self.part(rest.trailing_zeros() as usize, x);
            sum = if sum.value == f64::INFINITY { field } else { join(sum, field, FILLET) };
            rest &= rest - 1;
        }
        sum
    }

    /// The surface point reached from `x` by Newton's method, and the field's gradient there (outward, not normalised).
    #[inline]
    pub fn onto_surface(&self, parts: PartSet, mut x: Vec3) -> (Vec3, Vec3) {
        let mut gradient = Vec3::zeros();
        for _ in 0..12 {
            let field = self.whole(parts, &x);
            gradient = field.gradient;
            let step = gradient * (-field.value / gradient.norm_squared().max(0.05));
            x += step;
            if step.norm_squared() < CLOSE {
                break;
            }
        }
        (x, gradient)
    }

    /// As [`Shape::onto_surface`], onto the bottom of the valley between parts `a` and `b`.
    pub fn onto_valley(&self, parts: PartSet, a: usize, b: usize, mut x: Vec3) -> (Vec3, Vec3) {
        let mut gradient = Vec3::zeros();
        for _ in 0..24 {
            let (field, one, two) = (self.whole(parts, &x), self.part(a, &x), self.part(b, &x));
            gradient = field.gradient;
            let (g, h) = (gradient, one.gradient - two.gradient);
            let (gg, gh, hh) = (g.norm_squared(), g.dot(&h), h.norm_squared());
            let determinant = (gg * hh - gh * gh).max(1e-3);
            let (p, q) = (-field.value, two.value - one.value);
            let mut step = g * ((p * hh - q * gh) / determinant) + h * ((q * gg - p * gh) / determinant);
            let length = step.norm();
            if length > 0.1 {
                step *= 0.1 / length;
            }
            x += step;
            if step.norm_squared() < CLOSE {
                break;
            }
        }
        (x, gradient)
    }
}

/// Squared length of a Newton step below which the next one would be below single precision.
const CLOSE: f64 = 4e-10;
