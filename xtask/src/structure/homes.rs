//! What comes has a home: an operation, or a format of files, is named in its own files and in one table, so that another
//! one touches no more than CONTRIBUTING.md says.

use std::collections::BTreeSet;

use super::modules::Modules;
use super::source::Token;

/// Files of a package whose code, tests aside, has tokens in a row for which `named` holds.
fn files_with(modules: &Modules, named: impl Fn(&[Token]) -> bool) -> BTreeSet<String> {
    let found = modules.files().filter(|(_, file)| file.source.tokens.windows(2).any(&named));
    found.map(|(_, file)| file.path.display().to_string()).collect()
}

/// Whether this module's name begins the tokens, in a path, or is declared by them.
fn module(pair: &[Token], name: &str) -> bool {
    matches!(pair, [first, second]
        if first.text == name && second.text == "::" || first.text == "mod" && second.text == name)
}

/// Whether the second token is this name.
fn item(pair: &[Token], name: &str) -> bool {
    pair[1].text == name
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::Path;

    use super::super::modules::package;
    use super::*;

    fn root() -> &'static Path {
        Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap()
    }

    fn assert_only(found: &BTreeSet<String>, expected: &[&str]) {
        let expected: BTreeSet<String> = expected.iter().map(|&path| path.to_owned()).collect();
        assert_eq!(*found, expected, "left: files that name it; right: those that CONTRIBUTING.md lists");
    }

    /// `fuse` stands for all: nothing else has that name, and nothing but nets uses it.
    #[test]
    fn an_operation_is_named_in_its_own_files_and_one_table() {
        let found = files_with(&Modules::read(root(), "", "pix2hdr"), |pair| {
            module(pair, "fuse") || item(pair, "Fuse")
        });
        let files = ["src/cpu/fuse.rs", "src/cpu/mod.rs", "src/network/op/fuse.rs", "src/network/op/mod.rs"];
        assert_only(&found, &files);
        let python = root().join("training/pix2hdr_training");
        for (file, is_home) in [("operations.py", true), ("graph.py", false), ("layout.py", false)] {
            let text = fs::read_to_string(python.join(file)).unwrap();
            assert_eq!(text.contains("\"fuse\""), is_home, "{file}");
        }
    }

    /// `radiance` stands for all.
    #[test]
    fn a_file_format_is_named_in_its_own_file_and_one_table() {
        let found = files_with(&Modules::read(root(), "", "pix2hdr"), |pair| module(pair, "radiance"));
        assert_only(&found, &["src/video/files.rs", "src/video/mod.rs"]);
    }

    #[test]
    fn names_are_found() {
        let files = [
            ("lib.rs", "mod a; mod b; mod fuse;"),
            ("a.rs", "fn f() { fuse::run() } fn g(fuse: usize) {}"),
            ("b.rs", "fn f(fuse: usize) { fuse + 1; } #[cfg(test)] mod tests { fn f(_: Fuse) {} }"),
            ("fuse.rs", "pub struct Fuse;"),
        ];
        let found = files_with(&package("homes", &files), |pair| module(pair, "fuse") || item(pair, "Fuse"));
        assert_eq!(found.into_iter().collect::<Vec<_>>(), ["src/a.rs", "src/fuse.rs", "src/lib.rs"]);
    }
}
