//! The rules: modules use only what stands before them, no files in a circle, nothing longer than a person can take in.
//!
//! What breaks a rule today is listed in `known.txt`, and nothing may be added there.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

use super::modules::{Module, Modules};

/// Most lines of a file, tests not included.
const FILE_LINES: usize = 500;
/// Most lines of a function that does not say why it is longer.
const FUNCTION_LINES: usize = 80;
/// How a comment above or in a function begins that says why it is longer.
const REASON: &str = "Long because";
/// Packages whose modules are looked at: their folder, and what their library is called.
const PACKAGES: [(&str, &str); 3] = [("", "pix2hdr"), ("viewer", "pix2hdr_viewer"), ("xtask", "xtask")];

/// The order of modules as ARCHITECTURE.md states it: groups from first to last. The line that has it begins with
/// `error math`.
fn order(architecture: &str) -> Vec<Vec<&str>> {
    let line = architecture.lines().find(|line| line.trim_start().starts_with("error math"));
    let line =
        line.expect("ARCHITECTURE.md has a line with the order of modules, which begins with 'error math'");
    line.split('|').map(|group| group.split_whitespace().collect()).collect()
}

/// Uses of a module that does not stand before the one that uses it.
fn against_order(modules: &Modules, order: &[Vec<&str>]) -> BTreeSet<String> {
    let rank = |top: &str| order.iter().position(|group| group.contains(&top));
    let mut found = BTreeSet::new();
    for (module, used) in modules.uses() {
        let Some(top) = module.first() else { continue };
        for used in used.iter().filter_map(|used| used.first()).filter(|used| *used != top) {
            if rank(used) >= rank(top) {
                found.insert(format!("order: {} uses {used}", path(modules, module)));
            }
        }
    }
    found
}

/// Uses that lie on a circle of files of one folder, where a file and the folder of its name count as one. A circle through
/// the folder's own `mod.rs` is one finding: nearly every file lies on it.
fn circles(modules: &Modules) -> BTreeSet<String> {
    let uses = modules.uses();
    let folders: BTreeSet<&[String]> =
        uses.keys().filter_map(|module| Some(module.split_last()?.1)).collect();
    let mut found = BTreeSet::new();
    for folder in folders {
        // `None` is the folder's own file.
        let unit = |module: &Module| module.starts_with(folder).then(|| module.get(folder.len()).cloned());
        let mut edges: BTreeMap<Option<String>, BTreeSet<Option<String>>> = BTreeMap::new();
        for (module, used) in &uses {
            if let Some(from) = unit(module) {
                let to = used.iter().filter_map(unit).filter(|to| *to != from);
                edges.entry(from.clone()).or_default().extend(to);
            }
        }
        let at = |name: &str| {
            if folder.is_empty() { name.to_owned() } else { format!("{}/{name}", folder.join("/")) }
        };
        let own = edges.remove(&None).unwrap_or_default();
        // A crate's root holds what all share, and starts all.
        if !folder.is_empty() && own.iter().any(|child| reaches(&edges, child, &None)) {
            found.insert(format!("circle: {} uses files that use it", at("mod")));
        }
        for (from, used) in &edges {
            for to in used.iter().filter(|to| to.is_some() && reaches(&edges, to, from)) {
                let name = |unit: &Option<String>| unit.clone().unwrap_or_default();
                found.insert(format!("circle: {} uses {}", at(&name(from)), name(to)));
            }
        }
    }
    found
}

/// Whether a way leads from `from` to `to`.
fn reaches<T: Ord>(edges: &BTreeMap<T, BTreeSet<T>>, from: &T, to: &T) -> bool {
    let (mut seen, mut left) = (BTreeSet::new(), vec![from]);
    while let Some(next) = left.pop() {
        if next == to {
            return true;
        }
        if seen.insert(next) {
            left.extend(edges.get(next).into_iter().flatten());
        }
    }
    false
}

/// Files and functions that are too long.
fn lengths(root: &Path, modules: &Modules) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    for (module, file) in modules.files() {
        let path = path(modules, module);
        if file.source.length > FILE_LINES {
            found.insert(format!("file: {path}"));
        }
        let text = fs::read_to_string(root.join(&file.path)).expect("it was read before");
        let lines: Vec<&str> = text.lines().collect();
        for (name, range) in &file.source.functions {
            if range.len() > FUNCTION_LINES && !says_why(&lines, range.start - 1, range.end - 1) {
                found.insert(format!("function: {path}: {name}"));
            }
        }
    }
    found
}

/// Whether a comment right above or inside of the lines begins with [`REASON`].
fn says_why(lines: &[&str], begin: usize, end: usize) -> bool {
    let above = lines[..begin]
        .iter()
        .rev()
        .take_while(|line| ["//", "#[", "/*"].iter().any(|start| line.trim_start().starts_with(start)));
    above.chain(&lines[begin..end]).any(|line| {
        line.trim_start()
            .strip_prefix("//")
            .is_some_and(|text| text.trim_start_matches(['/', ' ']).contains(REASON))
    })
}

fn path(modules: &Modules, module: &Module) -> String {
    let (_, file) = modules.files().find(|(other, _)| *other == module).expect("a module has a file");
    file.path.display().to_string().replace('\\', "/")
}

#[cfg(test)]
mod tests {
    use super::super::modules::package;
    use super::*;

