//! The `pix2hdr-viewer` command.

use std::process::ExitCode;

use clap::Parser;
use pix2hdr::cli::terminal;
use pix2hdr_viewer::Arguments;

fn main() -> ExitCode {
    terminal::exit_code("pix2hdr-viewer", Arguments::parse().run())
}
