//! Radiance pictures, guided by coverage: `cargo fuzz run radiance`.

#![no_main]

pix2hdr_fuzz::target!(Radiance);
