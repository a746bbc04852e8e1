//! Left-right symmetry, rotations, and similar limbs: which cell is the image of which, so that both are cut alike.
//!
//! - [`mirror_images`] has the images under planes, and the use of images of either kind.
//! - [`reflection`] finds those of posed bodies, whose two sides are symmetric only along the surface. Maps start from
//!   `tips` of limbs (`anchored`, `anchors`) or from `signs` of smooth `functions`; `cell_map` has the checks that a
//!   map must pass, using the shortest paths of [`cell_paths`].
//! - [`both_sides`] cuts on both sides what would be cut on one only; [`twin_joins`] joins both sides alike for fewer
//!   parts.
//! - [`rotations`] finds the rotations of gears and wheels, [`turned_parts`] cuts all teeth or none.
//! - [`stretches`] of a surface are fitted to other places by a [`rigid_motion`], to find what is repeated.
//! - [`limbs`] finds limbs, and which are similar, on both sides or around a body, whether or not it has two sides.
//!
//! The files state their costs; all together at most .2 s of processor time for 2,000 cells.

mod anchored;
mod anchors;
pub mod both_sides;
pub mod cell_map;
pub mod cell_paths;
mod functions;
pub mod limbs;
pub mod mirror_images;
#[cfg(test)]
mod posed_body;
pub mod reflection;
pub mod rigid_motion;
pub mod rotations;
mod signs;
pub mod stretches;
mod tips;
pub mod turned_parts;
pub mod twin_joins;
