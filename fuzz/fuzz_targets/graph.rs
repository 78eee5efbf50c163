//! Layer graphs, guided by coverage: `cargo fuzz run graph`.

#![no_main]

pix2hdr_fuzz::target!(Graph);
