//! What the user sees while a command runs: messages and progress on standard error, results on standard output.

use std::fmt::{Debug, Display};
use std::io::{IsTerminal, Write};
use std::process::ExitCode;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use super::interrupt::INTERRUPTED;
use crate::job::Left;
use crate::{Error, Result};
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;
use serde_json::Value;
use tracing::field::Field;
use tracing::{Event, Level, Subscriber};
use tracing_subscriber::Layer;
use tracing_subscriber::filter::Targets;
use tracing_subscriber::layer::Context;
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;

/// All warnings so far, for reports.
static WARNINGS: Mutex<Vec<String>> = Mutex::new(Vec::new());

/// How `program` ends: a failure is one line on standard error. What somebody stopped ends as the shell says of Ctrl-C.
pub fn exit_code(program: &str, outcome: Result<()>) -> ExitCode {
    let Err(error) = outcome else { return ExitCode::SUCCESS };
    eprintln!("{program}: {error}");
    let stopped = matches!(error, Error::Stopped) || error.cause::<Left>().is_some();
    if stopped { INTERRUPTED.into() } else { ExitCode::FAILURE }
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
    let coloured = std::io::stderr().is_terminal();
    let messages =
        tracing_subscriber::fmt::layer().with_writer(std::io::stderr).with_ansi(coloured).without_time();
    tracing_subscriber::registry().with(messages).with(targets).with(Collected).init();
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

/// A turning sign for work that says nothing of its steps; hidden where standard error is not a terminal.
pub fn spinner(message: &'static str) -> ProgressBar {
    let style = ProgressStyle::with_template("{spinner} {msg} {elapsed}");
    let bar = ProgressBar::new_spinner().with_message(message);
    bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_spinner()));
    bar.enable_steady_tick(Duration::from_millis(200));
    bar
}

/// A warning, on standard error.
pub fn warn(message: impl Display) {
    let message = message.to_string();
    eprintln!("pix2hdr: warning: {message}");
    collect(message);
}

/// All warnings so far.
pub fn warnings() -> Vec<String> {
    WARNINGS.lock().unwrap_or_else(PoisonError::into_inner).clone()
}

fn collect(warning: String) {
    WARNINGS.lock().unwrap_or_else(PoisonError::into_inner).push(warning);
}

/// Collects warnings that the library logs.
struct Collected;

impl<S: Subscriber> Layer<S> for Collected {
    fn on_event(&self, event: &Event<'_>, _: Context<'_, S>) {
        let meta = event.metadata();
        if *meta.level() == Level::WARN && meta.target().starts_with("pix2hdr") {
            event.record(&mut |field: &Field, value: &dyn Debug| {
                if field.name() == "message" {
                    collect(format!("{value:?}"));
                }
            });
        }
    }
}

/// A number of things: "1 frame", "2 frames".
pub fn counted(count: usize, thing: &str) -> String {
    format!("{count} {thing}{}", if count == 1 { "" } else { "s" })
}

/// Prints a result: one JSON object if `json`, with all warnings, else what `text` says.
pub fn result(json: bool, value: &impl Serialize, text: impl FnOnce() -> String) -> Result<()> {
    let text = if json { serde_json::to_string_pretty(&with_warnings(value)?)? } else { text() };
    match writeln!(std::io::stdout(), "{text}") {
        // Whoever reads has seen enough.
        Err(error) if error.kind() == std::io::ErrorKind::BrokenPipe => Ok(()),
        outcome => Ok(outcome?),
    }
}

/// A report with all warnings in it.
pub fn with_warnings(report: &impl Serialize) -> Result<Value> {
    let mut report = serde_json::to_value(report)?;
    if let Some(keys) = report.as_object_mut() {
        keys.insert("warnings".into(), warnings().into());
    }
    Ok(report)
}
