//! What a surface has inside: walls of cavities and bodies within, and decisions layer by layer.
//!
//! [`exposure`] says how much of the outside each cell sees, [`enclosed`] divides the cells into layers by it, and
//! [`layered`] decides on each layer alone.

pub mod enclosed;
mod exposure;
pub(super) mod layered;
