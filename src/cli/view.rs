//! `pix2hdr view`: starts the live viewer, a program of its own.

use std::env;
use std::ffi::OsString;
use std::io::{self, ErrorKind};
use std::process::Command;

use clap::Args;

use crate::{Error, Result};

/// Name of the viewer's executable, without the system's suffix.
const VIEWER: &str = "pix2hdr-viewer";

/// Shows synthesis live in a window: mosaic, box filter, result and truth, playing
///
/// Starts pix2hdr-viewer, which lies beside this program or on PATH, and hands it all arguments. `pix2hdr view --help`
/// shows its options. In the repository, `cargo build --release -p pix2hdr-viewer` builds it.
#[derive(Args)]
#[command(disable_help_flag = true)]
pub struct ViewArgs {
    /// What to show, and options of the viewer
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, value_name = "ARGUMENT")]
    arguments: Vec<OsString>,
}

impl ViewArgs {
    /// Runs the command, which does not return where the viewer starts.
    pub fn run(&self, verbose: u8) -> Result<()> {
        let name = format!("{VIEWER}{}", env::consts::EXE_SUFFIX);
        let beside = env::current_exe().ok().map(|program| program.with_file_name(&name));
        let viewer = beside.filter(|path| path.is_file()).unwrap_or_else(|| name.into());
        let mut command = Command::new(&viewer);
        command.args((0..verbose).map(|_| "-v")).args(&self.arguments);
        let error = become_program(&mut command);
        Err(Error::Usage(match error.kind() {
            ErrorKind::NotFound => format!(
                "the viewer, {VIEWER}, is neither beside this program nor on PATH; \
                 `cargo build --release -p {VIEWER}` builds it, `cargo run --release -p {VIEWER} -- fan` starts it too"
            ),
            _ => format!("{} cannot be started: {error}", viewer.display()),
        }))
    }
}

/// Puts another program in the place of this one. Returns why it could not be started.
#[cfg(unix)]
fn become_program(command: &mut Command) -> io::Error {
    std::os::unix::process::CommandExt::exec(command)
}

/// Runs another program and ends as it does. Returns why it could not be started.
#[cfg(not(unix))]
fn become_program(command: &mut Command) -> io::Error {
    match command.status() {
        Ok(status) => std::process::exit(status.code().unwrap_or(1)),
        Err(error) => error,
    }
}
