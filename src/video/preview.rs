//! A preview video of tone-mapped frames, through `ffmpeg`.

use std::fs::File;
use std::io::{ErrorKind, Read, Seek, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command, Stdio};

use super::VideoError;
use super::atomic::make_parent;
use super::png::tone_byte;
use crate::{At, Error, Result};

/// Writes frames into an `ffmpeg` process. Dropped unfinished, it leaves no file behind.
#[derive(Debug)]
pub struct PreviewWriter {
    // Dropped in this order: no more frames, then no encoder.
    frames: ChildStdin,
    encoder: Encoder,
    path: PathBuf,
    bytes: Vec<u8>,
}

/// The process, and the file that it writes.
#[derive(Debug)]
struct Encoder {
    process: Child,
    part: PathBuf,
    /// What it says of failures.
    said: File,
}

impl Encoder {
    /// Why it failed, in its own words, which name the file as its user does.
    fn failure(&mut self, path: &Path) -> Error {
        let mut said = Vec::new();
        // Where even that cannot be read, there are no words.
        let _ = self.said.rewind().and_then(|()| self.said.read_to_end(&mut said));
        let said = String::from_utf8_lossy(&said);
        let first = said.lines().next().unwrap_or("no reason given");
        let words = first.rsplit_once("] ").map_or(first, |(_, words)| words);
        let words = words.replace(&*self.part.to_string_lossy(), &path.to_string_lossy());
        Error::from(VideoError::Encoder(format!("ffmpeg cannot write this video: {words}"))).at(path)
    }
}

impl PreviewWriter {
    /// Whether there is an `ffmpeg` to run.
    pub fn is_installed() -> bool {
        let quiet = |command: &mut Command| command.arg("-version").stdout(Stdio::null()).status();
        quiet(&mut Command::new("ffmpeg")).is_ok_and(|status| status.success())
    }

    /// Has `ffmpeg` write one black frame of `extent` [rows, columns], and forget it: what cannot be written is said
    /// before there is anything to lose.
    pub fn check(path: impl AsRef<Path>, extent: [usize; 2], rate: u32) -> Result<()> {
        let mut trial = Self::begin(path, extent, rate)?;
        trial.push(&vec![0.0; extent[0] * extent[1]])?;
        trial.end().map(drop)
    }

    /// Begins a video of frames of `extent` [rows, columns] at `rate` frames per second.
    pub fn begin(path: impl AsRef<Path>, [height, width]: [usize; 2], rate: u32) -> Result<Self> {
        let path = path.as_ref();
        let folder = make_parent(path)?;
        let said = tempfile::tempfile()?;
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        // The ending stays, since ffmpeg chooses the container by it.
        let part = folder.join(format!(".pix2hdr-{}-{name}", std::process::id()));
        let mut process = Command::new("ffmpeg")
            .args(["-loglevel", "error", "-y", "-f", "rawvideo", "-pix_fmt", "gray"])
            .args(["-s", &format!("{width}x{height}"), "-r", &rate.max(1).to_string(), "-i", "-"])
            .args(["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", "-pix_fmt", "yuv420p"])
            .arg(&part)
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(said.try_clone()?)
            .spawn()
            .map_err(|error| match error.kind() {
                ErrorKind::NotFound => Error::from(VideoError::Encoder(
                    "a preview video needs ffmpeg, which is not installed".into(),
                )),
                _ => error.into(),
            })
            .at(path)?;
        let frames = process.stdin.take().expect("it is piped");
        let encoder = Encoder { process, part, said };
        Ok(Self { frames, encoder, path: path.to_owned(), bytes: Vec::new() })
    }

    /// Appends a frame of irradiance.
    pub fn push(&mut self, frame: &[f32]) -> Result<()> {
        self.bytes.clear();
        self.bytes.extend(frame.iter().map(|&p| tone_byte(p)));
        match self.frames.write_all(&self.bytes) {
            // It has ended, and said why.
            Err(error) if error.kind() == ErrorKind::BrokenPipe => Err(self.encoder.failure(&self.path)),
            outcome => outcome.at(&self.path),
        }
    }

    /// Waits until all frames are written, under the hidden name.
    fn end(self) -> Result<(Encoder, PathBuf)> {
        let Self { frames, mut encoder, path, .. } = self;
        drop(frames);
        let status = encoder.process.wait().at(&path)?;
        if !status.success() {
            return Err(encoder.failure(&path));
        }
        Ok((encoder, path))
    }

    /// Completes the file and returns its path.
    pub fn finish(self) -> Result<PathBuf> {
        let (encoder, path) = self.end()?;
        std::fs::rename(&encoder.part, &path).at(&path)?;
        Ok(path)
    }
}

impl Drop for Encoder {
    fn drop(&mut self) {
        // Failures to clean up have nobody to hear of them, and a process that was waited for is not there any more.
        let _ = self.process.kill();
        let _ = self.process.wait();
        let _ = std::fs::remove_file(&self.part);
    }
}
