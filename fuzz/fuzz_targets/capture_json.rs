//! Descriptions of captures, guided by coverage: `cargo fuzz run capture_json`.

#![no_main]

pix2hdr_fuzz::target!(CaptureJson);
