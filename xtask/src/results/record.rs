//! Records of what was measured: `docs/results/NAME.json`.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{SystemTime, UNIX_EPOCH};

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::table::Table;
use crate::Result;

/// Folder of all records, in the repository.
pub const FOLDER: &str = "docs/results";

/// What was measured, where, when, of which code, and how tables show it.
#[derive(Clone, Debug, Default, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Record {
    /// What the figures are, in a sentence.
    pub what: String,
    /// The commits that were measured: one, unless figures were put together.
    pub commits: Vec<String>,
    /// Day of the measurement, the last one if there are several: YYYY-MM-DD.
    pub date: String,
    /// Where; nothing where that was not written down.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub machine: Option<Machine>,
    /// What was run.
    pub command: String,
    /// What the command does not say: repetitions, what else the machine did.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub settings: String,
    /// Files and folders that decide the figures. When one of them has changed since, the figures may be out of date.
    pub measures: Vec<String>,
    /// Whether figures come from a document, because what the program printed was not kept.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub transcribed: bool,
    /// How the figures are shown, by name of the table.
    pub tables: BTreeMap<String, Table>,
    /// Which keys of what the program prints are kept; all if none is named.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub keeps: Vec<String>,
    /// What the program printed as JSON.
    #[serde(default, skip_serializing_if = "Value::is_null")]
    pub figures: Value,
}

/// What figures were measured on, as far as it matters to them.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Machine {
    /// Model of the processor.
    pub cpu: String,
    /// Cores that could be used.
    pub cores: usize,
    /// The GPU adapter with its driver, where one computed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gpu: Option<String>,
}

impl Machine {
    /// This machine.
    fn here() -> Self {
        let text = fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
        let named = text.lines().find_map(|line| line.strip_prefix("model name")?.split_once(": "));
        let cpu = named.map_or(std::env::consts::ARCH, |(_, name)| name.trim()).to_owned();
        Self { cpu, cores: std::thread::available_parallelism().map_or(1, usize::from), gpu: None }
    }

    /// In words.
    pub fn describe(&self) -> String {
        let cores = if self.cores == 1 { "core" } else { "cores" };
        let gpu = self.gpu.as_ref().map_or_else(String::new, |gpu| format!(", {gpu}"));
        format!("{} {cores} of {}{gpu}", self.cores, self.cpu)
    }
}

/// All records, by name.
pub fn read_all(root: &Path) -> Result<BTreeMap<String, Record>> {
    let folder = root.join(FOLDER);
    let mut records = BTreeMap::new();
    for entry in folder.read_dir().map_err(|e| format!("{}: {e}", folder.display()))? {
        let path = entry.map_err(|e| e.to_string())?.path();
        if path.extension().is_some_and(|e| e == "json") {
            let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
            records.insert(name, read(&path)?);
        }
    }
    Ok(records)
}

fn read(path: &Path) -> Result<Record> {
    let text = fs::read_to_string(path).map_err(|e| format!("{}: {e}", path.display()))?;
    serde_json::from_str(&text).map_err(|e| format!("{}: {e}", path.display()))
}

/// Runs the program with `arguments` and `--json`, and keeps what it prints as the record `name`. A record of that name
/// keeps what people wrote of it: what it is, what it measures, which keys it keeps, and its tables.
pub fn record(root: &Path, program: &Path, name: &str, arguments: &[String]) -> Result<PathBuf> {
    let path = root.join(FOLDER).join(format!("{name}.json"));
    let before = if path.is_file() { Some(read(&path)?) } else { None };
    // Other records and the tables made from them may be new.
    let code =
        ["status", "--porcelain", "--untracked-files=no", "--", ".", ":(exclude)docs", ":(exclude)README.md"];
    if !git(root, &code)?.is_empty() {
        return Err("a record names the commit that it measures: commit your changes first".into());
    }
    let output = Command::new(program)
        .args(arguments)
        .arg("--json")
        .current_dir(root)
        .stderr(std::process::Stdio::inherit())
        .output()
        .map_err(|e| format!("{}: {e}", program.display()))?;
    if !output.status.success() {
        return Err(format!("{}: {}", program.display(), output.status));
    }
    let figures: Value = serde_json::from_slice(&output.stdout).map_err(|e| format!("not JSON: {e}"))?;
    let gpu = ["/ran_on", "/adapter"].iter().find_map(|key| figures.pointer(key)?.as_str());
    let machine = Machine { gpu: gpu.filter(|gpu| *gpu != "cpu").map(str::to_owned), ..Machine::here() };
    let mut record = before.unwrap_or_default();
    record.commits = vec![git(root, &["rev-parse", "--short", "HEAD"])?];
    record.date = today()?;
    record.machine = Some(machine);
    record.command = format!("pix2hdr {}", arguments.join(" "));
    record.settings = String::new();
    record.transcribed = false;
    record.figures = kept(figures, &record.keeps);
    let text = serde_json::to_string_pretty(&record).map_err(|e| e.to_string())?;
    fs::write(&path, text + "\n").map_err(|e| format!("{}: {e}", path.display()))?;
    Ok(path)
}

/// Of an object, the values with these keys; everything if there are none.
fn kept(figures: Value, keys: &[String]) -> Value {
    match figures {
        Value::Object(map) if !keys.is_empty() => {
            Value::Object(map.into_iter().filter(|(key, _)| keys.contains(key)).collect())
        }
        figures => figures,
    }
}

