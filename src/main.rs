//! The `pix2hdr` command.

fn main() {}
