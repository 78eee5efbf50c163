//! NumPy's `.npy`: one cube [t, y, x], as NumPy's format versions 1 to 3 store it.
//!
//! The format is a length-prefixed Python dictionary and then the numbers; nothing here depends on what the
//! header claims before it has been held against the length of the file.

use std::fs::File;
use std::io::{BufReader, BufWriter, Read, Seek, SeekFrom, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};

use half::f16;

use super::atomic::AtomicFile;
use super::{Video, VideoError, half_of};
use crate::{At, Result};

const MAGIC: &[u8] = b"\x93NUMPY";
/// Longest header that is read; NumPy's own limit is 10,000.
const MAX_HEADER: usize = 16_384;
/// Most axes that NumPy knows.
const MAX_RANK: usize = 64;

/// Integer pixel values of a capture, in the sensor's own counts.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Counts {
    /// Up to 8 bits.
    U8(Vec<u8>),
    /// Up to 16 bits.
    U16(Vec<u16>),
}

impl Counts {
    /// Number of values.
    pub fn len(&self) -> usize {
        match self {
            Self::U8(values) => values.len(),
            Self::U16(values) => values.len(),
        }
    }

    /// Whether there are no values.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The value at place `i`.
    pub fn value(&self, i: usize) -> u16 {
        match self {
            Self::U8(values) => u16::from(values[i]),
            Self::U16(values) => values[i],
        }
    }

    /// The values at places `range`.
    #[must_use]
    pub fn range(&self, range: Range<usize>) -> Self {
        match self {
            Self::U8(values) => Self::U8(values[range].to_vec()),
            Self::U16(values) => Self::U16(values[range].to_vec()),
        }
    }

    /// These values and `others` behind them, which must be of the same kind.
    #[must_use]
    pub fn followed_by(mut self, others: Self) -> Self {
        match (&mut self, others) {
            (Self::U8(values), Self::U8(others)) => values.extend(others),
            (Self::U16(values), Self::U16(others)) => values.extend(others),
            _ => unreachable!("counts of two kinds"),
        }
        self
    }

    /// An array of the same extents whose value `i` is this one's value `source(i)`.
    #[must_use]
    pub fn gather(&self, source: impl Fn(usize) -> usize) -> Self {
        match self {
            Self::U8(values) => Self::U8((0..values.len()).map(|i| values[source(i)]).collect()),
            Self::U16(values) => Self::U16((0..values.len()).map(|i| values[source(i)]).collect()),
        }
    }
}

/// Reads an HDR video: f16, f32 or f64, [t, y, x], or one frame [y, x]. Every value must be finite and ≥ 0.
pub fn read_video(path: impl AsRef<Path>) -> Result<Video> {
    let path = path.as_ref();
    let read = || -> Result<Video> {
        let mut npy = Npy::open(path)?;
        let [frames, height, width] = match npy.header.shape[..] {
            [frames, height, width] => [frames, height, width],
            [height, width] => [1, height, width],
            _ => return Err(npy.header.wrong_rank("a video has axes [t, y, x], one frame [y, x]").into()),
        };
        let data = match npy.header.kind {
            Kind::F16 => npy.values(|[a, b]: [u8; 2]| f16::from_le_bytes([a, b]).to_f32())?,
            Kind::F32 => npy.values(f32::from_le_bytes)?,
            Kind::F64 => npy.values(|bytes| f64::from_le_bytes(bytes) as f32)?,
            Kind::U8 | Kind::U16 => {
                let problem = "holds integers, as a capture does; a video is f16, f32 or f64";
                return Err(VideoError::Format(problem.into()).into());
            }
        };
        let video = Video::new(frames, height, width, data)?;
        video.check_finite()?;
        Ok(video)
    };
    read().at(path)
}

/// Writes an HDR video as f32, or as f16 if `half` (values above 65504 become 65504).
pub fn write_video(path: impl AsRef<Path>, video: &Video, half: bool) -> Result<()> {
    let mut writer = NpyWriter::begin(path, [video.frames, video.height, video.width], half)?;
    for t in 0..video.frames {
        writer.push(video.frame(t))?;
    }
    writer.finish()
}

