//! What the user sees while a command runs: messages and progress on standard error, results on standard output.

use std::fmt::Display;
use std::io::Write;
use std::process::ExitCode;
use std::time::Duration;

use crate::Result;
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;
use tracing::Level;
use tracing_subscriber::filter::Targets;
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;

/// How `program` ends: a failure is one line on standard error.
pub fn exit_code(program: &str, outcome: Result<()>) -> ExitCode {
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{program}: {error}");
            ExitCode::FAILURE
        }
    }
}

/// Sends log messages to standard error: those that the variable `RUST_LOG` names, such as `warn` or `wgpu=info,warn`, or
/// else more the more often the user asks for it.
pub fn log(verbose: u8) {
    let usual = Targets::new().with_default(Level::WARN);
    let usual = match verbose {
        0 => usual,
        1 => usual.with_target("pix2hdr", Level::INFO),
        _ => usual.with_default(Level::DEBUG),
    };
    let named = std::env::var("RUST_LOG").ok().filter(|named| !named.is_empty());
    let named =
        named.map(|named| named.parse::<Targets>().map_err(|error| format!("RUST_LOG={named}: {error}")));
    let (targets, problem) = match named {
        None => (usual, None),
        Some(Ok(targets)) => (targets, None),
        Some(Err(problem)) => (usual, Some(problem)),
    };
    let messages = tracing_subscriber::fmt::layer().with_writer(std::io::stderr).without_time();
    tracing_subscriber::registry().with(messages).with(targets).init();
    if let Some(problem) = problem {
        warn(&problem);
    }
}

/// A bar for `len` steps of what `message` says; hidden where standard error is not a terminal.
pub fn progress(len: usize, message: &'static str) -> ProgressBar {
    let style = ProgressStyle::with_template("{msg:12} {wide_bar} {pos}/{len} {elapsed} (left {eta})")
        .unwrap_or_else(|_| ProgressStyle::default_bar());
    let bar = ProgressBar::new(len as u64).with_style(style).with_message(message);
    bar.enable_steady_tick(Duration::from_millis(200));
    bar
}

/// A warning, on standard error.
pub fn warn(message: impl Display) {
    eprintln!("pix2hdr: warning: {message}");
}

/// Prints a result: one JSON object if `json`, else what `text` says.
pub fn result(json: bool, value: &impl Serialize, text: impl FnOnce() -> String) -> Result<()> {
    let text = if json { serde_json::to_string_pretty(value)? } else { text() };
    match writeln!(std::io::stdout(), "{text}") {
        // Whoever reads has seen enough.
        Err(error) if error.kind() == std::io::ErrorKind::BrokenPipe => Ok(()),
        outcome => Ok(outcome?),
    }
}
