//! The library's results against slow, obvious versions, known values and identities, one module per subject.
//!
//! One program for all of them, since every program of its own is linked with the whole library:
//! `cargo test --test library oracles::` runs one module.

#[path = "../common/mod.rs"]
mod common;

mod calibrate;
mod components;
mod correspond_files;
mod correspond_parts;
mod correspond_refined;
mod creature_files;
mod creature_mesh;
mod denoising;
mod duplicates;
mod enclosed;
mod evaluate_metrics;
mod large_pages;
mod long_triangles;
mod means_contracted;
mod memory_or_files;
mod oracles;
mod page;
mod parts_small;
mod picture_small;
mod ply_flavours;
mod ply_labelled;
mod ply_mutations;
mod progress;
mod public_api;
mod recesses;
mod rotations;
mod roughness;
mod scale_order;
mod strays;
mod study;
mod thin_plates;
mod thin_walls;
mod transfer;
mod tubes;
