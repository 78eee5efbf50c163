//! Whether two folders hold the same files.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::Result;

/// Keys of reports that are left out, wherever they stand: times, which differ from run to run, operations, of which a
/// program may need fewer for the same result, and the version of the program, which says who computed and not what. Everything else has to be the same, names of executors and counts of
/// windows, tiles and skipped cells included.
const LEFT_OUT: [&str; 6] = [
    "seconds",
    "inference_seconds",
    "ms_per_frame_median",
    "ms_per_frame_end_to_end",
    "gflop_per_frame",
    "version",
];

/// What names of reports end in: compared as JSON without [`LEFT_OUT`]. All others are compared byte for byte.
pub const REPORTS: [&str; 2] = ["report.json", "printed.json"];

/// All differences between the files below `old` and those below `new`, a line each.
pub fn differences(old: &Path, new: &Path) -> Result<Vec<String>> {
    let names: BTreeSet<PathBuf> = files(old)?.union(&files(new)?).cloned().collect();
    let mut found = Vec::new();
    for name in names {
        let [old, new] = [old.join(&name), new.join(&name)];
        let problem = match (old.is_file(), new.is_file()) {
            (true, false) => Some("only the old program wrote it".to_owned()),
            (false, true) => Some("only the new program wrote it".to_owned()),
            _ => difference(&old, &new)?,
        };
        found.extend(problem.map(|problem| format!("{}: {problem}", name.display())));
    }
    Ok(found)
}

/// Whether a file of this name is a report.
fn is_report(name: &str) -> bool {
    REPORTS.iter().any(|ending| name.ends_with(ending))
}

/// In what two files of one name differ.
fn difference(old: &Path, new: &Path) -> Result<Option<String>> {
    let [a, b] = [read(old)?, read(new)?];
    if old.file_name().and_then(|name| name.to_str()).is_some_and(is_report) {
        let [a, b] = [report(&a, old)?, report(&b, new)?];
        let mut found = Vec::new();
        compare_values("", &a, &b, &mut found);
        return Ok((!found.is_empty()).then(|| found.join("; ")));
    }
    if a == b {
        return Ok(None);
    }
    let first = a.iter().zip(&b).take_while(|(a, b)| a == b).count();
    let differing = a.iter().zip(&b).filter(|(a, b)| a != b).count();
    Ok(Some(if a.len() == b.len() {
        format!("{differing} of {} bytes differ, the first one at {first}", a.len())
    } else {
        format!("{} instead of {} bytes, the first one that differs at {first}", b.len(), a.len())
    }))
}

/// Names in what two values differ, by the way to it. Numbers are the same if they are written the same.
fn compare_values(at: &str, old: &Value, new: &Value, found: &mut Vec<String>) {
    match (old, new) {
        (Value::Object(a), Value::Object(b)) => {
            for key in a.keys().chain(b.keys().filter(|key| !a.contains_key(*key))) {
                if !LEFT_OUT.contains(&key.as_str()) {
                    let [a, b] = [a, b].map(|map| map.get(key).unwrap_or(&Value::Null));
                    compare_values(&format!("{at}/{key}"), a, b, found);
                }
            }
        }
        (Value::Array(a), Value::Array(b)) if a.len() == b.len() => {
            for (i, (a, b)) in a.iter().zip(b).enumerate() {
                compare_values(&format!("{at}/{i}"), a, b, found);
            }
        }
        _ if old == new => {}
        _ => found.push(format!("{at} is {new} instead of {old}")),
    }
}

fn report(bytes: &[u8], path: &Path) -> Result<Value> {
    serde_json::from_slice(bytes).map_err(|e| format!("{}: {e}", path.display()))
}

fn read(path: &Path) -> Result<Vec<u8>> {
    fs::read(path).map_err(|e| format!("{}: {e}", path.display()))
}

/// All files below `folder`, by their paths in it.
fn files(folder: &Path) -> Result<BTreeSet<PathBuf>> {
    let mut found = BTreeSet::new();
    let mut left = vec![PathBuf::new()];
    while let Some(within) = left.pop() {
        let path = folder.join(&within);
        let entries = path.read_dir().map_err(|e| format!("{}: {e}", path.display()))?;
        for entry in entries {
            let entry = entry.map_err(|e| e.to_string())?;
            let name = within.join(entry.file_name());
            if entry.path().is_dir() {
                left.push(name);
            } else {
                found.insert(name);
            }
        }
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two folders of the same files, named after the test.
    fn folders(test: &str) -> [PathBuf; 2] {
        let base = std::env::temp_dir().join(format!("pix2hdr-xtask-{test}-{}", std::process::id()));
        ["old", "new"].map(|which| {
            let folder = base.join(which);
            fs::create_dir_all(folder.join("hdr")).unwrap();
            fs::write(folder.join("hdr/frame-00000.exr"), [1, 2, 3, 4]).unwrap();
            let report =
                format!(r#"{{"seconds": "{which}", "frames": 3, "skipped": {{"noise": "stated"}}}}"#);
            fs::write(folder.join("report.json"), report).unwrap();
            folder
        })
    }

    #[test]
    fn the_same_files_do_not_differ() {
        let [old, new] = folders("same");
        assert_eq!(differences(&old, &new).unwrap(), Vec::<String>::new());
    }

    #[test]
    fn every_kind_of_difference_is_named() {
        let [old, new] = folders("different");
        fs::write(new.join("hdr/frame-00000.exr"), [1, 2, 0, 4]).unwrap();
        fs::write(old.join("hdr/frame-00001.exr"), []).unwrap();
        fs::write(new.join("skipped.png"), []).unwrap();
        fs::write(new.join("report.json"), r#"{"frames": 4, "skipped": {"noise": "stated"}}"#).unwrap();
        assert_eq!(
            differences(&old, &new).unwrap(),
            [
                "hdr/frame-00000.exr: 1 of 4 bytes differ, the first one at 2",
                "hdr/frame-00001.exr: only the old program wrote it",
                "report.json: /frames is 4 instead of 3",
                "skipped.png: only the new program wrote it",
            ]
        );
        fs::write(new.join("hdr/frame-00000.exr"), [1, 2, 3]).unwrap();
        fs::write(new.join("report.json"), r#"{"frames": 3, "skipped": null}"#).unwrap();
        let found = differences(&old, &new).unwrap();
        assert_eq!(found[0], "hdr/frame-00000.exr: 3 instead of 4 bytes, the first one that differs at 3");
        assert!(found[2].starts_with("report.json: /skipped is null instead of"), "{found:?}");
    }
}
