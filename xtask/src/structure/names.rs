//! One word, one meaning: no two public types of the library share a name.

use std::collections::{BTreeMap, BTreeSet};

use super::modules::Modules;
use super::source::Token;

/// Names that may occur twice, and why.
const KNOWN: [(&str, &str); 2] = [
    ("Precision", "the command line's words for the library's choices"),
    ("Skip", "the command line's words for the library's choices"),
];

/// Public types that a file defines.
fn public_types(tokens: &[Token]) -> impl Iterator<Item = &str> {
    let kinds = ["struct", "enum", "trait", "type", "union"];
    tokens
        .windows(3)
        .filter(move |w| w[0].text == "pub" && kinds.contains(&w[1].text.as_str()))
        .map(|w| w[2].text.as_str())
}

/// Names of public types that several files define, with the files. Associated types are of their traits.
fn shared(modules: &Modules) -> BTreeMap<String, BTreeSet<String>> {
    let mut files: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    for (_, file) in modules.files() {
        for name in public_types(&file.source.tokens) {
            files.entry(name.to_owned()).or_default().insert(file.path.display().to_string());
        }
    }
    files.retain(|_, files| files.len() > 1);
    files
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::super::modules::package;
    use super::*;

    #[test]
    fn a_name_means_one_type() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
        let found = shared(&Modules::read(root, "", "pix2hdr"));
        let known: BTreeSet<&str> = KNOWN.iter().map(|(name, _)| *name).collect();
        let new: Vec<_> = found.iter().filter(|(name, _)| !known.contains(name.as_str())).collect();
        assert!(
            new.is_empty(),
            "{new:#?}\nare names of two public types each: give one of them the word that docs/design.md §2 has for it"
        );
        let gone: Vec<_> = KNOWN.iter().filter(|(name, _)| !found.contains_key(*name)).collect();
        assert!(gone.is_empty(), "{gone:?}\noccur once only: remove them from xtask/src/structure/names.rs");
    }

    #[test]
    fn names_of_two_types_are_found() {
        let files = [
            ("lib.rs", "mod a; mod b; pub use a::Tile;"),
            ("a.rs", "pub struct Tile; pub(crate) struct Own; struct Private; pub type Size = usize;"),
            (
                "b.rs",
                "/// pub struct Size\npub enum Tile {} struct Own; pub struct Private; #[cfg(test)] mod tests { pub struct Size; }",
            ),
        ];
        let found = shared(&package("names", &files));
        assert_eq!(found.keys().collect::<Vec<_>>(), ["Tile"]);
    }
}
