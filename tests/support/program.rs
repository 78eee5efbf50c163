//! Running the program as a user does.
#![allow(dead_code, reason = "each test file uses a part of this module")]

use std::fs;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

/// Runs the program.
pub fn pix2hdr(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_pix2hdr"))
        .args(arguments)
        .env_remove("RUST_LOG")
        .output()
        .expect("the program starts")
}

/// Runs a command that must succeed, and returns what it prints.
pub fn succeeds(arguments: &[&str]) -> String {
    let output = pix2hdr(arguments);
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

/// Runs a command that must fail with one line that holds all of `words`, and must write nothing into `out`.
pub fn fails(arguments: &[&str], words: &[&str], out: &Path) {
    failed(&pix2hdr(arguments), &arguments.join(" "), words, out);
}

/// As [`fails`], of a program that has run.
pub fn failed(output: &Output, what: &str, words: &[&str], out: &Path) {
    let error = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{what}: {error}");
    // Graphics drivers add lines of their own; ours begin with our name.
    let ours: Vec<&str> =
        error.lines().filter(|line| line.starts_with("pix2hdr:") && !line.contains("warning:")).collect();
    assert_eq!(ours.len(), 1, "{what}: {error}");
    assert!(!error.contains("panicked"), "{error}");
    for word in words {
        assert!(ours[0].contains(word), "{what}: '{word}' is not in '{}'", ours[0]);
    }
    assert!(output.stdout.is_empty(), "{what} printed a result");
    let left: Vec<_> = fs::read_dir(out).into_iter().flatten().flatten().map(|entry| entry.path()).collect();
    assert!(left.is_empty(), "{what} left {left:?}");
}

/// Runs the program behind a shell's `limits`, such as `ulimit -v 1000000`, for at most a minute.
#[cfg(unix)]
pub fn within_limits(arguments: &[&str], limits: &str) -> Output {
    let mut child = Command::new("sh")
        .args(["-c", &format!("{limits}; exec \"$0\" \"$@\""), env!("CARGO_BIN_EXE_pix2hdr")])
        .args(arguments)
        .env_remove("RUST_LOG")
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts");
    let begun = Instant::now();
    // What it writes fits into a pipe.
    while child.try_wait().unwrap().is_none() {
        if begun.elapsed() > Duration::from_mins(1) {
            child.kill().unwrap();
            panic!("{arguments:?} hangs");
        }
        std::thread::sleep(Duration::from_millis(3));
    }
    child.wait_with_output().unwrap()
}

/// A weights file with a graph and nothing else.
pub fn weights(graph: &str) -> Vec<u8> {
    let text = |text: &str| serde_json::Value::String(text.to_owned()).to_string();
    let header = format!(
        r#"{{"__metadata__": {{"format": "pix2hdr-weights/1", "graph": {}, "response": "\"any\"", "provenance": "{{}}"}}}}"#,
        text(graph)
    );
    [&(header.len() as u64).to_le_bytes()[..], header.as_bytes()].concat()
}
