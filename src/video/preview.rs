//! A preview video of tone-mapped frames, through `ffmpeg`.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use super::atomic::make_parent;
use super::png::tone_byte;
use crate::{At, Error, Result};

/// Writes frames into an `ffmpeg` process. Dropped unfinished, it leaves no file behind.
#[derive(Debug)]
pub struct PreviewWriter {
    encoder: Child,
    path: PathBuf,
    part: PathBuf,
    bytes: Vec<u8>,
}

impl PreviewWriter {
    /// Whether there is an `ffmpeg` to run.
    pub fn is_installed() -> bool {
        let quiet = |command: &mut Command| command.arg("-version").stdout(Stdio::null()).status();
        quiet(&mut Command::new("ffmpeg")).is_ok_and(|status| status.success())
    }

    /// Begins a video of frames of `extent` [rows, columns] at `rate` frames per second.
    pub fn begin(path: impl AsRef<Path>, [height, width]: [usize; 2], rate: u32) -> Result<Self> {
        let path = path.as_ref();
        let folder = make_parent(path)?;
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        // The ending stays, since ffmpeg chooses the container by it.
        let part = folder.join(format!(".pix2hdr-{}-{name}", std::process::id()));
        let encoder = Command::new("ffmpeg")
            .args(["-loglevel", "error", "-y", "-f", "rawvideo", "-pix_fmt", "gray"])
            .args(["-s", &format!("{width}x{height}"), "-r", &rate.max(1).to_string(), "-i", "-"])
            .args(["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", "-pix_fmt", "yuv420p"])
            .arg(&part)
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .spawn()
            .map_err(|error| match error.kind() {
                std::io::ErrorKind::NotFound => {
                    Error::Usage("a preview video needs ffmpeg, which is not installed".into())
                }
                _ => error.into(),
            })
            .at(path)?;
        Ok(Self { encoder, path: path.to_owned(), part, bytes: Vec::new() })
    }

    /// Appends a frame of irradiance.
    pub fn push(&mut self, frame: &[f32]) -> Result<()> {
        self.bytes.clear();
        self.bytes.extend(frame.iter().map(|&p| tone_byte(p)));
        match &mut self.encoder.stdin {
            Some(stdin) => stdin.write_all(&self.bytes).at(&self.path),
            None => Err(Error::Usage("the preview is finished already".into())),
        }
    }

    /// Completes the file and returns its path.
    pub fn finish(mut self) -> Result<PathBuf> {
        drop(self.encoder.stdin.take());
        let status = self.encoder.wait().at(&self.path)?;
        if !status.success() {
            return Err(Error::Usage(format!("ffmpeg failed ({status})"))).at(&self.path);
        }
        std::fs::rename(&self.part, &self.path).at(&self.path)?;
        Ok(self.path.clone())
    }
}

impl Drop for PreviewWriter {
    fn drop(&mut self) {
        if self.encoder.stdin.take().is_some() {
            // Failures to clean up have nobody to hear of them.
            let _ = self.encoder.kill();
            let _ = self.encoder.wait();
        }
        let _ = std::fs::remove_file(&self.part);
    }
}