/// Reads the counts of a capture, u8 or u16, and their extents [t, y, x].
pub fn read_counts(path: impl AsRef<Path>) -> Result<([usize; 3], Counts)> {
    let path = path.as_ref();
    let mut reader = CountsReader::open(path)?;
    let counts = match reader.whole.take() {
        Some(whole) => whole,
        None => reader.npy.all_counts().at(path)?,
    };
    Ok((reader.extents, counts))
}

/// Reads the counts of a capture frame by frame.
///
/// An array in Fortran order has its frames spread over the whole file, so it alone is held in memory.
#[derive(Debug)]
pub struct CountsReader {
    npy: Npy,
    path: PathBuf,
    extents: [usize; 3],
    /// Where the numbers begin in the file.
    begin: u64,
    whole: Option<Counts>,
}

impl CountsReader {
    /// Opens a file, u8 or u16, [t, y, x].
    pub fn open(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let open = || -> Result<Self> {
            let mut npy = Npy::open(path)?;
            let [t, y, x] = npy.header.shape[..] else {
                return Err(npy.header.wrong_rank("a capture has axes [t, y, x]").into());
            };
            if matches!(npy.header.kind, Kind::F16 | Kind::F32 | Kind::F64) {
                let problem = "holds floating-point numbers, as a video does; a capture is u8 or u16";
                return Err(VideoError::Format(problem.into()).into());
            }
            let begin = npy.content.stream_position()?;
            let whole = if npy.header.fortran_order { Some(npy.all_counts()?) } else { None };
            Ok(Self { npy, path: path.to_owned(), extents: [t, y, x], begin, whole })
        };
        open().at(path)
    }

    /// Extents [t, y, x].
    pub fn extents(&self) -> [usize; 3] {
        self.extents
    }

    /// Whether the counts have 8 bits.
    pub fn is_u8(&self) -> bool {
        self.npy.header.kind == Kind::U8
    }

    /// The counts of frame `t`, which must be one of the file's.
    pub fn frame(&mut self, t: usize) -> Result<Counts> {
        let [_, y, x] = self.extents;
        let len = y * x;
        if let Some(whole) = &self.whole {
            return Ok(whole.range(t * len..(t + 1) * len));
        }
        let at = self.begin + (t * len * self.npy.header.kind.bytes()) as u64;
        let mut read = || -> Result<Counts> {
            let here = self.npy.content.stream_position()?;
            self.npy.content.seek_relative(at as i64 - here as i64)?;
            Ok(match self.npy.header.kind {
                Kind::U8 => Counts::U8(self.npy.next(len, |[value]: [u8; 1]| value)?),
                _ => Counts::U16(self.npy.next(len, u16::from_le_bytes)?),
            })
        };
        read().at(&self.path)
    }
}

/// Writes counts of any extents: [t, y, x] for a capture, [n, t, y, x] for cubes of a data set.
pub fn write_counts(path: impl AsRef<Path>, extents: &[usize], counts: &Counts) -> Result<()> {
    let path = path.as_ref();
    check_count(counts.len(), extents).at(path)?;
    super::atomic::write(path, |file| {
        match counts {
            Counts::U8(values) => {
                file.write_all(&header(Kind::U8, extents))?;
                file.write_all(values)?;
            }
            Counts::U16(values) => {
                file.write_all(&header(Kind::U16, extents))?;
                for value in values {
                    file.write_all(&value.to_le_bytes())?;
                }
            }
        }
        Ok(())
    })
}

/// Writes half-precision values of any extents.
pub fn write_halves(path: impl AsRef<Path>, extents: &[usize], values: &[f16]) -> Result<()> {
    let path = path.as_ref();
    check_count(values.len(), extents).at(path)?;
    super::atomic::write(path, |file| {
        file.write_all(&header(Kind::F16, extents))?;
        for value in values {
            file.write_all(&value.to_le_bytes())?;
        }
        Ok(())
    })
}

fn check_count(len: usize, extents: &[usize]) -> Result<(), VideoError> {
    if element_count(extents) == Some(len) {
        return Ok(());
    }
    Err(VideoError::Shape(format!("{len} values for extents {extents:?}")))
}

/// Writes a video frame by frame. The file appears when it is finished.
#[derive(Debug)]
pub struct NpyWriter {
    file: Working,
    path: PathBuf,
    extents: [usize; 3],
    pushed: usize,
    half: bool,
    line: Vec<u8>,
}

