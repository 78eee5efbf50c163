//! The modules of a package, and which one uses which: paths are followed through re-exports to the file that holds what
//! they name.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use super::source::{Source, Token};

/// A module, by its path from the crate's root: `["sensor", "capture"]`.
pub type Module = Vec<String>;

/// All modules of a package: of its library, or of its program if that is all.
pub struct Modules {
    /// What the library is called in paths.
    name: String,
    files: BTreeMap<Module, File>,
}

/// A module's file.
pub struct File {
    /// From the repository.
    pub path: PathBuf,
    pub source: Source,
    /// Names that `use` brings in, and what they stand for.
    imports: Vec<Import>,
    /// Names of items that the file defines.
    items: BTreeSet<String>,
    /// Paths that its code names, `use` included; a re-export only if the file's own code needs it.
    uses: Vec<Vec<String>>,
}

struct Import {
    /// `*` brings in everything.
    name: String,
    path: Vec<String>,
    public: bool,
}

impl Modules {
    /// Reads the package in the folder `package` of the repository `root`; other crates call its library `name`.
    pub fn read(root: &Path, package: &str, name: &str) -> Self {
        let mut modules = Self { name: name.to_owned(), files: BTreeMap::new() };
        let folder = Path::new(package).join("src");
        let library = folder.join("lib.rs");
        let top = if root.join(&library).is_file() { library } else { folder.join("main.rs") };
        modules.add(root, &top, &folder, Module::new());
        modules.resolve_own_names();
        modules
    }

    fn add(&mut self, root: &Path, path: &Path, children: &Path, module: Module) {
        let text = fs::read_to_string(root.join(path)).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        let source = Source::parse(&text);
        for (child, test) in &source.children {
            if !test {
                self.add_child(root, children, &module, child);
            }
        }
        let (imports, uses) = paths(&source.tokens, &self.name);
        let items = items(&source.tokens);
        self.files.insert(module, File { path: path.to_owned(), source, imports, items, uses });
    }

    fn add_child(&mut self, root: &Path, folder: &Path, parent: &Module, name: &str) {
        let children = folder.join(name);
        let beside = folder.join(format!("{name}.rs"));
        let path = if root.join(&beside).is_file() { beside } else { children.join("mod.rs") };
        let module = parent.iter().cloned().chain([name.to_owned()]).collect();
        self.add(root, &path, &children, module);
    }

    /// Adds paths that begin with a child's name, such as `capture::read` in `sensor/mod.rs`.
    fn resolve_own_names(&mut self) {
        let modules: BTreeSet<Module> = self.files.keys().cloned().collect();
        for (module, file) in &mut self.files {
            let tokens = &file.source.tokens;
            for (i, window) in tokens.windows(2).enumerate() {
                let child: Module = module.iter().cloned().chain([window[0].text.clone()]).collect();
                let begins = i == 0 || tokens[i - 1].text != "::";
                if window[1].text == "::" && begins && modules.contains(&child) {
                    let path = path_at(tokens, i);
                    if !in_use(tokens, i) {
                        file.uses.push(path);
                    }
                }
            }
        }
    }

    /// Every file, with its module.
    pub fn files(&self) -> impl Iterator<Item = (&Module, &File)> {
        self.files.iter()
    }

    /// Every module that each module uses, itself not included.
    pub fn uses(&self) -> BTreeMap<&Module, BTreeSet<Module>> {
        let of = |module: &Module, file: &File| {
            let used = file.uses.iter().filter_map(|path| self.resolve(module, path, 0));
            used.filter(|used| used != module).collect()
        };
        self.files.iter().map(|(module, file)| (module, of(module, file))).collect()
    }

