//! From files to the text that is compiled.
//!
//! Every file under `shaders/` (and `viewer/shaders/`) is WGSL as it stands, together with the files that it includes. What goes beyond WGSL is
//! said in comments that begin with `//!`, so that any tool can read the files; a test validates each of them.
//!
//! - `//!include PATH` on a line of its own: the file `shaders/PATH` is part of this one, once, wherever else it is included. The order
//!   of declarations means nothing in WGSL.
//! - `//!include PATH as NAME`: the same with `stored` and `Stored` at the beginning of its names replaced by `name` and
//!   `Name`. Specialisation may take another file with the same names ([`Parameters::include`]).
//! - `const NAME: TYPE = VALUE; //!parameter`: specialisation gives the value; what stands there is a default for tools.
//!   Whatever belongs to a layer is a parameter, so that the driver's compiler knows every bound of a loop.
//! - `for (var NAME = 0; NAME < COUNT; NAME++) { //!static`: the loop is written out, each turn a block with NAME as a
//!   constant. COUNT is a number or a parameter. Indices of registers have to be constants: the driver's compilers put
//!   arrays that are indexed by variables into memory.
//! - `if (NAME) { //!static`, with or without `} else {`: one side is left, so that what an adapter cannot do is not in the
//!   text at all. NAME is a parameter.
//! - The members of `struct Geometry`, one a line, are i32: what changes with the size of a window. They are values too,
//!   but uniform, so that one pipeline serves every size.
//!
//! In which of both ways a shader gets a value is its own choice: moving a name from the geometry to the parameters makes
//! it a constant. Names are upper case as parameters and lower case in the geometry.

use std::collections::HashSet;

use super::parameters::{Parameters, Value};
use super::table::{ShaderFile, file};

/// A shader that can be compiled.
#[derive(Clone, Debug)]
pub struct Shader {
    /// The text.
    pub text: String,
    /// Where each line of it comes from.
    origins: Vec<(&'static str, usize)>,
    /// Members of the geometry.
    geometry: Vec<(String, i32)>,
}

impl Shader {
    /// The uniform buffer.
    pub fn uniform(&self) -> Vec<i32> {
        self.geometry.iter().map(|(_, value)| *value).collect()
    }

    /// Name and value of each member of the uniform buffer.
    pub fn geometry(&self) -> impl Iterator<Item = (&str, i32)> {
        self.geometry.iter().map(|(name, value)| (name.as_str(), *value))
    }

    /// File and line, from 1 on, that line `line` of the text, from 1 on, comes from.
    pub fn origin(&self, line: usize) -> Option<(&'static str, usize)> {
        self.origins.get(line.checked_sub(1)?).copied()
    }
}

/// A line, and where it comes from.
#[derive(Clone, Debug)]
struct Line {
    text: String,
    origin: (&'static str, usize),
}

impl Line {
    /// The code in front of a marker.
    fn marked(&self, marker: &str) -> Option<&str> {
        self.text.trim_end().strip_suffix(marker)?.trim_end().strip_suffix("//!").map(str::trim_end)
    }

