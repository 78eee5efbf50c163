//! Arrays of captures, guided by coverage: `cargo fuzz run capture_array`.

#![no_main]

pix2hdr_fuzz::target!(CaptureArray);
