//! What speaks for uniting two neighbouring regions: a cost that orders merges and a probability.
//!
//! The order: cost = W / min(A)^.75 · conv³ with W the strength of the common boundary, A the
//! areas and conv the share of cell pairs across it that see each other as convex, relative to
//! the regions' own shares, so that the inside of a cup stays whole. The probability that people
//! keep the two in one part is a logistic function of that cost and nine other measures, its
//! constants fitted to the human segmentations of half of the Princeton benchmark (Chen,
//! Golovinskiy, Funkhouser, SIGGRAPH 2009). Target of the fit is what most people do at a merge of a
//! member, its weight how much that matters to the Rand index: |2t − 1| times the pairs it joins (to the
//! power .6, so that few large merges do not decide), t being the share of people who join them.
//! `tools/fit` fits them again.

use super::matrix::eigenvalues3;
use super::regions::{COLUMNS, Columns, EMBEDDED, Regions};

/// The logarithm of the cost is clipped to ± this before it enters the probability.
const COST_CLIP: f64 = 6.0;
/// Least height of a region over its own centroid, in units of √(total area).
const HEIGHT_FLOOR: f64 = 0.005;
/// Number of measures that the probability is made from.
pub const MEASURES: usize = 10;

/// The constants. The default ones are those of all decisions; others are for fitting them (`tools/fit`).
#[derive(Clone, Debug, PartialEq)]
pub struct Model {
    /// Exponent of the smaller area in the cost.
    pub area_power: f64,
    /// Exponent of the relative convexity in the cost.
    pub convexity_power: f64,
    /// Constant term of the log odds.
    pub constant: f64,
    /// Weights of the [`measures`] in the log odds.
    pub weights: [f64; MEASURES],
}

impl Default for Model {
    fn default() -> Self {
        Model {
            area_power: 0.75,
            convexity_power: 3.0,
            constant: -6.581,
            weights: [2.041, 1.444, 0.830, -0.544, -1.553, 1.541, 7.587, -5.470, -6.812, -8.383],
        }
    }
}

fn log(x: f64) -> f64 {
    x.max(1e-6).ln()
}

/// The measures of one region that the probability uses.
struct Shape {
    length: f64,
    width: f64,
    normal: f64,
    height: f64,
    embedding: [f64; EMBEDDED],
    log_thickness: f64,
}

impl Shape {
    fn of(q: &Columns) -> Shape {
        let a = q[0].max(1e-300);
        let x: [f64; 3] = std::array::from_fn(|c| q[1 + c] / a);
        let n: [f64; 3] = std::array::from_fn(|c| q[10 + c] / a);
        let product = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)];
        let e = eigenvalues3(std::array::from_fn(|k| q[4 + k] / a - x[product[k].0] * x[product[k].1]));
        let root = |v: f64| v.max(1e-8).sqrt();
        Shape {
            length: root(e[0]),
            width: root(e[1]),
            normal: (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]).sqrt(),
            height: q[13] / a - (n[0] * x[0] + n[1] * x[1] + n[2] * x[2]),
            embedding: std::array::from_fn(|k| q[14 + k] / a),
            log_thickness: q[COLUMNS - 1] / a,
        }
    }
}

/// What the probability uses of the common boundary of two regions: means along it.
struct Border {
    length: f64,
    convex: f64,
    concave: f64,
    log_thickness: f64,
    step: f64,
}

impl Border {
    fn of(r: &Regions, i: usize, j: usize) -> Border {
        let length = r.length[(i, j)];
        let mean = |sum: f64| sum / length.max(1e-300);
        Border {
            length,
            convex: mean(r.convex[(i, j)]),
            concave: mean(r.concave[(i, j)]),
            log_thickness: mean(r.neck[(i, j)]),
            step: (r.step[(i, j)] + 1e-12) / (r.all[(i, j)] + 1e-11),
        }
    }
}

/// The ten measures of uniting neighbours `i` and `j` with the given logarithm of the cost: that, clipped; cosine of
/// the mean embeddings; length of the smaller's mean normal (open patch 1, closed limb 0); |ln| of the ratio of widths;
/// ln of the larger's length; ln of boundary over the smaller's height; mean convex angle of the boundary; root of the
/// mean |difference| of ln thickness between cells on either side of it; its mean concave angle; ln of how much thinner
/// the body is along it than in the thinner of the two (≤ 0).
pub fn measures(r: &Regions, i: usize, j: usize, log_cost: f64) -> [f64; MEASURES] {
    let (i, j) = if r.area(i) <= r.area(j) { (i, j) } else { (j, i) };
    let border = Border::of(r, i, j);
    let (a, b) = (Shape::of(&r.columns[i]), Shape::of(&r.columns[j]));
    let inner = |x: &[f64; EMBEDDED], y: &[f64; EMBEDDED]| x.iter().zip(y).map(|(x, y)| x * y).sum::<f64>();
    let norm = inner(&a.embedding, &a.embedding).sqrt() * inner(&b.embedding, &b.embedding).sqrt();
    [
        log_cost.clamp(-COST_CLIP, COST_CLIP),
        inner(&a.embedding, &b.embedding) / norm.max(1e-9),
        a.normal,
        (a.width / b.width).ln().abs(),
        b.length.ln(),
        (border.length.max(1e-6) / a.height.max(HEIGHT_FLOOR)).ln(),
        border.convex,
        border.step.sqrt(),
        border.concave,
        (border.log_thickness - a.log_thickness.min(b.log_thickness)).min(0.0),
    ]
}

impl Model {
    /// Natural logarithm of the cost of uniting regions `i` and `j`: the greater the sooner.
    pub fn log_cost(&self, r: &Regions, i: usize, j: usize) -> f64 {
        let share = |a: usize, b: usize, e: f64| (r.seen[(a, b)] + e) / (r.all[(a, b)] + e);
        let own = share(i, i, 1e-9) * share(j, j, 1e-9);
        let conv = (share(i, j, 1e-12) / own.sqrt().max(1e-12)).min(1.0);
        log(r.strength[(i, j)]) - self.area_power * log(r.area(i).min(r.area(j))) + self.convexity_power * log(conv)
    }

    /// Probability that people keep two regions with such [`measures`] in one part.
    pub fn probability(&self, measures: &[f64; MEASURES]) -> f64 {
        let z = self.constant + measures.iter().zip(&self.weights).map(|(x, w)| x * w).sum::<f64>();
        1.0 / (1.0 + (-z).exp())
    }
}