/// Where frames are collected.
#[derive(Debug)]
enum Working {
    /// A hidden file that goes if it is never completed.
    Hidden(AtomicFile),
    /// A file that stays, so that another run can go on. Its header counts the frames when writing ends.
    Partial(BufWriter<File>, PathBuf),
}

impl Working {
    fn write_all(&mut self, bytes: &[u8]) -> std::io::Result<()> {
        match self {
            Self::Hidden(file) => file.content.write_all(bytes),
            Self::Partial(file, _) => file.write_all(bytes),
        }
    }
}

impl NpyWriter {
    /// Begins a file of extents [t, y, x], f16 if `half`, else f32.
    pub fn begin(path: impl AsRef<Path>, extents: [usize; 3], half: bool) -> Result<Self> {
        let path = path.as_ref();
        check_extents(extents).at(path)?;
        let mut file = AtomicFile::create(path)?;
        file.content.write_all(&header(kind_of(half), &extents)).at(path)?;
        let (file, path) = (Working::Hidden(file), path.to_owned());
        Ok(Self { file, path, extents, pushed: 0, half, line: Vec::new() })
    }

    /// As [`NpyWriter::begin`], but frames are collected in the file `partial`, which stays until it is complete.
    /// Whole frames that are there already are the first ones of the video; [`NpyWriter::pushed`] says how many.
    pub fn go_on(path: impl AsRef<Path>, extents: [usize; 3], half: bool, partial: &Path) -> Result<Self> {
        let path = path.as_ref();
        check_extents(extents).at(path)?;
        let [_, y, x] = extents;
        super::atomic::make_parent(partial)?;
        let open = || -> Result<(BufWriter<File>, usize)> {
            let mut file =
                File::options().read(true).write(true).create(true).truncate(false).open(partial)?;
            let header = header(kind_of(half), &extents);
            let frame = (y * x * kind_of(half).bytes()) as u64;
            let there = file.metadata()?.len().saturating_sub(header.len() as u64) / frame;
            let there = there.min(extents[0] as u64);
            file.set_len(header.len() as u64 + there * frame)?;
            file.write_all(&header)?;
            file.seek(SeekFrom::End(0))?;
            Ok((BufWriter::with_capacity(1 << 20, file), there as usize))
        };
        let (file, pushed) = open().at(partial)?;
        let (file, path) = (Working::Partial(file, partial.to_owned()), path.to_owned());
        Ok(Self { file, path, extents, pushed, half, line: Vec::new() })
    }

    /// Frames that are there.
    pub fn pushed(&self) -> usize {
        self.pushed
    }

    /// Appends one frame [y, x].
    pub fn push(&mut self, frame: &[f32]) -> Result<()> {
        let [t, y, x] = self.extents;
        super::check_frame(frame, self.pushed, [t, y, x]).at(&self.path)?;
        for row in frame.chunks(x) {
            self.line.clear();
            if self.half {
                self.line.extend(row.iter().flat_map(|&v| half_of(v).to_le_bytes()));
            } else {
                self.line.extend(row.iter().flat_map(|v| v.to_le_bytes()));
            }
            self.file.write_all(&self.line).at(&self.path)?;
        }
        self.pushed += 1;
        Ok(())
    }

    /// Completes the file.
    pub fn finish(self) -> Result<()> {
        super::check_complete(self.pushed, self.extents[0]).at(&self.path)?;
        match self.file {
            Working::Hidden(file) => file.finish(),
            Working::Partial(mut file, partial) => {
                file.flush().at(&partial)?;
                drop(file);
                std::fs::rename(&partial, &self.path).at(&self.path)
            }
        }
    }

    /// Leaves what there is as a file of its own: its header counts the frames that were written. Returns their number,
    /// which is smaller than that of the frames pushed where the disk is full.
    pub fn suspend(self) -> Result<usize> {
        let [frames, y, x] = self.extents;
        let Working::Partial(mut file, partial) = self.file else { return Ok(0) };
        let kind = kind_of(self.half);
        let whole = header(kind, &[frames, y, x]);
        // What cannot be written any more is dropped.
        if let Err(error) = file.flush() {
            tracing::warn!("{}: {error}", partial.display());
        }
        let (mut file, _) = file.into_parts();
        let frame = (y * x * kind.bytes()) as u64;
        let len = file.metadata().at(&partial)?.len().saturating_sub(whole.len() as u64);
        let written = (len / frame).min(self.pushed as u64);
        // As long as the header of the whole, so that frames stay where they are.
        let mut part = header(kind, &[written as usize, y, x]);
        if let Some(missing) = whole.len().checked_sub(part.len()) {
            part.pop();
            part.extend(vec![b' '; missing]);
            part.push(b'\n');
            part[8..10].copy_from_slice(&whole[8..10]);
        }
        let mut write = || -> std::io::Result<()> {
            file.set_len(whole.len() as u64 + written * frame)?;
            file.seek(SeekFrom::Start(0))?;
            file.write_all(&part)
        };
        write().at(&partial)?;
        Ok(written as usize)
    }
}

