//! The inside of a surface: walls of cavities and bodies within, and decisions layer by layer.
//!
//! [`exposure`] measures how much of the outside each cell sees, [`cavities`] finds closed surfaces wound against the
//! rest, [`enclosed`] divides the cells into layers accordingly, and [`layered`] decides on each layer separately.

mod cavities;
pub mod enclosed;
mod exposure;
pub(super) mod layered;
