//! Tables of figures in documents are made from records: what stands between `<!-- results: RECORD TABLE -->` and
//! `<!-- end -->` is generated.

mod record;
mod table;

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use self::record::{FOLDER, Record, outdated, read_all};
use crate::{Result, cargo, run, target};

const BEGIN: &str = "<!-- results: ";
const END: &str = "<!-- end -->";

/// Writes all tables anew; with `--check`, only says which ones differ. Says too which records are older than what they
/// measure, which is no failure: only a machine to measure on can mend that.
pub fn results(root: &Path, mut arguments: impl Iterator<Item = String>) -> Result<()> {
    let check = match (arguments.next().as_deref(), arguments.next()) {
        (None, _) => false,
        (Some("--check"), None) => true,
        _ => return Err(crate::USAGE.into()),
    };
    let records = read_all(root)?;
    let mut differing = Vec::new();
    for (path, old, new) in documents(root, &records)? {
        if old != new {
            differing.push(path.display().to_string());
            if !check {
                fs::write(root.join(&path), new).map_err(|e| format!("{}: {e}", path.display()))?;
                println!("{}: written", path.display());
            }
        }
    }
    for (name, record) in &records {
        if let Some(problem) = outdated(root, record) {
            println!("{FOLDER}/{name}.json may be out of date: {problem}");
        }
    }
    if check && !differing.is_empty() {
        return Err(format!("{} differ from {FOLDER}: run `cargo xtask results`", differing.join(", ")));
    }
    Ok(())
}

/// `record NAME -- ARGUMENTS`: runs the program and keeps what it prints.
pub fn record(root: &Path, mut arguments: impl Iterator<Item = String>) -> Result<()> {
    let (name, dashes) = (arguments.next().ok_or(crate::USAGE)?, arguments.next());
    let arguments: Vec<String> = arguments.collect();
    if dashes.as_deref() != Some("--") || arguments.is_empty() {
        return Err(crate::USAGE.into());
    }
    run(cargo().args(["build", "--release", "--package", "pix2hdr", "--bin", "pix2hdr"]).current_dir(root))?;
    let program = target(root).join("release").join(format!("pix2hdr{}", std::env::consts::EXE_SUFFIX));
    let path = record::record(root, &program, &name, &arguments)?;
    println!("{}: written; now `cargo xtask results`", path.display());
    Ok(())
}

/// Every document with tables: its path, what it holds, and what it should hold. Every table of every record has to be
/// shown somewhere.
fn documents(root: &Path, records: &BTreeMap<String, Record>) -> Result<Vec<(PathBuf, String, String)>> {
    let mut unseen: BTreeSet<String> = records
        .iter()
        .flat_map(|(name, record)| record.tables.keys().map(move |table| format!("{name} {table}")))
        .collect();
    let mut documents = Vec::new();
    for path in markdown_files(root)? {
        let text = fs::read_to_string(root.join(&path)).map_err(|e| format!("{}: {e}", path.display()))?;
        let folder = path.parent().unwrap_or(Path::new(""));
        let new = fill(&text, |what| {
            unseen.remove(what);
            generated(what, records, folder)
        })
        .map_err(|problem| format!("{}: {problem}", path.display()))?;
        documents.push((path, text, new));
    }
    if unseen.is_empty() { Ok(documents) } else { Err(format!("no document shows {unseen:?} of {FOLDER}")) }
}

/// README.md and what lies in docs/.
fn markdown_files(root: &Path) -> Result<Vec<PathBuf>> {
    let mut files = vec![PathBuf::from("README.md")];
    for entry in root.join("docs").read_dir().map_err(|e| format!("docs: {e}"))? {
        let name = entry.map_err(|e| e.to_string())?.file_name();
        if Path::new(&name).extension().is_some_and(|e| e == "md") {
            files.push(Path::new("docs").join(name));
        }
    }
    files.sort();
    Ok(files)
}

