//! Text files.

use std::fs::File;
use std::io::{Error, ErrorKind, Read, Result};
use std::path::Path;

/// Most bytes of a text file that is read: a bound on what a hostile one can make us allocate.
const MAX_TEXT: u64 = 16 << 20;

/// The whole of a text file, without the byte-order mark that some programs begin it with.
pub(super) fn read_text(path: &Path) -> Result<String> {
    let mut bytes = Vec::new();
    File::open(path)?.take(MAX_TEXT + 1).read_to_end(&mut bytes)?;
    let problem = |problem: String| Error::new(ErrorKind::InvalidData, problem);
    if bytes.len() as u64 > MAX_TEXT {
        return Err(problem(format!("more than the {MAX_TEXT} bytes that a text file may have")));
    }
    if bytes.starts_with(&[0xff, 0xfe]) || bytes.starts_with(&[0xfe, 0xff]) {
        return Err(problem("is UTF-16 text; save it as UTF-8".into()));
    }
    let text = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&bytes);
    let text = std::str::from_utf8(text).map_err(|_| problem("is not UTF-8 text".into()))?;
    Ok(text.to_owned())
}

#[cfg(test)]
mod tests {
    use super::read_text;

    #[test]
    fn byte_order_marks_are_no_text() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.csv");
        let read = |bytes: &[u8]| {
            std::fs::write(&path, bytes).unwrap();
            read_text(&path).map_err(|error| error.to_string())
        };
        assert_eq!(read(b"\xef\xbb\xbf1,2\n").unwrap(), "1,2\n");
        assert_eq!(read(b"1,2\n").unwrap(), "1,2\n");
        assert_eq!(read(b"\xef\xbb\xbf").unwrap(), "");
        for utf16 in [b"\xff\xfe1\0", b"\xfe\xff\x001"] {
            assert!(read(utf16).unwrap_err().contains("UTF-8"));
        }
        assert!(read(b"1,\xe9").unwrap_err().contains("not UTF-8"));
    }
}
