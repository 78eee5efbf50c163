//! Documents name tests and files that are there.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Folders that paths in documents may be given from, besides the document's own and the repository.
const ROOTS: [&str; 2] = ["", "src"];
/// How paths of files end that documents name in backticks.
const ENDINGS: [&str; 8] = [".rs", ".wgsl", ".py", ".json", ".md", ".toml", ".txt", "/"];
/// Folders that the program makes in examples.
const MADE: [&str; 2] = ["out/", "result/"];
/// Documents that speak of what was.
const HISTORY: [&str; 1] = ["CHANGELOG.md"];

/// All files that git tracks or would.
fn tracked(root: &Path) -> Vec<PathBuf> {
    let listed = Command::new("git")
        .args(["ls-files", "--cached", "--others", "--exclude-standard", "-z"])
        .current_dir(root)
        .output()
        .expect("git lists files");
    assert!(listed.status.success(), "git ls-files failed; this test needs a git checkout");
    let text = String::from_utf8_lossy(&listed.stdout);
    text.split('\0').filter(|name| !name.is_empty() && root.join(name).is_file()).map(PathBuf::from).collect()
}

/// Names of all tests in a file: functions below `#[test]`.
fn test_names(text: &str) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    let mut test = false;
    for line in text.lines().map(str::trim) {
        test |= line.starts_with("#[test]");
        if let Some(name) = line.strip_prefix("fn ").filter(|_| test) {
            let end = name.find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(name.len());
            found.insert(name[..end].to_owned());
            test = false;
        }
    }
    found
}

/// What stands in backticks, outside of blocks of code.
fn quoted(text: &str) -> Vec<&str> {
    let mut code = false;
    let prose = text.lines().filter(|line| {
        let fence = line.trim_start().starts_with("```");
        code ^= fence;
        !code && !fence
    });
    prose.flat_map(|line| line.split('`').skip(1).step_by(2)).collect()
}

/// Targets of links that stay in the repository, without what stands behind `#`.
fn links(text: &str) -> Vec<&str> {
    let targets = text.split("](").skip(1).filter_map(|rest| rest.split_once(')')).map(|(target, _)| target);
    let files = targets.filter(|target| !target.contains("://") && !target.starts_with('#'));
    files.filter_map(|target| target.split('#').next()).collect()
}

/// Whether a word in backticks is the path of a file or a folder, and no example: those have names in capitals, or signs
/// that stand for more than one.
fn is_path(word: &str) -> bool {
    let name = |part: &str| part.chars().all(|c| c.is_ascii_alphanumeric() || "._-".contains(c));
    let example = |part: &str| {
        let stem = part.split('.').next().unwrap_or(part);
        stem.len() > 1
            && stem.chars().all(|c| c.is_ascii_uppercase())
            && !["README", "LICENSE"].contains(&stem)
    };
    let word = word.split("::").next().unwrap_or(word);
    word.contains('/')
        && !word.starts_with('/')
        && !MADE.iter().any(|folder| word.starts_with(folder))
        && ENDINGS.iter().any(|ending| word.ends_with(ending))
        && word.split('/').all(name)
        && !word.split('/').any(example)
}

/// Tests that the table of promises in the README names, and that are not there.
fn missing_tests(readme: &str, there: &BTreeSet<String>) -> Vec<String> {
    let table = readme.split("## What is promised").nth(1).unwrap_or_default();
    let table = table.split("\n## ").next().unwrap_or_default();
    let proofs =
        table.lines().filter(|line| line.starts_with('|')).filter_map(|line| line.rsplit('|').nth(1));
    let names = proofs.flat_map(quoted).filter(|name| name.contains('_') && !name.contains('/'));
    names.filter(|name| !there.contains(*name)).map(str::to_owned).collect()
}

/// Files that a document names, and that are not there.
fn missing_files(root: &Path, document: &Path, text: &str) -> Vec<String> {
    let folder = document.parent().unwrap_or(Path::new(""));
    let linked = links(text).into_iter().filter(|target| !root.join(folder).join(target).exists());
    let named = quoted(text).into_iter().filter(|word| is_path(word)).filter(|word| {
        let own = folder.to_str().unwrap_or_default();
        !ROOTS.iter().chain([&own]).any(|base| root.join(base).join(word).exists())
    });
    linked.chain(named).map(|name| format!("{}: {name}", document.display())).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn root() -> &'static Path {
        Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap()
    }

    fn read(path: &Path) -> String {
        fs::read_to_string(root().join(path)).unwrap()
    }

    #[test]
    fn tests_that_prove_promises_are_there() {
        let sources = tracked(root()).into_iter().filter(|path| path.extension().is_some_and(|e| e == "rs"));
        let there: BTreeSet<String> = sources.flat_map(|path| test_names(&read(&path))).collect();
        let missing = missing_tests(&read(Path::new("README.md")), &there);
        assert!(
            missing.is_empty(),
            "{missing:?}: named under 'What is promised' in README.md, but no test; if one was renamed, the table follows"
        );
    }

    #[test]
    fn files_that_documents_name_are_there() {
        let documents = tracked(root()).into_iter().filter(|path| {
            path.extension().is_some_and(|e| e == "md") && !HISTORY.iter().any(|name| path == Path::new(name))
        });
        let missing: Vec<_> = documents.flat_map(|path| missing_files(root(), &path, &read(&path))).collect();
        assert!(missing.is_empty(), "{missing:#?}: no such files; if they were moved, the documents follow");
    }

    #[test]
    fn every_decision_is_listed() {
        let folder = Path::new("docs/decisions");
        let index = read(&folder.join("README.md"));
        let listed: BTreeSet<&str> = links(&index).into_iter().collect();
        let pages = tracked(root()).into_iter().filter(|path| path.parent() == Some(folder));
        let names: Vec<String> =
            pages.map(|path| path.file_name().unwrap().to_string_lossy().into_owned()).collect();
        let missing: Vec<_> =
            names.iter().filter(|name| *name != "README.md" && !listed.contains(name.as_str())).collect();
        assert!(missing.is_empty() && names.len() > 1, "{missing:?}: not in {}/README.md", folder.display());
        for name in names.iter().filter(|name| *name != "README.md") {
            let text = read(&folder.join(name));
            for part in ["**Idea.**", "**Result.**", "**Cause.**", "**Again if**"] {
                assert!(text.contains(part), "{name} lacks {part}");
            }
        }
    }

    #[test]
    fn what_is_missing_is_found() {
        let there = test_names(
            "#[test]\nfn there() {}\nfn helper() {}\n    #[test]\n    #[cfg(unix)]\n    fn also_there() {\n",
        );
        assert_eq!(there, BTreeSet::from(["there", "also_there"].map(str::to_owned)));
        let readme = "`not_here`\n## What is promised\n| a | b |\n| it | `also_there`, `gone_away`, `src/lib.rs` |\n\n## End\n| `c_d` |\n";
        assert_eq!(missing_tests(readme, &there), ["gone_away"]);
        let text = "[a](src/lib.rs#there) [b](gone.md) `src/gone.rs` `src/lib.rs` `cpu/mod.rs` `src/NAME.rs` `a/b` `xtask/`\n```\n`src/x.rs`\n```\n";
        assert_eq!(
            missing_files(root(), Path::new("README.md"), text),
            ["README.md: gone.md", "README.md: src/gone.rs"]
        );
    }
}