    fn root() -> &'static Path {
        Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap()
    }

    fn architecture() -> String {
        fs::read_to_string(root().join("ARCHITECTURE.md")).unwrap()
    }

    #[test]
    fn architecture_orders_the_modules_that_are_there() {
        let text = architecture();
        let listed: BTreeSet<&str> = order(&text).concat().into_iter().collect();
        let modules = Modules::read(root(), "", "pix2hdr");
        let there: BTreeSet<&str> =
            modules.files().filter_map(|(module, _)| module.first()).map(String::as_str).collect();
        assert_eq!(
            listed, there,
            "left: the line in ARCHITECTURE.md that begins with 'error math'; right: the modules of src/. Put a new \
             module there behind all that it uses"
        );
    }

    #[test]
    fn the_source_keeps_the_rules_but_where_it_is_known_not_to() {
        let known: BTreeSet<String> = include_str!("known.txt").lines().map(str::to_owned).collect();
        let text = architecture();
        let mut found = BTreeSet::new();
        for (package, name) in PACKAGES {
            let modules = Modules::read(root(), package, name);
            if package.is_empty() {
                found.extend(against_order(&modules, &order(&text)));
            }
            // Between the modules of src/ order matters, which is more.
            found.extend(
                circles(&modules).into_iter().filter(|circle| !package.is_empty() || circle.contains('/')),
            );
            found.extend(lengths(root(), &modules));
        }
        let new: Vec<_> = found.difference(&known).collect();
        assert!(
            new.is_empty(),
            "{new:#?}\norder: a module may use only those before it in ARCHITECTURE.md's line 'error math …': move what \
             is used there, or the code that uses it\ncircle: move what both need into a file of its own, or let one \
             give it to the other\nfile: more than {FILE_LINES} lines without tests: split it\nfunction: more than \
             {FUNCTION_LINES} lines: split it, or say in a comment above it '{REASON} …'"
        );
        let gone: Vec<_> = known.difference(&found).collect();
        assert!(gone.is_empty(), "{gone:#?}\nis no longer so: remove it from xtask/src/structure/known.txt");
    }

    #[test]
    fn uses_against_the_order_are_found() {
        let text = "# A\n\n```\nerror math | video | cpu gpu\n```\n";
        assert_eq!(order(text), [vec!["error", "math"], vec!["video"], vec!["cpu", "gpu"]]);
        let modules = package(
            "order",
            &[
                ("lib.rs", "mod error; mod math; mod video; mod cpu; mod gpu; pub use error::Error;"),
                ("error.rs", "pub enum Error { Video(crate::video::Problem) }"),
                ("math.rs", "fn f() -> crate::Error { g() }"),
                (
                    "video.rs",
                    "pub struct Problem; use crate::error::Error; #[cfg(test)] mod tests { use crate::gpu::G; }",
                ),
                ("cpu.rs", "use crate::{video::Problem, gpu::G};"),
                ("gpu.rs", "pub struct G;"),
            ],
        );
        let found: Vec<_> = against_order(&modules, &order(text)).into_iter().collect();
        assert_eq!(
            found,
            ["order: src/cpu.rs uses gpu", "order: src/error.rs uses video", "order: src/math.rs uses error"]
        );
    }

    #[test]
    fn circles_are_found_at_any_length() {
        let modules = package(
            "circles",
            &[
                ("lib.rs", "mod a; mod b;"),
                ("a/mod.rs", "mod one; mod two; mod three; mod four; pub use one::One; pub struct Shared;"),
                ("a/one.rs", "use super::two::Two; pub struct One;"),
                ("a/two.rs", "use super::three::inner::Three; pub struct Two;"),
                ("a/three.rs", "pub mod inner;"),
                ("a/three/inner.rs", "pub struct Three; fn f() { crate::a::One }"),
                ("a/four.rs", "use super::{One, Shared};"),
                ("b/mod.rs", "mod one; fn f(_: one::One) {} pub struct Shared;"),
                ("b/one.rs", "pub struct One(super::Shared);"),
            ],
        );
        let found: Vec<_> = circles(&modules).into_iter().collect();
        assert_eq!(
            found,
            [
                "circle: a/one uses two",
                "circle: a/three uses one",
                "circle: a/two uses three",
                "circle: b/mod uses files that use it",
            ]
        );
    }

    #[test]
    fn what_is_too_long_is_found() {
        let body = "    work();\n".repeat(FUNCTION_LINES - 1);
        let lib = format!(
            "fn long() {{\n{body}}}\n// Long because it is a test.\nfn known() {{\n{body}}}\n#[cfg(test)]\nmod tests \
             {{\n{}}}\n",
            body.repeat(6)
        );
        let modules = package("length", &[("lib.rs", &lib)]);
        let root = std::env::temp_dir().join(format!("pix2hdr-xtask-length-{}", std::process::id()));
        assert_eq!(lengths(&root, &modules).into_iter().collect::<Vec<_>>(), ["function: src/lib.rs: long"]);
        let modules = package("length", &[("lib.rs", &"// A line.\n".repeat(FILE_LINES + 1))]);
        assert_eq!(lengths(&root, &modules).into_iter().collect::<Vec<_>>(), ["file: src/lib.rs"]);
    }

    #[test]
    fn a_long_function_may_say_why() {
        let lines = ["let a;", "/// Does it.", "// Long because of it.", "#[inline]", "fn f() {", "}"];
        assert!(says_why(&lines, 4, 6));
        assert!(!says_why(&lines[..2], 0, 2));
        assert!(!says_why(&["// Long because", "}", "fn f() {", "}"], 2, 4));
        assert!(says_why(&["fn f() {", "    // Long because", "}"], 0, 3));
    }
}
