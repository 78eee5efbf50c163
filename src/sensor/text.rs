//! Text files.

use std::fs::File;
use std::io::Read;
use std::path::Path;

/// Most bytes of a text file that is read: a bound on what a hostile one can make us allocate.
const MAX_TEXT: u64 = 16 << 20;

/// The whole of a text file.
pub(super) fn read_text(path: &Path) -> std::io::Result<String> {
    let mut text = String::new();
    File::open(path)?.take(MAX_TEXT + 1).read_to_string(&mut text)?;
    if text.len() as u64 > MAX_TEXT {
        let problem = format!("more than the {MAX_TEXT} bytes that a text file may have");
        return Err(std::io::Error::new(std::io::ErrorKind::InvalidData, problem));
    }
    Ok(text)
}