fn check_extents(extents: [usize; 3]) -> Result<(), VideoError> {
    if element_count(&extents).is_none_or(|n| n == 0) {
        let [t, y, x] = extents;
        return Err(VideoError::Shape(format!("a video of {t}×{y}×{x} cannot be written")));
    }
    Ok(())
}

fn kind_of(half: bool) -> Kind {
    if half { Kind::F16 } else { Kind::F32 }
}

/// Kinds of numbers that are read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    U8,
    U16,
    F16,
    F32,
    F64,
}

impl Kind {
    const ALL: [(Self, &str); 5] =
        [(Self::U8, "|u1"), (Self::U16, "<u2"), (Self::F16, "<f2"), (Self::F32, "<f4"), (Self::F64, "<f8")];

    fn descr(self) -> &'static str {
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

    fn bytes(self) -> usize {
        match self {
            Self::U8 => 1,
            Self::U16 | Self::F16 => 2,
            Self::F32 => 4,
            Self::F64 => 8,
        }
    }
}

#[derive(Debug, PartialEq)]
struct Header {
    kind: Kind,
    fortran_order: bool,
    shape: Vec<usize>,
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

    fn wrong_rank(&self, expected: &str) -> VideoError {
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

/// A file whose header has been read and whose length is right.
#[derive(Debug)]
struct Npy {
    header: Header,
    content: BufReader<File>,
}

impl Npy {
    fn open(path: &Path) -> Result<Self> {
        let file = File::open(path)?;
        let meta = file.metadata()?;
        if !meta.is_file() {
            return Err(VideoError::Format("is not a file".into()).into());
        }
        let mut content = BufReader::with_capacity(1 << 20, file);
        let (header, header_len) = read_header(&mut content)?;
        let data_len = meta.len().saturating_sub(header_len);
        let declared = element_count(&header.shape).and_then(|n| n.checked_mul(header.kind.bytes()));
        if declared.map(|n| n as u64) != Some(data_len) {
            let Header { shape, kind, .. } = &header;
            let kind = kind.descr();
            return Err(VideoError::Format(format!(
                "its header promises {shape:?} of '{kind}', but {data_len} bytes follow; is it truncated?"
            ))
            .into());
        }
        if data_len == 0 {
            return Err(VideoError::Shape(format!("is empty: its shape is {:?}", header.shape)).into());
        }
        Ok(Self { header, content })
    }

    /// All values in C order.
    fn values<const N: usize, T: Copy + Default>(&mut self, value: impl Fn([u8; N]) -> T) -> Result<Vec<T>> {
        let values = self.next(self.header.shape.iter().product(), value)?;
        Ok(if self.header.fortran_order { c_order(&values, &self.header.shape)? } else { values })
    }

    /// All counts in C order; the file must hold u8 or u16.
    fn all_counts(&mut self) -> Result<Counts> {
        Ok(match self.header.kind {
            Kind::U8 => Counts::U8(self.values(|[value]: [u8; 1]| value)?),
            _ => Counts::U16(self.values(u16::from_le_bytes)?),
        })
    }

    /// The next `left` values in the file's order.
    fn next<const N: usize, T: Copy + Default>(
        &mut self,
        mut left: usize,
        value: impl Fn([u8; N]) -> T,
    ) -> Result<Vec<T>> {
        // One block of whole numbers at a time, so that the bytes are never all in memory beside the values.
        let mut block = vec![[0_u8; N]; left.min((1 << 18) / N)];
        let mut values = super::reserve(left)?;
        while left > 0 {
            let part = left.min(block.len());
            self.content.read_exact(block[..part].as_flattened_mut())?;
            values.extend(block[..part].iter().map(|&bytes| value(bytes)));
            left -= part;
        }
        Ok(values)
    }
}

/// Values in Fortran order (first axis fastest), put into C order.
fn c_order<T: Copy>(values: &[T], shape: &[usize]) -> Result<Vec<T>> {
    let mut ordered = super::reserve(values.len())?;
    let mut place = vec![0; shape.len()];
    for _ in 0..values.len() {
        let at = place.iter().zip(shape).rev().fold(0, |at, (&i, &n)| at * n + i);
        ordered.push(values[at]);
        for (i, &n) in place.iter_mut().zip(shape).rev() {
            *i += 1;
            if *i < n {
                break;
            }
            *i = 0;
        }
    }
    Ok(ordered)
}

fn element_count(shape: &[usize]) -> Option<usize> {
    shape.iter().try_fold(1_usize, |product, &n| product.checked_mul(n))
}

/// Reads the header; returns also the number of bytes before the numbers.
fn read_header(content: &mut impl Read) -> Result<(Header, u64)> {
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
fn header(kind: Kind, extents: &[usize]) -> Vec<u8> {
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

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    fn folder() -> tempfile::TempDir {
        tempfile::tempdir().unwrap()
    }

    fn ramp() -> Video {
        Video::new(3, 4, 5, (0..60).map(|i| i as f32 / 8.0).collect()).unwrap()
    }

    /// A file with the header `text` and `data_len` bytes of zeros.
    fn file(folder: &tempfile::TempDir, text: &str, data_len: usize) -> std::path::PathBuf {
        let mut bytes = MAGIC.to_vec();
        bytes.extend([1, 0]);
        bytes.extend((text.len() as u16).to_le_bytes());
        bytes.extend(text.as_bytes());
        bytes.extend(vec![0; data_len]);
        let path = folder.path().join("x.npy");
        fs::write(&path, bytes).unwrap();
        path
    }

    #[test]
    fn videos_round_trip() {
        let folder = folder();
        let path = folder.path().join("v.npy");
        for half in [false, true] {
            write_video(&path, &ramp(), half).unwrap();
            assert_eq!(read_video(&path).unwrap(), ramp());
        }
        assert_eq!(fs::metadata(&path).unwrap().len() % 64, 120 % 64);
    }

    #[test]
    fn half_clamps_instead_of_overflowing() {
        let folder = folder();
        let path = folder.path().join("v.npy");
        write_video(&path, &Video::new(1, 1, 2, vec![1e9, 1e-9]).unwrap(), true).unwrap();
        assert_eq!(read_video(&path).unwrap().data, [65504.0, 0.0]);
    }

    #[test]
    fn counts_round_trip() {
        let folder = folder();
        let path = folder.path().join("c.npy");
        let bytes = Counts::U8((0..24).collect());
        write_counts(&path, &[2, 3, 4], &bytes).unwrap();
        assert_eq!(read_counts(&path).unwrap(), ([2, 3, 4], bytes.clone()));
        let words = Counts::U16((0..24).map(|i| i * 2000).collect());
        write_counts(&path, &[2, 3, 4], &words).unwrap();
        assert_eq!(read_counts(&path).unwrap(), ([2, 3, 4], words));
        assert!(write_counts(&path, &[2, 3, 5], &bytes).is_err());
        assert!(read_video(&path).unwrap_err().to_string().contains("integers"));
    }

    #[test]
    fn one_frame_double_and_fortran_order_are_read() {
        let folder = folder();
        let text = "{'descr': '<f8', 'fortran_order': True, 'shape': (2, 3), }\n";
        let path = file(&folder, text, 0);
        let mut bytes = fs::read(&path).unwrap();
        // Columns one behind the other: (0, 0), (1, 0), (0, 1), …
        bytes.extend([0.0_f64, 3.0, 1.0, 4.0, 2.0, 5.0].iter().flat_map(|v| v.to_le_bytes()));
        fs::write(&path, bytes).unwrap();
        let video = read_video(&path).unwrap();
        assert_eq!(video, Video::new(1, 2, 3, (0..6).map(|i| i as f32).collect()).unwrap());
    }

    #[test]
    fn every_truncation_is_refused() {
        let folder = folder();
        let path = folder.path().join("v.npy");
        write_video(&path, &ramp(), false).unwrap();
        let whole = fs::read(&path).unwrap();
        for length in 0..whole.len() {
            fs::write(&path, &whole[..length]).unwrap();
            let error = read_video(&path).unwrap_err().to_string();
            assert!(error.contains("v.npy"), "{error}");
        }
        fs::write(&path, [&whole[..], &[0]].concat()).unwrap();
        assert!(read_video(&path).is_err());
    }

    #[test]
    fn wrong_headers_are_refused_with_the_cause() {
        let folder = folder();
        let fail = |text: &str, data_len| {
            let path = file(&folder, text, data_len);
            let (video, counts) = (read_video(&path).unwrap_err(), read_counts(&path).unwrap_err());
            format!("{video} | {counts}")
        };
        let shape = |shape: &str| format!("{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}");
        assert!(fail(&shape("(4,)"), 16).contains("has shape [4]"));
        assert!(fail(&shape("()"), 4).contains("has shape []"));
        assert!(fail(&shape("(1, 1, 2, 2)"), 16).contains("has shape [1, 1, 2, 2]"));
        assert!(fail(&shape("(0, 4, 4)"), 0).contains("empty"));
        assert!(fail(&shape("(2, 4, 4)"), 64).contains("truncated"));
        // Sizes whose product overflows, or wraps to the right length.
        assert!(fail(&shape("(4294967296, 4294967296, 1)"), 0).contains("promises"));
        assert!(fail(&shape("(18446744073709551615, 2, 3)"), 8).contains("promises"));
        assert!(fail(&shape("(99999999999999999999999, 2, 3)"), 8).contains("size"));
        assert!(fail(&shape("(100000, 100000, 100)"), 64).contains("promises"));
        assert!(fail(&shape("(-1, 2, 3)"), 8).contains("size"));
        assert!(fail(&shape(&"(".repeat(9000)), 8).contains("size"));
        assert!(fail(&shape(&format!("({})", "1,".repeat(3000))), 4).contains("axes"));
        let descr = |descr: &str| format!("{{'descr': {descr}, 'fortran_order': False, 'shape': (1, 1, 1)}}");
        assert!(fail(&descr("'<i8'"), 8).contains("'<i8'"));
        assert!(fail(&descr("'|O'"), 8).contains("'|O'"));
        assert!(fail(&descr("'>f4'"), 4).contains("big-endian"));
        assert!(fail(&descr("[('a', '<f4')]"), 4).contains("quoted word"));
        assert!(fail("{'descr': '<f4', 'shape': (1, 1, 1)}", 4).contains("without"));
        assert!(fail("{'pickle': 1}", 4).contains("unknown key"));
        assert!(fail("", 4).contains("unreadable"));
        assert!(fail("\u{fe}\u{ff}{", 4).contains("unreadable"));
    }

    #[test]
    fn unusable_pixels_are_named() {
        let folder = folder();
        let path = folder.path().join("v.npy");
        write_video(&path, &ramp(), false).unwrap();
        let whole = fs::read(&path).unwrap();
        for value in [f32::NAN, f32::INFINITY, -1.0] {
            let mut bytes = whole.clone();
            let at = bytes.len() - 60 * 4 + ((2 * 4 + 3) * 5 + 1) * 4;
            bytes[at..at + 4].copy_from_slice(&value.to_le_bytes());
            fs::write(&path, bytes).unwrap();
            let error = read_video(&path).unwrap_err().to_string();
            assert!(error.contains("frame 2, row 3, column 1"), "{error}");
        }
        let mut video = ramp();
        video.data[7] = f32::NAN;
        assert!(write_video(&path, &video, false).unwrap_err().to_string().contains("row 1, column 2"));
    }

    #[test]
    fn a_writer_wants_the_promised_frames() {
        let folder = folder();
        let path = folder.path().join("v.npy");
        let mut writer = NpyWriter::begin(&path, [2, 2, 2], false).unwrap();
        assert!(writer.push(&[0.0; 3]).is_err());
        writer.push(&[0.0; 4]).unwrap();
        assert!(writer.finish().unwrap_err().to_string().contains("1 of 2"));
        assert!(fs::read_dir(folder.path()).unwrap().next().is_none());
        let mut writer = NpyWriter::begin(&path, [1, 2, 2], false).unwrap();
        writer.push(&[0.0; 4]).unwrap();
        assert!(writer.push(&[0.0; 4]).is_err());
        writer.finish().unwrap();
        assert!(NpyWriter::begin(&path, [1, 0, 2], false).is_err());
    }
}
