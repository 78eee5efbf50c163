//! NPY videos, guided by coverage: `cargo fuzz run npy`.

#![no_main]

pix2hdr_fuzz::target!(Npy);
