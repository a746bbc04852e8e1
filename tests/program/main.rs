//! The program as people run it, one module per subject: files, messages, exit codes, and the same bytes whatever the way.
//!
//! One program for all of them, since every program of its own is linked with the whole library:
//! `cargo test --test program batch::` runs one module.

#[path = "../common/mod.rs"]
mod common;

mod altered;
mod batch;
mod command_line;
mod correspond_cli;
mod correspond_guided;
mod edits;
mod evaluate_cli;
mod formats;
mod formats_in;
mod guide;
mod hostile;
mod info_command;
mod odd_shapes;
mod picture_command;
mod pipelines;
mod plots;
mod reports;
mod restart;
mod scale_plan;
mod scale_resume;
mod segment_all;
mod sequence;
mod split_faces;
mod stages;
mod workflow;
