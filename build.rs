//! Tells the program its commit: from Git, or, in an archive that Git made of a commit, from the file `commit`.

use std::fs;
use std::path::Path;
use std::process::Command;

fn main() {
    println!("cargo:rerun-if-changed=commit");
    // A place that is not there would have cargo build anew every time.
    for place in ["HEAD", "logs/HEAD"] {
        if let Some(path) = git(&["rev-parse", "--git-path", place]).filter(|path| Path::new(path).exists()) {
            println!("cargo:rerun-if-changed={path}");
        }
    }
    let archived = fs::read_to_string("commit").ok().map(|text| text.trim().to_owned());
    let is_commit = |text: &String| !text.is_empty() && text.chars().all(|c| c.is_ascii_hexdigit());
    let commit =
        archived.filter(is_commit).or_else(|| git(&["rev-parse", "--short=9", "HEAD"]).filter(is_commit));
    println!("cargo:rustc-env=PIX2HDR_COMMIT={}", commit.unwrap_or_default());
}

/// What Git says of this folder, if it is the root of a repository of its own, and not merely in one.
fn git(arguments: &[&str]) -> Option<String> {
    if !Path::new(".git").exists() {
        return None;
    }
    let output =
        Command::new("git").args(arguments).output().ok().filter(|output| output.status.success())?;
    Some(String::from_utf8(output.stdout).ok()?.trim().to_owned())
}
