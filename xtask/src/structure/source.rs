//! A source file as words, without comments, literals and tests: enough to see what it uses and how long it is.

use std::ops::Range;

/// A name, a number, `::`, or a single character of anything else.
#[derive(Clone, Debug, PartialEq)]
pub struct Token {
    pub text: String,
    /// From 1.
    pub line: usize,
}

/// What is known of a file.
#[derive(Debug, Default)]
pub struct Source {
    /// All tokens that are no part of a test.
    pub tokens: Vec<Token>,
    /// Lines that are no part of a test.
    pub length: usize,
    /// Modules in files of their own; `true` if they are tests.
    pub children: Vec<(String, bool)>,
    /// Every function outside of tests: its name, and the lines from `fn` to its closing brace.
    pub functions: Vec<(String, Range<usize>)>,
}

impl Source {
    /// Reads a file.
    pub fn parse(text: &str) -> Self {
        let (tokens, tests, test_children) = without_tests(&tokens(text));
        let tested: usize = tests.iter().map(ExactSizeIterator::len).sum();
        let mut children: Vec<_> = test_children.into_iter().map(|name| (name, true)).collect();
        children.extend(
            tokens
                .windows(3)
                .filter(|w| w[0].text == "mod" && w[2].text == ";")
                .map(|w| (w[1].text.clone(), false)),
        );
        let functions = functions(&tokens);
        Self { length: text.lines().count() - tested, tokens, children, functions }
    }
}

/// Splits a text into tokens. Literals become `""`; comments and lifetimes go.
fn tokens(text: &str) -> Vec<Token> {
    let chars: Vec<char> = text.chars().collect();
    let (mut found, mut i, mut line) = (Vec::new(), 0, 1);
    let at = |i: usize| chars.get(i).copied().unwrap_or('\0');
    while i < chars.len() {
        let begin = i;
        let token_line = line;
        let text = match at(i) {
            '/' if at(i + 1) == '/' => {
                while i < chars.len() && at(i) != '\n' {
                    i += 1;
                }
                None
            }
            '/' if at(i + 1) == '*' => {
                i = after_block_comment(&chars, i);
                None
            }
            '"' => {
                i = after_string(&chars, i);
                Some("\"\"".to_owned())
            }
            '\'' if at(i + 1) == '\\' || at(i + 2) == '\'' => {
                i += if at(i + 1) == '\\' { 3 } else { 2 };
                while i < chars.len() && at(i) != '\'' {
                    i += 1;
                }
                i += 1;
                Some("\"\"".to_owned())
            }
            '\'' => {
                i += 1;
                while at(i).is_alphanumeric() || at(i) == '_' {
                    i += 1;
                }
                None
            }
            c if c.is_alphanumeric() || c == '_' => {
                while at(i).is_alphanumeric() || at(i) == '_' {
                    i += 1;
                }
                let word: String = chars[begin..i].iter().collect();
                let prefix = ["r", "b", "c", "br", "cr"].contains(&word.as_str());
                if prefix && word.ends_with('r') && raw_string(&chars, i).is_some() {
                    i = raw_string(&chars, i).unwrap_or(i);
                    Some("\"\"".to_owned())
                } else if prefix && at(i) == '"' {
                    i = after_string(&chars, i);
                    Some("\"\"".to_owned())
                } else {
                    Some(word)
                }
            }
            ':' if at(i + 1) == ':' => {
                i += 2;
                Some("::".to_owned())
            }
            c => {
                i += 1;
                (!c.is_whitespace()).then(|| c.to_string())
            }
        };
        line += chars[begin..i.min(chars.len())].iter().filter(|c| **c == '\n').count();
        found.extend(text.map(|text| Token { text, line: token_line }));
    }
    found
}

fn after_block_comment(chars: &[char], mut i: usize) -> usize {
    let mut depth = 0;
    while i < chars.len() {
        match (chars[i], chars.get(i + 1)) {
            ('/', Some('*')) => {
                depth += 1;
                i += 2;
            }
            ('*', Some('/')) => {
                depth -= 1;
                i += 2;
                if depth == 0 {
                    break;
                }
            }
            _ => i += 1,
        }
    }
    i
}

