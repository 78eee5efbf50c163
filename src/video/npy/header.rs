//! The header of a NumPy file: a length-prefixed Python dictionary.

use std::io::Read;

use super::super::VideoError;
use crate::Result;

pub(super) const MAGIC: &[u8] = b"\x93NUMPY";
/// Longest header that is read; NumPy's own limit is 10,000.
const MAX_HEADER: usize = 16_384;
/// Most axes that NumPy knows.
const MAX_RANK: usize = 64;

/// Kinds of numbers that are read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    U8,
    U16,
    F16,
    F32,
    F64,
}

impl Kind {
    const ALL: [(Self, &str); 5] =
        [(Self::U8, "|u1"), (Self::U16, "<u2"), (Self::F16, "<f2"), (Self::F32, "<f4"), (Self::F64, "<f8")];

    pub fn descr(self) -> &'static str {
        Self::ALL[self as usize].1
    }

    fn parse(descr: &str) -> Result<Self, String> {
        // NumPy writes `|u1`; a byte has no order, so that others are as good.
        let plain = if matches!(descr, "<u1" | ">u1" | "=u1") { "|u1" } else { descr };
        let find = |name: &str| Self::ALL.into_iter().find(|(_, known)| *known == name);
        if let Some((kind, _)) = find(plain) {
            return Ok(kind);
        }
        let native = descr.replacen('>', "<", 1);
        if find(&native).is_some() {
            return Err(format!("holds big-endian numbers ('{descr}'); convert it with .astype('{native}')"));
        }
        let called = described(descr);
        Err(format!("holds {called} ('{descr}'); a capture is u8 or u16, a video f16, f32 or f64"))
    }

    pub fn bytes(self) -> usize {
        match self {
            Self::U8 => 1,
            Self::U16 | Self::F16 => 2,
            Self::F32 => 4,
            Self::F64 => 8,
        }
    }
}

/// What numbers of a type that is not read are called.
fn described(descr: &str) -> &'static str {
    match descr.trim_start_matches(['<', '>', '=', '|']).as_bytes().first() {
        Some(b'b') => "truth values",
        Some(b'i') => "signed integers",
        Some(b'u') => "unsigned integers of more than 16 bits",
        Some(b'f') => "floating-point numbers of more than 64 bits",
        Some(b'c') => "complex numbers",
        Some(b'O') => "Python objects",
        _ => "no numbers",
    }
}

#[derive(Debug, PartialEq)]
pub(super) struct Header {
    pub kind: Kind,
    pub fortran_order: bool,
    pub shape: Vec<usize>,
}

impl Header {
    /// Parses the dictionary, e.g. `{'descr': '<f4', 'fortran_order': False, 'shape': (2, 3, 4), }`.
    fn parse(text: &str) -> Result<Self, String> {
        let mut rest = Literal(text);
        let (mut kind, mut fortran_order, mut shape) = (None, None, None);
        rest.expect('{')?;
        while !rest.take('}') {
            let key = rest.string()?;
            rest.expect(':')?;
            match key {
                "descr" if rest.is_next('[') => {
                    return Err("holds records (a structured array); save one of their fields".into());
                }
                "descr" => kind = Some(Kind::parse(rest.string()?)?),
                "fortran_order" => fortran_order = Some(rest.boolean()?),
                "shape" => shape = Some(rest.tuple()?),
                _ => return Err(format!("has a header with an unknown key '{key}'")),
            }
            if !rest.take(',') {
                rest.expect('}')?;
                break;
            }
        }
        match (kind, fortran_order, shape) {
            (Some(kind), Some(fortran_order), Some(shape)) => Ok(Self { kind, fortran_order, shape }),
            _ => Err("has a header without descr, fortran_order or shape".into()),
        }
    }

    /// Numbers of a frame, whose axes are the last two.
    pub fn frame_len(&self) -> usize {
        self.shape.iter().rev().take(2).product()
    }

    pub fn wrong_rank(&self, expected: &str) -> VideoError {
        VideoError::Shape(format!("has shape {:?}; {expected}", self.shape))
    }
}

/// What is left to parse of a Python literal.
struct Literal<'a>(&'a str);

impl<'a> Literal<'a> {
    fn take(&mut self, symbol: char) -> bool {
        let rest = self.0.trim_start().strip_prefix(symbol);
        self.0 = rest.unwrap_or(self.0);
        rest.is_some()
    }

    fn is_next(&self, symbol: char) -> bool {
        self.0.trim_start().starts_with(symbol)
    }

    fn expect(&mut self, symbol: char) -> Result<(), String> {
        if self.take(symbol) { Ok(()) } else { Err(self.unreadable(&format!("'{symbol}'"))) }
    }

    fn unreadable(&self, expected: &str) -> String {
        let found: String = self.0.trim_start().chars().take(16).collect();
        format!("has an unreadable header: {expected} expected at {found:?}")
    }