/// Why the figures may be older than what they measure; `None` if they are not.
pub fn outdated(root: &Path, record: &Record) -> Option<String> {
    record.commits.iter().find_map(|commit| {
        let range = format!("{commit}..HEAD");
        let mut arguments = vec!["rev-list", "--count", &range, "--"];
        arguments.extend(record.measures.iter().map(String::as_str));
        match git(root, &arguments) {
            Ok(count) if count == "0" => None,
            Ok(count) => Some(format!("what it measures changed in {count} commits since {commit}")),
            Err(_) => Some(format!("commit {commit} is not in this checkout")),
        }
    })
}

fn git(root: &Path, arguments: &[&str]) -> Result<String> {
    let output =
        Command::new("git").args(arguments).current_dir(root).output().map_err(|e| format!("git: {e}"))?;
    if output.status.success() {
        Ok(String::from_utf8_lossy(&output.stdout).trim().to_owned())
    } else {
        Err(format!("git {}: {}", arguments.join(" "), String::from_utf8_lossy(&output.stderr).trim()))
    }
}

/// The day by the clock of the world, YYYY-MM-DD.
fn today() -> Result<String> {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).map_err(|e| e.to_string())?;
    Ok(day(since.as_secs() / 86_400))
}

/// A day of the Gregorian calendar, counted from 1970-01-01.
fn day(mut days: u64) -> String {
    let leap = |year: u64| year.is_multiple_of(4) && (!year.is_multiple_of(100) || year.is_multiple_of(400));
    let mut year = 1970;
    while days >= 365 + u64::from(leap(year)) {
        days -= 365 + u64::from(leap(year));
        year += 1;
    }
    let lengths = [31, 28 + u64::from(leap(year)), 31, 30, 31, 30, 31, 31, 30, 31, 30, 31];
    let mut month = 0;
    while days >= lengths[month] {
        days -= lengths[month];
        month += 1;
    }
    format!("{year}-{:02}-{:02}", month + 1, days + 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A repository with one commit, and a program in it that prints figures.
    #[cfg(unix)]
    fn repository() -> (PathBuf, PathBuf) {
        use std::os::unix::fs::PermissionsExt;
        let root = std::env::temp_dir().join(format!("pix2hdr-xtask-record-{}", std::process::id()));
        fs::create_dir_all(root.join(FOLDER)).unwrap();
        let program = root.join("program");
        fs::write(&program, "#!/bin/sh\necho \"{\\\"arguments\\\": \\\"$*\\\", \\\"noise\\\": 1}\"\n")
            .unwrap();
        fs::set_permissions(&program, fs::Permissions::from_mode(0o755)).unwrap();
        fs::write(root.join("code"), "1").unwrap();
        git(&root, &["init", "--quiet"]).unwrap();
        commit(&root);
        (root, program)
    }

    #[cfg(unix)]
    fn commit(root: &Path) {
        git(root, &["add", "--all"]).unwrap();
        let who = ["-c", "user.name=test", "-c", "user.email=test@localhost"];
        git(root, &[&who[..], &["commit", "--quiet", "--message", "test"]].concat()).unwrap();
    }

    #[cfg(unix)]
    #[test]
    fn a_record_says_what_was_measured_and_when_that_changed() {
        let (root, program) = repository();
        let path = record(&root, &program, "it", &["suite".into(), "--frames".into(), "9".into()]).unwrap();
        let mut made = read(&path).unwrap();
        assert_eq!(made.command, "pix2hdr suite --frames 9");
        assert_eq!(made.commits, [git(&root, &["rev-parse", "--short", "HEAD"]).unwrap()]);
        assert_eq!(made.figures, serde_json::json!({"arguments": "suite --frames 9 --json", "noise": 1}));

        // What people wrote stays when it is measured again.
        made.what = "figures".into();
        made.keeps = vec!["arguments".into()];
        made.measures = vec!["code".into()];
        made.transcribed = true;
        fs::write(&path, serde_json::to_string(&made).unwrap()).unwrap();
        record(&root, &program, "it", &["bench".into()]).unwrap();
        let made = read(&path).unwrap();
        assert_eq!((made.what.as_str(), made.transcribed), ("figures", false));
        assert_eq!(made.figures, serde_json::json!({"arguments": "bench --json"}));
        commit(&root);
        assert_eq!(outdated(&root, &made), None);

        fs::write(root.join("code"), "2").unwrap();
        assert!(
            record(&root, &program, "it", &["bench".into()]).unwrap_err().contains("commit your changes")
        );
        commit(&root);
        assert!(outdated(&root, &made).unwrap().starts_with("what it measures changed in 1 commits since"));
        let elsewhere = Record { commits: vec!["0123456".into()], ..made };
        assert!(outdated(&root, &elsewhere).unwrap().contains("not in this checkout"));
        fs::remove_dir_all(root).unwrap();
    }

    #[test]
    fn keys_that_are_named_are_kept() {
        let figures = serde_json::json!({"a": 1, "b": 2});
        assert_eq!(kept(figures.clone(), &[]), figures);
        assert_eq!(kept(figures, &["b".to_owned()]), serde_json::json!({"b": 2}));
    }

    #[test]
    fn days_are_those_of_the_calendar() {
        let days = [0, 58, 59, 11_016, 11_017, 19_782, 20_787].map(day);
        assert_eq!(
            days,
            [
                "1970-01-01",
                "1970-02-28",
                "1970-03-01",
                "2000-02-29",
                "2000-03-01",
                "2024-02-29",
                "2026-11-30"
            ]
        );
    }
}
