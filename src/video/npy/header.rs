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
        match Self::ALL.into_iter().find(|(_, name)| *name == plain) {
            Some((kind, _)) => Ok(kind),
            None if descr.starts_with('>') => {
                let native = descr.replacen('>', "<", 1);
                Err(format!("holds big-endian numbers ('{descr}'); convert it with .astype('{native}')"))
            }
            None => Err(format!("holds numbers of type '{descr}'; u8, u16, f16, f32 or f64 can be used")),
        }
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
            let word = self.word();
            // Python 2 wrote long integers with an L.
            let number = word.strip_suffix('L').unwrap_or(word).parse();
            numbers.push(number.map_err(|_| self.unreadable("a size"))?);
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

/// Reads the header; returns also the number of bytes before the numbers.
pub(super) fn read_header(content: &mut impl Read) -> Result<(Header, u64)> {
    let format = |problem: String| VideoError::Format(problem);
    let mut start = Vec::new();
    content.take(8).read_to_end(&mut start)?;
    if !start.starts_with(MAGIC) || start.len() < 8 {
        return Err(format("is not a NumPy file".into()).into());
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
