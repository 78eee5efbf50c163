//! The `pix2hdr` command.

use std::process::ExitCode;

fn main() -> ExitCode {
    pix2hdr::cli::main()
}
