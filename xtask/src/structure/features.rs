//! The program and the viewer want the same features of what both use, so that nothing is built twice.

use std::collections::{BTreeMap, BTreeSet};

/// The features of each package in what `cargo tree --prefix none --no-dedupe --format "{p}|{f}"` prints; several sets
/// where it is built several times.
fn features(tree: &str) -> BTreeMap<&str, BTreeSet<&str>> {
    let mut found: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
    for (package, features) in tree.lines().filter_map(|line| line.split_once('|')) {
        found.entry(package).or_default().insert(features);
    }
    found
}

/// Packages of both trees whose features differ.
fn built_twice<'a>(one: &'a str, other: &'a str) -> BTreeMap<&'a str, [BTreeSet<&'a str>; 2]> {
    let mut others = features(other);
    let both = features(one)
        .into_iter()
        .filter_map(|(package, one)| Some((package, [one, others.remove(package)?])));
    both.filter(|(_, [one, other])| one != other).collect()
}

#[cfg(test)]
mod tests {
    use std::path::Path;
    use std::process::Command;

    use super::*;

    fn tree(package: &str) -> String {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
        let arguments =
            ["--locked", "--edges", "normal,build", "--prefix", "none", "--no-dedupe", "--format", "{p}|{f}"];
        let output = Command::new(env!("CARGO"))
            .current_dir(root)
            .args(["tree", "--package", package])
            .args(arguments)
            .output();
        let output = output.unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8(output.stdout).unwrap()
    }

    /// A lock file that lags behind would make the fuzzer build other versions than those that are tested.
    #[test]
    fn the_lock_file_of_the_fuzzer_is_fresh() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
        let arguments = [
            "tree",
            "--locked",
            "--no-default-features",
            "--manifest-path",
            "fuzz/Cargo.toml",
            "--depth",
            "0",
        ];
        let output = Command::new(env!("CARGO")).current_dir(root).args(arguments).output().unwrap();
        let problem = String::from_utf8_lossy(&output.stderr);
        assert!(
            output.status.success(),
            "{problem}\n'cargo update --manifest-path fuzz/Cargo.toml --workspace' mends that"
        );
    }

    /// On Linux; elsewhere nobody has made a list.
    #[cfg(target_os = "linux")]
    #[test]
    fn the_viewer_builds_nothing_again() {
        let [program, viewer] = ["pix2hdr", "pix2hdr-viewer"].map(tree);
        assert!(features(&program).len() > 100 && features(&viewer).len() > features(&program).len());
        let found = built_twice(&program, &viewer);
        assert!(
            found.is_empty(),
            "{found:#?}\nare built once for the program and once for the viewer: name the features that the second wants in \
             Cargo.toml, in the list of those that the viewer's window wants"
        );
    }

    #[test]
    fn other_features_are_found() {
        let one = "a v1|std\nb v1|\nb v1|std\nc v1|x,y\n";
        let other = "a v1|alloc,std\nb v1|std\nb v1|\nd v1|\nc v2|x\n";
        assert_eq!(built_twice(one, other).into_keys().collect::<Vec<_>>(), ["a v1"]);
    }
}
