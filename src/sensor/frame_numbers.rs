//! Numbers or time stamps of frames, as a description gives them.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::SensorError;
use super::text::read_text;
use crate::{At, Result};

/// Numbers, one a frame: in the description, or in a text file beside it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum FrameNumbers {
    /// The numbers themselves.
    List(Vec<f64>),
    /// Name of a text file in the same folder, with a number a line.
    File(String),
}

impl FrameNumbers {
    /// Reads a text file with a number a line; a first line of words is a heading.
    pub fn read(path: impl AsRef<Path>) -> Result<Vec<f64>> {
        let path = path.as_ref();
        parse(&read_text(path).at(path)?).at(path)
    }

    /// The numbers; a file is looked for in `folder`.
    pub(super) fn numbers(&self, folder: Option<&Path>) -> Result<Vec<f64>> {
        match self {
            Self::List(numbers) => Ok(numbers.clone()),
            Self::File(name) => {
                let plain = Path::new(name).file_name().is_some_and(|file| file == name.as_str());
                match folder.filter(|_| plain) {
                    Some(folder) => Self::read(folder.join(name)),
                    None => Err(SensorError::Capture(format!(
                        "frame numbers are in a file beside the capture, which '{name}' is not"
                    ))
                    .into()),
                }
            }
        }
    }
}

fn parse(text: &str) -> Result<Vec<f64>, SensorError> {
    let lines = text.lines().map(str::trim).enumerate().filter(|(_, line)| !line.is_empty());
    let mut numbers = Vec::new();
    for (index, line) in lines {
        match line.parse::<f64>() {
            Ok(number) => numbers.push(number),
            Err(_) if numbers.is_empty() && line.starts_with(|c: char| c.is_alphabetic() || c == '#') => {}
            Err(_) => {
                let problem = format!("line {}: '{line}' is not a number", index + 1);
                return Err(SensorError::Capture(problem));
            }
        }
    }
    Ok(numbers)
}
