//! Videos: cubes of floating-point numbers.

use std::fs::File;
use std::io::{BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use half::f16;

use super::super::atomic::{self, AtomicFile};
use super::super::format::{Destination, ReadVideo, WriteVideo};
use super::super::pixels::{check_complete, check_frame, check_pixels, half_of};
use super::super::{Video, VideoError, check_free};
use super::file::Npy;
use super::header::{Kind, element_count, header};
use crate::frame::Plane;
use crate::{At, Result};

/// Reads an HDR video: f16, f32 or f64, [t, y, x], or one frame [y, x]. Every value must be finite and ≥ 0.
pub fn read_video(path: impl AsRef<Path>) -> Result<Video> {
    Box::new(NpyReader::open(path.as_ref())?).all()
}

/// Writes an HDR video as f32, or as f16 if `half` (values above 65504 become 65504).
pub fn write_video(path: impl AsRef<Path>, video: &Video, half: bool) -> Result<()> {
    let mut writer = NpyWriter::begin(path.as_ref(), [video.frames, video.height, video.width], half)?;
    for t in 0..video.frames {
        writer.push(video.plane(t))?;
    }
    Box::new(writer).finish()
}

/// Reads a video frame by frame.
struct NpyReader {
    npy: Npy,
    path: PathBuf,
    extents: [usize; 3],
}

impl NpyReader {
    fn open(path: &Path) -> Result<Self> {
        let open = || -> Result<Self> {
            let npy = Npy::open(path)?;
            let extents = match npy.header.shape[..] {
                [frames, height, width] => [frames, height, width],
                [height, width] => [1, height, width],
                _ => {
                    return Err(npy.header.wrong_rank("a video has axes [t, y, x], one frame [y, x]").into());
                }
            };
            if matches!(npy.header.kind, Kind::U8 | Kind::U16) {
                let problem = "holds integers, as a capture does; a video is f16, f32 or f64";
                return Err(VideoError::Format(problem.into()).into());
            }
            Ok(Self { npy, path: path.to_owned(), extents })
        };
        open().at(path)
    }
}

/// Opens a video, for the table of formats.
pub(super) fn open(path: &Path) -> Result<Box<dyn ReadVideo>> {
    Ok(Box::new(NpyReader::open(path)?))
}

fn from_half(bytes: [u8; 2]) -> f32 {
    f16::from_le_bytes(bytes).to_f32()
}

fn from_double(bytes: [u8; 8]) -> f32 {
    f64::from_le_bytes(bytes) as f32
}

impl ReadVideo for NpyReader {
    fn extents(&self) -> [usize; 3] {
        self.extents
    }

    fn frame(&mut self, t: usize) -> Result<Vec<f32>> {
        let frame = match self.npy.header.kind {
            Kind::F16 => self.npy.frame(t, from_half),
            Kind::F64 => self.npy.frame(t, from_double),
            _ => self.npy.frame(t, f32::from_le_bytes),
        };
        let frame = frame.at(&self.path)?;
        check_pixels(&frame, t, self.extents[2]).at(&self.path)?;
        Ok(frame)
    }

    fn all(mut self: Box<Self>) -> Result<Video> {
        let [frames, height, width] = self.extents;
        let data = match self.npy.header.kind {
            Kind::F16 => self.npy.values(from_half),
            Kind::F64 => self.npy.values(from_double),
            _ => self.npy.values(f32::from_le_bytes),
        };
        let video = data.and_then(|data| Ok(Video::new(frames, height, width, data)?)).at(&self.path)?;
        video.check_finite().at(&self.path)?;
        Ok(video)
    }
}

/// Writes a video frame by frame. The file appears when it is finished.
#[derive(Debug)]
pub(super) struct NpyWriter {
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

/// Begins a video, for the table of formats.
pub(super) fn begin(path: &Path, to: Destination<'_>) -> Result<Box<dyn WriteVideo>> {
    check_free(path, to.how.overwrite)?;
    Ok(Box::new(match to.partial {
        None => NpyWriter::begin(path, to.extents, to.how.half)?,
        Some(partial) => NpyWriter::go_on(path, to.extents, to.how.half, partial)?,
    }))
}

impl NpyWriter {
    /// Begins a file of extents [t, y, x], f16 if `half`, else f32.
    pub fn begin(path: &Path, extents: [usize; 3], half: bool) -> Result<Self> {
        check_extents(extents).at(path)?;
        let mut file = AtomicFile::create(path)?;
        file.content.write_all(&header(kind_of(half), &extents)).at(path)?;
        let (file, path) = (Working::Hidden(file), path.to_owned());
        Ok(Self { file, path, extents, pushed: 0, half, line: Vec::new() })
    }

    /// As [`NpyWriter::begin`], but frames are collected in the file `partial`, which stays until it is complete.
    /// Whole frames that are there already are the first ones of the video.
    fn go_on(path: &Path, extents: [usize; 3], half: bool, partial: &Path) -> Result<Self> {
        check_extents(extents).at(path)?;
        let [_, y, x] = extents;
        atomic::make_parent(partial)?;
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
}

impl WriteVideo for NpyWriter {
    fn pushed(&self) -> usize {
        self.pushed
    }

    fn push(&mut self, frame: Plane<'_>) -> Result<()> {
        check_frame(frame, self.pushed, self.extents).at(&self.path)?;
        for row in frame.values().chunks(self.extents[2]) {
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

    fn finish(self: Box<Self>) -> Result<()> {
        check_complete(self.pushed, self.extents[0]).at(&self.path)?;
        match self.file {
            Working::Hidden(file) => file.finish(),
            Working::Partial(mut file, partial) => {
                file.flush().at(&partial)?;
                drop(file);
                std::fs::rename(&partial, &self.path).at(&self.path)
            }
        }
    }

    /// The header of what is left counts the frames that were written, which are fewer than those pushed where the disk
    /// is full.
    fn suspend(self: Box<Self>) -> Result<usize> {
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
