//! Left and right, and limbs that are alike: which cell is the image of which, so that both are cut alike.
//!
//! - [`mirror_images`] has the images under planes, and what is done with images of either kind.
//! - [`reflection`] finds those of posed bodies, whose two sides are alike along the surface only. Maps begin with
//!   `tips` of limbs (`anchored`, `anchors`) or with `signs` of smooth `functions`; `cell_map` has the checks that
//!   a map must pass, over the shortest paths of [`cell_paths`].
//! - [`limbs`] finds limbs that are alike, on either side or many around a body, whether it has two sides or not.
//!
//! Costs are in the files; all together at most .2 s of processor time for 2,000 cells.

mod anchored;
mod anchors;
pub mod cell_map;
pub mod cell_paths;
mod functions;
pub mod limbs;
pub mod mirror_images;
#[cfg(test)]
mod posed_body;
pub mod reflection;
mod signs;
mod tips;
