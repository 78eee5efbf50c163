//! Names of the pictures of one sequence: alike but for one number, which counts frames.

use std::collections::BTreeMap;

use super::super::VideoError;

/// A name cut into what stands between its numbers, and the numbers.
fn parts(name: &str) -> (Vec<&str>, Vec<&str>) {
    let (mut between, mut numbers, mut rest) = (Vec::new(), Vec::new(), name);
    while let Some(begin) = rest.find(|c: char| c.is_ascii_digit()) {
        let (text, digits) = rest.split_at(begin);
        let end = digits.find(|c: char| !c.is_ascii_digit()).unwrap_or(digits.len());
        between.push(text);
        numbers.push(&digits[..end]);
        rest = &digits[end..];
    }
    between.push(rest);
    (between, numbers)
}

/// Refuses names, in their order and without their endings, that are of several sequences, or of one with gaps. Names
/// without numbers are taken as they come.
pub(super) fn check_sequence(names: &[String]) -> Result<(), VideoError> {
    let cut: Vec<_> = names.iter().map(|name| parts(name)).collect();
    if cut.iter().all(|(_, numbers)| numbers.is_empty()) {
        return Ok(());
    }
    let mut alike: BTreeMap<&[&str], Vec<usize>> = BTreeMap::new();
    for (i, (between, _)) in cut.iter().enumerate() {
        alike.entry(between).or_default().push(i);
    }
    let mut sequences: BTreeMap<String, Vec<(u64, &str)>> = BTreeMap::new();
    for (between, members) in alike {
        // The number that counts frames is the last one that differs.
        let number = |i: usize, at: usize| cut[i].1[at];
        let differs = |at: usize| members.iter().any(|&i| number(i, at) != number(members[0], at));
        let counts = (0..between.len() - 1).rev().find(|&at| differs(at));
        for &i in &members {
            let count = counts.map_or(Ok(0), |at| number(i, at).parse());
            let count = count.map_err(|_| {
                VideoError::Format(format!("the number of picture '{}' is too large", names[i]))
            })?;
            let mut key = String::new();
            for (at, text) in between.iter().enumerate() {
                key += text;
                key += if counts == Some(at) { "#" } else { cut[i].1.get(at).unwrap_or(&"") };
            }
            sequences.entry(key).or_default().push((count, &names[i]));
        }
    }
    if sequences.len() > 1 {
        let shown: Vec<_> =
            sequences.iter().take(4).map(|(key, frames)| format!("'{key}' ({})", frames.len())).collect();
        let more = if sequences.len() > 4 { ", …" } else { "" };
        return Err(VideoError::Format(format!(
            "holds pictures of {} sequences: {}{more}; give each a folder of its own",
            sequences.len(),
            shown.join(", ")
        )));
    }
    let mut frames = sequences.into_values().next().unwrap_or_default();
    frames.sort_unstable();
    match frames.windows(2).find(|pair| pair[1].0 != pair[0].0 + 1) {
        Some([(a, before), (b, after)]) if a == b => {
            Err(VideoError::Format(format!("'{before}' and '{after}' are the same frame")))
        }
        Some([(a, before), (b, after)]) => Err(VideoError::Format(format!(
            "misses {} between '{before}' and '{after}'; number its pictures without gaps",
            if b - a == 2 { format!("frame {}", a + 1) } else { format!("frames {} to {}", a + 1, b - 1) },
        ))),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::check_sequence;

    fn check(names: &[&str]) -> Result<(), String> {
        let names: Vec<String> = names.iter().map(|&name| name.into()).collect();
        check_sequence(&names).map_err(|error| error.to_string())
    }

    #[test]
    fn one_sequence_is_taken() {
        for names in [
            &["frame-00000", "frame-00001", "frame-00002"][..],
            &["f.9", "f.10", "f.11"],
            &["7", "8"],
            &["shot2_v1_1001_1920x1080", "shot2_v1_1002_1920x1080"],
            &["a", "b"],
            &["only7"],
            &[],
        ] {
            assert_eq!(check(names), Ok(()), "{names:?}");
        }
    }

    #[test]
    fn gaps_are_named() {
        let error = check(&["f0", "f1", "f2", "f4", "f5", "f9"]).unwrap_err();
        assert!(error.contains("frame 3 between 'f2' and 'f4'"), "{error}");
        let error = check(&["f.0008", "f.0012"]).unwrap_err();
        assert!(error.contains("frames 9 to 11"), "{error}");
        assert!(check(&["f1", "f01"]).unwrap_err().contains("same frame"));
        assert!(check(&["f1", "f99999999999999999999999"]).unwrap_err().contains("too large"));
    }

    #[test]
    fn several_sequences_are_named() {
        for (names, first, second) in [
            (&["a0", "a1", "b0", "b1"][..], "'a#' (2)", "'b#' (2)"),
            (&["cam1_0", "cam1_1", "cam2_0", "cam2_1"], "'cam1_#' (2)", "'cam2_#' (2)"),
            (&["f0", "f1", "reference"], "'f#' (2)", "'reference' (1)"),
            (&["f0", "f0_mask", "f1", "f1_mask"], "'f#' (2)", "'f#_mask' (2)"),
        ] {
            let error = check(names).unwrap_err();
            assert!(error.contains(first) && error.contains(second), "{error}");
        }
    }
}