    /// The module that holds what `path` names, seen from `module`; `None` for other crates.
    fn resolve(&self, module: &Module, path: &[String], depth: usize) -> Option<Module> {
        // Names that stand for each other would be followed forever.
        if depth > 16 {
            return None;
        }
        let (first, mut rest) = path.split_first()?;
        let mut at = match first.as_str() {
            "crate" => Module::new(),
            name if name == self.name => Module::new(),
            "self" => module.clone(),
            "super" => module.split_last()?.1.to_vec(),
            name => {
                let child: Module = module.iter().cloned().chain([name.to_owned()]).collect();
                if !self.files.contains_key(&child) {
                    return None;
                }
                child
            }
        };
        while let Some((name, behind)) = rest.split_first() {
            let file = self.files.get(&at)?;
            let child: Module = at.iter().cloned().chain([name.clone()]).collect();
            if name == "super" {
                at.pop();
            } else if self.files.contains_key(&child) {
                at = child;
            } else if name == "self" || name == "*" || file.items.contains(name) {
                return Some(at);
            } else {
                let named = file.imports.iter().find(|import| import.name == *name);
                let whole = |import: &&Import| {
                    import.name == "*" && self.resolve(&at, &import.path, depth + 1).is_some()
                };
                let import = named.or_else(|| file.imports.iter().find(whole));
                let Some(import) = import else { return Some(at) };
                let path: Vec<String> = match import.name.as_str() {
                    "*" => import.path.iter().filter(|name| *name != "*").chain(rest).cloned().collect(),
                    _ => import.path.iter().chain(behind).cloned().collect(),
                };
                // What comes from another crate belongs to the module that passes it on.
                return self.resolve(&at, &path, depth + 1).or(Some(at));
            }
            rest = behind;
        }
        Some(at)
    }
}

/// Whether the token at `i` is a part of a `use` statement.
fn in_use(tokens: &[Token], i: usize) -> bool {
    tokens[..i]
        .iter()
        .rev()
        .find(|token| token.text == ";" || token.text == "use")
        .is_some_and(|token| token.text == "use")
}

/// The path that begins at `i`.
fn path_at(tokens: &[Token], i: usize) -> Vec<String> {
    let mut path = vec![tokens[i].text.clone()];
    let mut rest = &tokens[i + 1..];
    while let [colons, name, behind @ ..] = rest {
        if colons.text != "::" || !is_name(&name.text) {
            break;
        }
        path.push(name.text.clone());
        rest = behind;
    }
    path
}

fn is_name(text: &str) -> bool {
    text.starts_with(|c: char| c.is_alphabetic() || c == '_')
}

/// What a file imports, and all paths that its code uses.
fn paths<'a>(tokens: &'a [Token], own: &'a str) -> (Vec<Import>, Vec<Vec<String>>) {
    let (mut imports, mut uses, mut mentioned) = (Vec::new(), Vec::new(), BTreeSet::new());
    let mut i = 0;
    while i < tokens.len() {
        let text = tokens[i].text.as_str();
        if text == "use" {
            let end = tokens[i..].iter().position(|token| token.text == ";").map_or(tokens.len(), |n| i + n);
            let public = i > 0 && (tokens[i - 1].text == "pub" || tokens[i - 1].text == ")");
            tree(&tokens[i + 1..end], &[], public, &mut imports);
            i = end;
        } else {
            let begins = i == 0 || !["::", "in"].contains(&tokens[i - 1].text.as_str());
            let path = path_at(tokens, i);
            if begins && path.len() > 1 && ["crate", "self", "super", own].contains(&text) {
                uses.push(path);
            }
            if i == 0 || tokens[i - 1].text != "mod" {
                mentioned.insert(text);
            }
        }
        i += 1;
    }
    let needed = |import: &&Import| !import.public || mentioned.contains(import.name.as_str());
    uses.extend(imports.iter().filter(needed).map(|import| import.path.clone()));
    (imports, uses)
}

