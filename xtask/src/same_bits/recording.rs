//! A recording cut to its first frames, rows and columns, so that a comparison takes seconds.

use std::fs;
use std::path::Path;

use crate::Result;

/// Writes the first frames, rows and columns (at most `most` of each) of the capture in the folder `from` to the folder
/// `to`. Since it begins where the recording begins, its description stays true.
pub fn cut(from: &Path, to: &Path, most: [usize; 3]) -> Result<()> {
    let array = from.join("capture.npy");
    let bytes = fs::read(&array).map_err(|e| format!("{}: {e}", array.display()))?;
    let cut = cut_array(&bytes, most).ok_or_else(|| format!("{}: not a recording", array.display()))?;
    fs::create_dir_all(to).map_err(|e| format!("{}: {e}", to.display()))?;
    let write = |name: &str, bytes: &[u8]| {
        fs::write(to.join(name), bytes).map_err(|e| format!("{}: {e}", to.join(name).display()))
    };
    write("capture.npy", &cut)?;
    let description = from.join("capture.json");
    let text = fs::read(&description).map_err(|e| format!("{}: {e}", description.display()))?;
    write("capture.json", &text)
}

/// An NPY array [t, y, x] of u8 or u16 cut to its first `most` frames, rows and columns; `None` if it is something else.
fn cut_array(bytes: &[u8], most: [usize; 3]) -> Option<Vec<u8>> {
    let version = *bytes.strip_prefix(b"\x93NUMPY")?.first()?;
    let (begin, length) = match version {
        1 => (10, usize::from(u16::from_le_bytes(bytes.get(8..10)?.try_into().ok()?))),
        _ => (12, u32::from_le_bytes(bytes.get(8..12)?.try_into().ok()?) as usize),
    };
    let header = std::str::from_utf8(bytes.get(begin..begin + length)?).ok()?;
    let kind = ["|u1", "<u2"].into_iter().find(|kind| header.contains(kind))?;
    let size = if kind == "|u1" { 1 } else { 2 };
    let shape = header.split_once("'shape': (")?.1.split_once(')')?.0;
    let shape: Vec<usize> = shape.split(',').filter_map(|n| n.trim().parse().ok()).collect();
    let [frames, height, width] = shape[..] else { return None };
    let data = bytes.get(begin + length..)?;
    if header.contains("'fortran_order': True") || data.len() != frames * height * width * size {
        return None;
    }
    let [t, y, x] = [frames.min(most[0]), height.min(most[1]), width.min(most[2])];
    let mut header = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': ({t}, {y}, {x}), }}");
    // The header ends in a line break, and the data begin at a multiple of 64 bytes.
    while (10 + header.len() + 1) % 64 != 0 {
        header.push(' ');
    }
    header.push('\n');
    let mut cut = b"\x93NUMPY\x01\x00".to_vec();
    cut.extend(u16::try_from(header.len()).ok()?.to_le_bytes());
    cut.extend(header.bytes());
    for row in (0..t).flat_map(|t| (0..y).map(move |y| (t * height + y) * width)) {
        cut.extend(&data[row * size..(row + x) * size]);
    }
    Some(cut)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_beginning_is_kept() {
        let header = |shape: &str| {
            let text = format!("{{'descr': '<u2', 'fortran_order': False, 'shape': {shape}, }}");
            let mut bytes = b"\x93NUMPY\x01\x00\x76\x00".to_vec();
            bytes.extend(format!("{text:117}\n").bytes());
            bytes
        };
        let mut whole = header("(2, 3, 4)");
        whole.extend((0..24u16).flat_map(u16::to_le_bytes));
        let mut expected = header("(2, 2, 3)");
        expected.extend([0u16, 1, 2, 4, 5, 6, 12, 13, 14, 16, 17, 18].into_iter().flat_map(u16::to_le_bytes));
        assert_eq!(cut_array(&whole, [9, 2, 3]).unwrap(), expected);
        assert_eq!(cut_array(&whole, [9, 9, 9]).unwrap(), whole);
        assert_eq!(cut_array(&whole[..whole.len() - 1], [9, 9, 9]), None);
        assert_eq!(cut_array(b"something else", [9, 9, 9]), None);
    }
}
