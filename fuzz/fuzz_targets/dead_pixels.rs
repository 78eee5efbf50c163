//! Lists of dead pixels, guided by coverage: `cargo fuzz run dead_pixels`.

#![no_main]

pix2hdr_fuzz::target!(DeadPixels);