    /// Stops at what only a developer can have done.
    fn refuse(&self, problem: &str) -> ! {
        let (file, line) = self.origin;
        panic!("{file}:{line}: {problem}");
    }
}

/// A file with all that it includes, and nothing changed.
pub fn as_it_stands(source: ShaderFile) -> Shader {
    finish(with_includes(source, &Parameters::default()), Vec::new())
}

/// A file with all that it includes, for these values.
pub fn specialise(source: ShaderFile, parameters: &Parameters) -> Shader {
    let lines = with_includes(source, parameters);
    let geometry = geometry(&lines, parameters);
    let mut written = Vec::new();
    write(&lines, parameters, &mut written);
    finish(written, geometry)
}

fn finish(lines: Vec<Line>, geometry: Vec<(String, i32)>) -> Shader {
    let mut text = String::new();
    for line in &lines {
        text.push_str(&line.text);
        text.push('\n');
    }
    Shader { text, origins: lines.into_iter().map(|line| line.origin).collect(), geometry }
}

/// The lines of a file, with those of the files that it includes.
fn with_includes(source: ShaderFile, parameters: &Parameters) -> Vec<Line> {
    let mut lines = Vec::new();
    include(source, None, parameters, &mut HashSet::new(), &mut lines);
    lines
}

/// Adds the lines of a file, unless it was `included` before under the same name.
fn include(
    source: ShaderFile,
    name: Option<&'static str>,
    parameters: &Parameters,
    included: &mut HashSet<(&'static str, Option<&'static str>)>,
    lines: &mut Vec<Line>,
) {
    if !included.insert((source.path, name)) {
        return;
    }
    for (number, line) in (1..).zip(source.text.lines()) {
        if let Some(wanted) = line.strip_prefix("//!include ") {
            let (path, name) =
                wanted.split_once(" as ").map_or((wanted, None), |(path, name)| (path, Some(name)));
            let path = name.and_then(|name| parameters.file(name)).unwrap_or(path);
            include(file(path), name, parameters, included, lines);
        } else {
            let text = name.map_or_else(|| line.to_owned(), |name| renamed(line, name));
            lines.push(Line { text, origin: (source.path, number) });
        }
    }
}

/// `text` with `name` in place of `stored`.
fn renamed(text: &str, name: &str) -> String {
    let capital = format!("{}{}", name[..1].to_uppercase(), &name[1..]);
    text.replace("STORED", &name.to_uppercase()).replace("Stored", &capital).replace("stored", name)
}

/// The values of `struct Geometry`, if there is one.
fn geometry(lines: &[Line], parameters: &Parameters) -> Vec<(String, i32)> {
    let members = lines.iter().skip_while(|line| line.text != "struct Geometry {").skip(1);
    let members = members.take_while(|line| line.text != "}").filter(|line| !code(&line.text).is_empty());
    let value = |line: &Line| {
        let Some(name) = code(&line.text).strip_suffix(": i32,") else {
            line.refuse("members of the geometry are i32")
        };
        match parameters.get(name) {
            Some(&Value::Integer(value)) => (name.to_owned(), value as i32),
            Some(other) => line.refuse(&format!("{other} is no integer")),
            None => line.refuse(&format!("nobody says what {name} is")),
        }
    };
    members.map(value).collect()
}

/// A line without its comment and the space around it.
fn code(line: &str) -> &str {
    line.split("//").next().unwrap_or_default().trim()
}

/// Writes lines with what is static carried out and without comments, which would stand there many times.
fn write(lines: &[Line], parameters: &Parameters, written: &mut Vec<Line>) {
    let mut rest = lines;
    while let Some((line, behind)) = rest.split_first() {
        rest = behind;
        if let Some(declaration) = line.marked("parameter") {
            written.push(Line { text: with_value(line, declaration, parameters), ..line.clone() });
        } else if let Some(head) = line.marked("static") {
            let indent = &head[..head.len() - head.trim_start().len()];
            let end = end_of_block(line, rest);
            let block = &rest[..end];
            rest = &rest[end + 1..];
            if let Some(name) =
                head.trim_start().strip_prefix("if (").and_then(|head| head.strip_suffix(") {"))
            {
                let other = block.iter().position(|line| line.text.strip_prefix(indent) == Some("} else {"));
                let [chosen, otherwise] = match other {
                    Some(other) => [&block[..other], &block[other + 1..]],
                    None => [block, &[]],
                };
                match parameters.get(name) {
                    Some(Value::Bool(true)) => write(chosen, parameters, written),
                    Some(Value::Bool(false)) => write(otherwise, parameters, written),
                    _ => line.refuse("nobody says whether that is so"),
                }
            } else {
                let (name, count) = turns(line, head.trim_start(), parameters);
                for turn in 0..count {
                    let text = format!("{indent}{{ const {name} = {turn};");
                    written.push(Line { text, ..line.clone() });
                    write(block, parameters, written);
                    written.push(Line { text: format!("{indent}}}"), ..line.clone() });
                }
            }
        } else if !code(&line.text).is_empty() {
            let text = line.text.split("//").next().unwrap_or_default().trim_end().to_owned();
            written.push(Line { text, ..line.clone() });
        }
    }
}

/// The declaration of a parameter with its value.
fn with_value(line: &Line, declaration: &str, parameters: &Parameters) -> String {
    let name = declaration.strip_prefix("const ").and_then(|rest| rest.split([':', ' ']).next());
    let (Some(name), Some((left, _))) = (name, declaration.split_once(" = ")) else {
        line.refuse("parameters are constants with a value")
    };
    match parameters.get(name) {
        Some(value) => format!("{left} = {value};"),
        None => line.refuse(&format!("nobody says what {name} is")),
    }
}

/// The name of a loop's variable, and the number of its turns.
fn turns<'a>(line: &Line, head: &'a str, parameters: &Parameters) -> (&'a str, i64) {
    let parts = head.strip_prefix("for (var ").and_then(|head| {
        let (name, head) = head.split_once(" = 0; ")?;
        let head = head.strip_prefix(name)?.strip_prefix(" < ")?;
        let (count, head) = head.split_once("; ")?;
        (head.strip_prefix(name)? == "++) {").then_some((name, count))
    });
    let Some((name, count)) = parts else {
        line.refuse("only loops that count up from 0, and branches on a name, are static")
    };
    let value = count.parse().ok().or_else(|| match parameters.get(count) {
        Some(&Value::Integer(value)) => Some(value),
        _ => None,
    });
    (name, value.unwrap_or_else(|| line.refuse(&format!("nobody says how many {count} is"))))
}

/// The number of lines in a block, which begins behind the line `head`.
fn end_of_block(head: &Line, lines: &[Line]) -> usize {
    let mut depth = 1i32;
    let end = lines.iter().position(|line| {
        let code = code(&line.text);
        // `} else {` closes as much as it opens.
        depth += code.matches('{').count() as i32 - code.matches('}').count() as i32;
        depth == 0
    });
    end.unwrap_or_else(|| head.refuse("the block has no end"))
}

#[cfg(test)]
mod tests;
