//! Weights files, guided by coverage: `cargo fuzz run weights`.

#![no_main]

pix2hdr_fuzz::target!(Weights);
