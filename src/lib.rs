//! Turns the output of pixel-wise programmable cameras into 1000 fps HDR video.
//!
//! Data flows one way: [`scene`] or file → [`sensor`] → capture → [`synth`] (a [`network`] plan on
//! [`cpu`] or [`gpu`]) → [`video`] → [`quality`]. ARCHITECTURE.md has the map.

pub mod baseline;
pub mod bench;
#[cfg(feature = "cli")]
pub mod cli;
pub mod cpu;
pub mod dataset;
mod error;
pub mod fingerprint;
pub mod frame;
pub mod gpu;
pub mod job;
mod math;
pub mod network;
pub mod quality;
pub mod scene;
pub mod sensor;
pub mod synth;
pub mod system;
pub mod video;

pub use error::{At, Error, ModuleError, Result};