/// Spreads a `use` tree: `a::{b, c as d}` brings in `b` and `d`.
fn tree(tokens: &[Token], before: &[String], public: bool, imports: &mut Vec<Import>) {
    let mut path = before.to_vec();
    let mut name = None;
    for (i, token) in tokens.iter().enumerate() {
        match token.text.as_str() {
            "::" => {}
            "{" => {
                for part in split(&tokens[i + 1..tokens.len() - 1]) {
                    tree(part, &path, public, imports);
                }
                return;
            }
            "as" => {
                name = tokens.get(i + 1).map(|token| token.text.clone());
                break;
            }
            "self" if !path.is_empty() => {}
            text => path.push(text.to_owned()),
        }
    }
    if let Some(last) = path.last() {
        imports.push(Import { name: name.unwrap_or_else(|| last.clone()), path, public });
    }
}

/// The parts between commas that are not inside of braces.
fn split(tokens: &[Token]) -> Vec<&[Token]> {
    let (mut depth, mut parts, mut begin) = (0, Vec::new(), 0);
    for (i, token) in tokens.iter().enumerate() {
        match token.text.as_str() {
            "{" => depth += 1,
            "}" => depth -= 1,
            "," if depth == 0 => {
                parts.push(&tokens[begin..i]);
                begin = i + 1;
            }
            _ => {}
        }
    }
    parts.push(&tokens[begin..]);
    parts.retain(|part| !part.is_empty());
    parts
}

/// Names of what a file defines.
fn items(tokens: &[Token]) -> BTreeSet<String> {
    let kinds = ["fn", "struct", "enum", "trait", "type", "const", "static", "union"];
    let named = |pair: &&[Token]| kinds.contains(&pair[0].text.as_str()) && is_name(&pair[1].text);
    tokens.windows(2).filter(named).map(|pair| pair[1].text.clone()).collect()
}

/// A package of these files in a temporary folder, for tests.
pub fn package(test: &str, files: &[(&str, &str)]) -> Modules {
    let root = std::env::temp_dir().join(format!("pix2hdr-xtask-{test}-{}", std::process::id()));
    for (name, text) in files {
        let path = root.join("src").join(name);
        fs::create_dir_all(path.parent().expect("it has a name")).expect("a temporary folder");
        fs::write(path, text).expect("a file in a temporary folder");
    }
    Modules::read(&root, "", "pix2hdr")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn used(modules: &Modules, module: &[&str]) -> Vec<String> {
        let module: Module = module.iter().map(|&name| name.to_owned()).collect();
        modules.uses()[&module].iter().map(|used| used.join("::")).collect()
    }

    #[test]
    fn paths_lead_to_the_file_that_holds_what_they_name() {
        let modules = package(
            "paths",
            &[
                ("lib.rs", "pub mod a;\nmod b;\nmod cli; mod error;\npub use error::{At, Result};\n"),
                ("error.rs", "pub struct At; pub type Result = (); fn f() { crate::b::c::D; }"),
                (
                    "a/mod.rs",
                    "mod one; mod two; pub use one::{One, Other as Another}; pub use two::*; fn g() { two::f() }",
                ),
                ("a/one.rs", "pub struct One; pub struct Other; #[cfg(test)] mod tests { use crate::b::B; }"),
                ("a/two.rs", "use super::{Another, one::{self}}; pub fn f() {} use std::fmt;"),
                ("b/mod.rs", "pub mod c; pub use c::c; pub use crate::a::{f as g, One};"),
                (
                    "b/c.rs",
                    "use crate::{Result, a::One}; pub fn c() {} pub(in crate::a) fn h() { super::g() } // crate::error",
                ),
                ("cli.rs", "use pix2hdr::b::c; use crate::a;"),
            ],
        );
        assert_eq!(used(&modules, &[]), Vec::<String>::new());
        assert_eq!(used(&modules, &["error"]), ["b::c"]);
        assert_eq!(used(&modules, &["a"]), ["a::two"]);
        assert_eq!(used(&modules, &["a", "one"]), Vec::<String>::new());
        assert_eq!(used(&modules, &["a", "two"]), ["a::one"]);
        assert_eq!(used(&modules, &["b"]), Vec::<String>::new());
        assert_eq!(used(&modules, &["b", "c"]), ["a::one", "a::two", "error"]);
        assert_eq!(used(&modules, &["cli"]), ["a", "b::c"]);
    }
}
