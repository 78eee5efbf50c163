//! Patterns, guided by coverage: `cargo fuzz run pattern`.

#![no_main]

pix2hdr_fuzz::target!(Pattern);
