//! EXR pictures, guided by coverage: `cargo fuzz run exr`.

#![no_main]

pix2hdr_fuzz::target!(Exr);