fn after_string(chars: &[char], mut i: usize) -> usize {
    i += 1;
    while i < chars.len() && chars[i] != '"' {
        i += if chars[i] == '\\' { 2 } else { 1 };
    }
    i + 1
}

/// Where a raw string ends whose `r` ends at `i`; `None` if none begins there.
fn raw_string(chars: &[char], i: usize) -> Option<usize> {
    let hashes = chars[i..].iter().take_while(|c| **c == '#').count();
    if chars.get(i + hashes) != Some(&'"') {
        return None;
    }
    let mut j = i + hashes + 1;
    while j < chars.len() {
        if chars[j] == '"' && chars[j + 1..].iter().take(hashes).filter(|c| **c == '#').count() == hashes {
            return Some(j + 1 + hashes);
        }
        j += 1;
    }
    Some(j)
}

/// Takes every item away that is compiled for tests alone. Returns the lines of each, and their modules in files of their
/// own.
fn without_tests(tokens: &[Token]) -> (Vec<Token>, Vec<Range<usize>>, Vec<String>) {
    let (mut kept, mut tests, mut children) = (Vec::new(), Vec::new(), Vec::new());
    let mut i = 0;
    while i < tokens.len() {
        let text = |k: usize| tokens.get(i + k).map_or("", |token| &token.text);
        let test = (0..6).map(text).eq(["#", "[", "cfg", "(", "test", ")"]);
        if !test {
            kept.push(tokens[i].clone());
            i += 1;
            continue;
        }
        let end = item_end(tokens, i + 7);
        if let Some(name) = tokens[i..end].windows(3).find(|w| w[0].text == "mod" && w[2].text == ";") {
            children.push(name[1].text.clone());
        }
        tests.push(tokens[i].line..tokens[end - 1].line + 1);
        i = end;
    }
    (kept, tests, children)
}

/// Behind the last token of the item that begins at `from`: a `;`, or the brace that closes its body.
fn item_end(tokens: &[Token], from: usize) -> usize {
    let mut depth = 0_usize;
    for (i, token) in tokens.iter().enumerate().skip(from) {
        match token.text.as_str() {
            "(" | "[" | "{" => depth += 1,
            ")" | "]" => depth = depth.saturating_sub(1),
            "}" => {
                depth = depth.saturating_sub(1);
                if depth == 0 {
                    return i + 1;
                }
            }
            ";" if depth == 0 => return i + 1,
            _ => {}
        }
    }
    tokens.len()
}

/// Names and lines of all functions that have a body.
fn functions(tokens: &[Token]) -> Vec<(String, Range<usize>)> {
    let mut found = Vec::new();
    for (i, pair) in tokens.windows(2).enumerate() {
        let named = pair[1].text.starts_with(|c: char| c.is_alphabetic() || c == '_');
        if pair[0].text != "fn" || !named {
            continue;
        }
        let end = item_end(tokens, i);
        if tokens[end - 1].text == "}" {
            found.push((pair[1].text.clone(), pair[0].line..tokens[end - 1].line + 1));
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    fn words(text: &str) -> Vec<String> {
        tokens(text).into_iter().map(|token| token.text).collect()
    }

    #[test]
    fn comments_literals_and_lifetimes_are_no_code() {
        let text = "a /* crate::b /* */ */ // crate::c\n \"crate::\\\"d\" r#\"crate::\"e\"# 'x' '\\'' b\"f\" &'g T::h";
        assert_eq!(words(text), ["a", "\"\"", "\"\"", "\"\"", "\"\"", "\"\"", "&", "T", "::", "h"]);
        let last = tokens("/*\n*/\n\"\n\" z").pop().unwrap();
        assert_eq!((last.text.as_str(), last.line), ("z", 4));
    }

    #[test]
    fn tests_do_not_count() {
        let text = "use a::b;\n#[cfg(test)]\nmod tests {\n    fn t() {}\n}\n#[cfg(test)]\nmod more;\nfn f(x: [u8; 2])\n{\n}\nmod c;\n";
        let source = Source::parse(text);
        assert_eq!(source.length, 5);
        assert_eq!(source.children, [("more".to_owned(), true), ("c".to_owned(), false)]);
        assert_eq!(source.functions, [("f".to_owned(), 8..11)]);
        assert!(source.tokens.iter().all(|token| token.text != "t"));
    }
}