    fn string(&mut self) -> Result<&'a str, String> {
        let quote = if self.take('"') { '"' } else { '\'' };
        if quote == '\'' && !self.take('\'') {
            return Err(self.unreadable("a quoted word"));
        }
        let (word, rest) = self.0.split_once(quote).ok_or_else(|| self.unreadable("the end of a word"))?;
        self.0 = rest;
        Ok(word)
    }

    /// The letters or digits that come next.
    fn word(&mut self) -> &'a str {
        let text = self.0.trim_start();
        let end = text.find(|c: char| !c.is_ascii_alphanumeric()).unwrap_or(text.len());
        self.0 = &text[end..];
        &text[..end]
    }

    fn boolean(&mut self) -> Result<bool, String> {
        match self.word() {
            "True" => Ok(true),
            "False" => Ok(false),
            _ => Err(self.unreadable("True or False")),
        }
    }

    fn tuple(&mut self) -> Result<Vec<usize>, String> {
        let mut numbers = Vec::new();
        self.expect('(')?;
        while !self.take(')') {
            let before = Self(self.0);
            let word = self.word();
            // Python 2 wrote long integers with an L.
            let number = word.strip_suffix('L').unwrap_or(word).parse();
            numbers.push(number.map_err(|_| before.unreadable("a size"))?);
            if numbers.len() > MAX_RANK {
                return Err(format!("has more than {MAX_RANK} axes"));
            }
            if !self.take(',') {
                self.expect(')')?;
                break;
            }
        }
        Ok(numbers)
    }
}

/// Refuses values that are not as many as `extents` say.
pub(super) fn check_count(len: usize, extents: &[usize]) -> Result<(), VideoError> {
    if element_count(extents) == Some(len) {
        return Ok(());
    }
    Err(VideoError::Shape(format!("{len} values for extents {extents:?}")))
}

pub(super) fn element_count(shape: &[usize]) -> Option<usize> {
    shape.iter().try_fold(1_usize, |product, &n| product.checked_mul(n))
}

/// What a file is instead, by its first bytes, and what to do with it.
fn foreign(start: &[u8]) -> &'static str {
    const VIDEO: &str =
        " but a video; decode its frames (with ffmpeg, say) and save them as one array with np.save";
    const TIFF: &str = " but a TIFF; save it as one array, np.save('capture.npy', tifffile.imread(…))";
    match start {
        [b'P', b'K', 3 | 5, _, ..] => {
            " but an archive of arrays (.npz); save one of them alone, np.save('capture.npy', np.load(…)['NAME'])"
        }
        [_, _, _, _, b'f', b't', b'y', b'p', ..]
        | [b'R', b'I', b'F', b'F', ..]
        | [0x1a, 0x45, 0xdf, 0xa3, ..] => VIDEO,
        [b'I', b'I', 42 | 43, 0, ..] | [b'M', b'M', 0, 42 | 43, ..] => TIFF,
        [0x89, b'H', b'D', b'F', ..] => " but HDF5; save one of its arrays with np.save",
        [0x80, 2..=5, ..] => " but a Python pickle; save its array with np.save",
        _ => "",
    }
}

/// Reads the header; returns also the number of bytes before the numbers.
pub(super) fn read_header(content: &mut impl Read) -> Result<(Header, u64)> {
    let format = |problem: String| VideoError::Format(problem);
    let mut start = Vec::new();
    content.take(8).read_to_end(&mut start)?;
    if !start.starts_with(MAGIC) || start.len() < 8 {
        return Err(format(format!("is not a NumPy file{}", foreign(&start))).into());
    }
    let length_bytes = match start[6] {
        1 => 2,
        2 | 3 => 4,
        version => {
            return Err(
                format(format!("is of version {version} of NumPy's format; 1 to 3 can be read")).into()
            );
        }
    };
    let mut length = [0_u8; 4];
    content.read_exact(&mut length[..length_bytes]).map_err(|_| format("ends within its header".into()))?;
    let length = u32::from_le_bytes(length) as usize;
    if length > MAX_HEADER {
        return Err(format(format!("has a header of {length} bytes; up to {MAX_HEADER} can be read")).into());
    }
    let mut text = vec![0_u8; length];
    content.read_exact(&mut text).map_err(|_| format("ends within its header".into()))?;
    let text = std::str::from_utf8(&text).map_err(|_| format("has a header that is not text".into()))?;
    let header = Header::parse(text).map_err(format)?;
    Ok((header, (8 + length_bytes + length) as u64))
}

/// The bytes before the numbers, version 1, padded so that the numbers are aligned to 64 bytes.
pub(super) fn header(kind: Kind, extents: &[usize]) -> Vec<u8> {
    let descr = kind.descr();
    let shape: Vec<String> = extents.iter().map(ToString::to_string).collect();
    let shape = shape.join(", ");
    let text = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': ({shape}), }}");
    let length = (10 + text.len() + 1).next_multiple_of(64) - 10;
    let mut bytes = MAGIC.to_vec();
    bytes.extend([1, 0]);
    bytes.extend((length as u16).to_le_bytes());
    bytes.extend(format!("{text:<0$}\n", length - 1).into_bytes());
    bytes
}
