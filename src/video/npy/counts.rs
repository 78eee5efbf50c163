//! Counts of captures.

use std::io::Write;
use std::path::{Path, PathBuf};

use super::super::atomic::AtomicFile;
use super::super::format::{ReadCounts, WriteCounts};
use super::super::pixels::check_complete;
use super::super::{Counts, VideoError, atomic};
use super::file::Npy;
use super::header::{Kind, check_count, header};
use crate::{At, Result};

/// Reads the counts of a capture, u8 or u16, and their extents [t, y, x].
pub fn read_counts(path: impl AsRef<Path>) -> Result<([usize; 3], Counts)> {
    let path = path.as_ref();
    let CountsReader { mut npy, extents, .. } = CountsReader::open(path)?;
    let counts = match npy.header.kind {
        Kind::U8 => npy.values(|[value]: [u8; 1]| value).map(Counts::U8),
        _ => npy.values(u16::from_le_bytes).map(Counts::U16),
    };
    Ok((extents, counts.at(path)?))
}

/// Reads the counts of a capture frame by frame.
#[derive(Debug)]
pub struct CountsReader {
    npy: Npy,
    path: PathBuf,
    extents: [usize; 3],
}

impl CountsReader {
    /// Opens a file, u8 or u16, [t, y, x].
    pub fn open(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let open = || -> Result<Self> {
            let npy = Npy::open(path)?;
            let [t, y, x] = npy.header.shape[..] else {
                return Err(npy.header.wrong_rank("a capture has axes [t, y, x]").into());
            };
            if matches!(npy.header.kind, Kind::F16 | Kind::F32 | Kind::F64) {
                let problem = "holds floating-point numbers, as a video does; a capture is u8 or u16";
                return Err(VideoError::Format(problem.into()).into());
            }
            Ok(Self { npy, path: path.to_owned(), extents: [t, y, x] })
        };
        open().at(path)
    }
}

/// [`CountsReader::open`], for the table of formats.
pub(super) fn open(path: &Path) -> Result<Box<dyn ReadCounts>> {
    Ok(Box::new(CountsReader::open(path)?))
}

impl ReadCounts for CountsReader {
    fn extents(&self) -> [usize; 3] {
        self.extents
    }

    fn bits(&self) -> u32 {
        8 * self.npy.header.kind.bytes() as u32
    }

    fn frame(&mut self, t: usize) -> Result<Counts> {
        let counts = match self.npy.header.kind {
            Kind::U8 => self.npy.frame(t, |[value]: [u8; 1]| value).map(Counts::U8),
            _ => self.npy.frame(t, u16::from_le_bytes).map(Counts::U16),
        };
        counts.at(&self.path)
    }
}

/// Writes counts of any extents: [t, y, x] for a capture, [n, t, y, x] for cubes of a data set.
pub fn write_counts(path: impl AsRef<Path>, extents: &[usize], counts: &Counts) -> Result<()> {
    let path = path.as_ref();
    check_count(counts.len(), extents).at(path)?;
    atomic::write(path, |file| {
        file.write_all(&header(kind_of(counts.bits()), extents))?;
        write_values(file, counts)
    })
}

/// Writes the counts of a capture frame by frame. The file appears when it is finished.
#[derive(Debug)]
pub struct CountsWriter {
    file: AtomicFile,
    path: PathBuf,
    extents: [usize; 3],
    bits: u32,
    pushed: usize,
}

impl CountsWriter {
    /// Begins a file of extents [t, y, x] and of numbers of 8 or 16 `bits`.
    pub fn begin(path: impl AsRef<Path>, extents: [usize; 3], bits: u32) -> Result<Self> {
        let path = path.as_ref();
        let mut file = AtomicFile::create(path)?;
        file.content.write_all(&header(kind_of(bits), &extents)).at(path)?;
        Ok(Self { file, path: path.to_owned(), extents, bits, pushed: 0 })
    }
}

/// [`CountsWriter::begin`], for the table of formats.
pub(super) fn begin(path: &Path, extents: [usize; 3], bits: u32) -> Result<Box<dyn WriteCounts>> {
    Ok(Box::new(CountsWriter::begin(path, extents, bits)?))
}

impl WriteCounts for CountsWriter {
    fn push(&mut self, frame: &Counts) -> Result<()> {
        let [frames, y, x] = self.extents;
        if self.pushed == frames || frame.len() != y * x || frame.bits() != self.bits {
            let problem = format!(
                "{} counts of {} bits as frame {} of {frames} frames of {y}×{x} of {} bits",
                frame.len(),
                frame.bits(),
                self.pushed,
                self.bits
            );
            return Err(VideoError::Shape(problem)).at(&self.path);
        }
        write_values(&mut self.file.content, frame).at(&self.path)?;
        self.pushed += 1;
        Ok(())
    }

    fn finish(self: Box<Self>) -> Result<()> {
        check_complete(self.pushed, self.extents[0]).at(&self.path)?;
        self.file.finish()
    }
}

fn kind_of(bits: u32) -> Kind {
    if bits == 8 { Kind::U8 } else { Kind::U16 }
}

fn write_values(file: &mut impl Write, counts: &Counts) -> Result<()> {
    match counts {
        Counts::U8(values) => file.write_all(values)?,
        Counts::U16(values) => {
            for value in values {
                file.write_all(&value.to_le_bytes())?;
            }
        }
    }
    Ok(())
}
