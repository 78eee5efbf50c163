//! Cameras to simulate, guided by coverage: `cargo fuzz run camera`.

#![no_main]

pix2hdr_fuzz::target!(Camera);
