//! What one does with a mesh besides cutting it, and with labels once they are there.

pub mod correspond;
pub mod creature;
pub mod evaluate;
pub mod export;
pub mod page;
pub mod picture;
mod pixel_text;
pub mod plots;
pub mod sequence;
pub mod study;
pub mod transfer;
