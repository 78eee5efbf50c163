//! Response tables, guided by coverage: `cargo fuzz run response`.

#![no_main]

pix2hdr_fuzz::target!(Response);