/// Puts what `generated` gives between each pair of marks.
fn fill(text: &str, mut generated: impl FnMut(&str) -> Result<String>) -> Result<String> {
    let mut new = String::new();
    let mut rest = text;
    while let Some(begin) = rest.find(BEGIN) {
        let (before, marked) = rest.split_at(begin);
        let (mark, behind) = marked.split_once('\n').ok_or("a mark without a table")?;
        let what = mark.strip_prefix(BEGIN).and_then(|mark| mark.strip_suffix(" -->"));
        let what = what.ok_or_else(|| format!("'{mark}' is no mark"))?;
        let end = behind.find(END).ok_or_else(|| format!("'{mark}' without '{END}'"))?;
        if behind[..end].contains(BEGIN) {
            return Err(format!("'{mark}' without '{END}'"));
        }
        new += &format!("{before}{mark}\n{}{END}", generated(what)?);
        rest = &behind[end + END.len()..];
    }
    Ok(new + rest)
}

/// A table and where it comes from, for a document in `folder`.
fn generated(what: &str, records: &BTreeMap<String, Record>, folder: &Path) -> Result<String> {
    let (name, table) =
        what.split_once(' ').ok_or_else(|| format!("'{what}' is not a record and a table"))?;
    let record = records.get(name).ok_or_else(|| format!("no record {FOLDER}/{name}.json"))?;
    let shown =
        record.tables.get(table).ok_or_else(|| format!("no table '{table}' in {FOLDER}/{name}.json"))?;
    let others = records.iter().map(|(name, record)| (name.as_str(), &record.figures)).collect();
    let text = shown.markdown(&record.figures, &others);
    let text = text.map_err(|problem| format!("{FOLDER}/{name}.json: {table}: {problem}"))?;
    let link =
        Path::new(FOLDER).strip_prefix(folder).unwrap_or(Path::new(FOLDER)).join(format!("{name}.json"));
    let machine = record.machine.as_ref().map_or_else(String::new, |machine| machine.describe() + ", ");
    let commits = if record.commits.len() == 1 { "commit" } else { "commits" };
    Ok(format!(
        "\n{text}\n[{name}]({}): {machine}{}, {commits} {}.\n\n",
        link.display().to_string().replace('\\', "/"),
        record.date,
        record.commits.join(", "),
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn root() -> &'static Path {
        Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap()
    }

    #[test]
    fn documents_show_what_records_hold() {
        results(root(), ["--check".to_owned()].into_iter()).unwrap();
    }

    #[test]
    fn records_name_what_they_measure() {
        for (name, record) in read_all(root()).unwrap() {
            assert!(!record.what.is_empty() && !record.command.is_empty(), "{name}");
            assert!(!record.commits.is_empty() && !record.measures.is_empty(), "{name}");
            for path in &record.measures {
                assert!(
                    root().join(path).exists(),
                    "{name}: there is no {path}; if it was moved, 'measures' in {FOLDER}/{name}.json follows"
                );
            }
        }
    }

    #[test]
    fn tables_are_put_between_marks() {
        let text = "a\n<!-- results: x y -->\nold\n<!-- end -->\nb <!-- results: z z -->\n<!-- end -->\n";
        let filled = fill(text, |what| Ok(format!("({what})\n"))).unwrap();
        assert_eq!(
            filled,
            "a\n<!-- results: x y -->\n(x y)\n<!-- end -->\nb <!-- results: z z -->\n(z z)\n<!-- end -->\n"
        );
        assert_eq!(fill(&filled, |what| Ok(format!("({what})\n"))).unwrap(), filled);
        for broken in ["<!-- results: x -->", "<!-- results: x -->\n", "<!-- results: x\n<!-- end -->"] {
            assert!(fill(broken, |_| Ok(String::new())).is_err(), "{broken}");
        }
        let unclosed = "<!-- results: x y -->\n<!-- results: x y -->\n<!-- end -->";
        assert!(fill(unclosed, |_| Ok(String::new())).is_err());
    }
}
