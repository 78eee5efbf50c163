//! Radiance pictures (`.hdr`): run-length encoded or flat, read as luminance.
//!
//! Read here, not by the crate `image`: that refuses the signature `#?RGBE`, which many panoramas carry, leaves turned
//! pictures turned, and brings a colour management library along, for a format of one page.

use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;

use super::format::Format;
use super::pixels::{check_pixels, check_size, luminance, reserve};
use super::{Video, VideoError};
use crate::{At, Result};

/// Single pictures, which are only read.
pub(super) const FORMAT: Format = Format {
    name: "a .hdr picture",
    endings: &["hdr", "pic"],
    single: true,
    open: |path| Ok(Box::new(read(path)?)),
    begin: None,
    counts: None,
};

/// Longest line of a header that is read.
const MAX_LINE: u64 = 4096;
/// Most lines of a header that are read.
const MAX_LINES: usize = 1000;

/// Reads a picture as a video of one frame, in the file's own units: luminance of its colours (Rec. 709), or Y of XYZ.
/// `EXPOSURE` lines are undone, as the format asks.
pub fn read(path: impl AsRef<Path>) -> Result<Video> {
    let path = path.as_ref();
    let file = File::open(path).at(path)?;
    let picture = read_picture(&mut BufReader::new(file)).at(path)?;
    check_pixels(&picture.data, 0, picture.width).at(path)?;
    Ok(picture)
}

fn read_picture(content: &mut impl BufRead) -> Result<Video> {
    let header = read_header(content)?;
    let Layout { scans, scan_len, .. } = header.layout;
    let mut stored = reserve(scans * scan_len)?;
    let mut scan = vec![[0_u8; 4]; scan_len];
    for _ in 0..scans {
        read_scan(content, &mut scan).map_err(|error| match error.kind() {
            std::io::ErrorKind::UnexpectedEof => VideoError::Format("ends within its pixels".into()).into(),
            std::io::ErrorKind::InvalidData => VideoError::Format(error.to_string()).into(),
            _ => crate::Error::from(error),
        })?;
        stored.extend(scan.iter().map(|&pixel| header.luminance(pixel)));
    }
    Ok(header.layout.upright(stored)?)
}

struct Header {
    xyz: bool,
    exposure: f32,
    layout: Layout,
}

impl Header {
    fn luminance(&self, [a, b, c, e]: [u8; 4]) -> f32 {
        if e == 0 {
            return 0.0;
        }
        let unit = 2.0_f64.powi(i32::from(e) - 128 - 8) / f64::from(self.exposure);
        let value = |mantissa: u8| f32::from(mantissa);
        let sum = if self.xyz { value(b) } else { luminance([value(a), value(b), value(c)]) };
        (f64::from(sum) * unit) as f32
    }
}

/// Order of the pixels in the file.
#[derive(Debug)]
struct Layout {
    /// Lines of pixels in the file.
    scans: usize,
    /// Pixels of each.
    scan_len: usize,
    /// Whether scans are columns.
    columns: bool,
    /// Whether the picture begins at the bottom.
    from_bottom: bool,
    /// Whether the picture begins at the right.
    from_right: bool,
}

impl Layout {
    /// Parses e.g. `-Y 512 +X 1024`.
    fn parse(line: &str) -> Result<Self, VideoError> {
        let problem = || VideoError::Format(format!("has no usable size: {line:?}"));
        let words: Vec<&str> = line.split_whitespace().collect();
        let [first, scans, second, scan_len] = words[..] else { return Err(problem()) };
        let (scans, scan_len) =
            (scans.parse().map_err(|_| problem())?, scan_len.parse().map_err(|_| problem())?);
        let (columns, vertical, horizontal) = match (first, second) {
            ("-Y" | "+Y", "-X" | "+X") => (false, first, second),
            ("-X" | "+X", "-Y" | "+Y") => (true, second, first),
            _ => return Err(problem()),
        };
        check_size(scans, scan_len)?;
        Ok(Self { scans, scan_len, columns, from_bottom: vertical == "+Y", from_right: horizontal == "-X" })
    }

    /// The picture with its origin at the top left.
    fn upright(&self, stored: Vec<f32>) -> Result<Video, VideoError> {
        let (height, width) =
            if self.columns { (self.scan_len, self.scans) } else { (self.scans, self.scan_len) };
        if !self.columns && !self.from_bottom && !self.from_right {
            return Video::new(1, height, width, stored);
        }
        let pixel = |i: usize| {
            let (y, x) = (i / width, i % width);
            let y = if self.from_bottom { height - 1 - y } else { y };
            let x = if self.from_right { width - 1 - x } else { x };
            stored[if self.columns { x * height + y } else { y * width + x }]
        };
        Video::new(1, height, width, (0..stored.len()).map(pixel).collect())
    }
}

fn read_header(content: &mut impl BufRead) -> Result<Header> {
    let signature = read_line(content)?;
    if !signature.starts_with("#?") {
        return Err(VideoError::Format("is not a Radiance picture".into()).into());
    }
    let (mut xyz, mut exposure) = (false, 1.0_f32);
    for _ in 0..MAX_LINES {
        let line = read_line(content)?;
        if line.is_empty() {
            let layout = Layout::parse(&read_line(content)?)?;
            if !(exposure.is_normal() && exposure > 0.0) {
                return Err(VideoError::Format(format!("has an exposure of {exposure}")).into());
            }
            return Ok(Header { xyz, exposure, layout });
        }
        match line.split_once('=') {
            Some(("FORMAT", "32-bit_rle_rgbe")) => xyz = false,
            Some(("FORMAT", "32-bit_rle_xyze")) => xyz = true,
            Some(("FORMAT", format)) => {
                return Err(VideoError::Format(format!("has the unknown format {format:?}")).into());
            }
            Some(("EXPOSURE", value)) => exposure *= value.trim().parse::<f32>().unwrap_or(f32::NAN),
            _ => {} // comments and attributes that do not change the pixels
        }
    }
    Err(VideoError::Format("has a header without end".into()).into())
}

/// One line without its end.
fn read_line(content: &mut impl BufRead) -> Result<String> {
    let mut line = Vec::new();
    content.take(MAX_LINE).read_until(b'\n', &mut line)?;
    if line.pop() != Some(b'\n') {
        return Err(VideoError::Format("ends within its header".into()).into());
    }
    Ok(String::from_utf8_lossy(&line).trim_end_matches('\r').to_owned())
}

/// One scan of pixels in any of the three encodings: flat, old runs (a pixel 1 1 1 n repeats the last), new runs (each
/// component on its own).
fn read_scan(content: &mut impl Read, scan: &mut [[u8; 4]]) -> std::io::Result<()> {
    let mut pixel = [0_u8; 4];
    content.read_exact(&mut pixel)?;
    let len = scan.len();
    let declared = usize::from(pixel[2]) << 8 | usize::from(pixel[3]);
    if pixel[..2] == [2, 2] && (8..0x8000).contains(&len) && declared == len {
        return (0..4).try_for_each(|component| read_component(content, scan, component));
    }
    let (mut at, mut shift) = (0, 0);
    loop {
        if pixel[..3] == [1, 1, 1] {
            // Markers in a row are the digits of one count.
            let count = usize::from(pixel[3]).checked_shl(shift).unwrap_or(usize::MAX);
            if at == 0 || count > len - at {
                return Err(overrun());
            }
            let last = scan[at - 1];
            scan[at..at + count].fill(last);
            (at, shift) = (at + count, shift + 8);
        } else {
            scan[at] = pixel;
            (at, shift) = (at + 1, 0);
        }
        if at == len {
            return Ok(());
        }
        content.read_exact(&mut pixel)?;
    }
}

fn read_component(content: &mut impl Read, scan: &mut [[u8; 4]], component: usize) -> std::io::Result<()> {
    let mut bytes = [0_u8; 128];
    let mut at = 0;
    while at < scan.len() {
        content.read_exact(&mut bytes[..1])?;
        let (count, run) = match usize::from(bytes[0]) {
            count @ 0..=128 => (count, false),
            count => (count - 128, true),
        };
        if count == 0 || count > scan.len() - at {
            return Err(overrun());
        }
        if run {
            content.read_exact(&mut bytes[..1])?;
            bytes = [bytes[0]; 128];
        } else {
            content.read_exact(&mut bytes[..count])?;
        }
        for (pixel, &byte) in scan[at..at + count].iter_mut().zip(&bytes) {
            pixel[component] = byte;
        }
        at += count;
    }
    Ok(())
}

fn overrun() -> std::io::Error {
    std::io::Error::new(std::io::ErrorKind::InvalidData, "has a run of pixels that does not fit its line")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(header: &str, pixels: &[u8]) -> Result<Video> {
        read_picture(&mut [header.as_bytes(), pixels].concat().as_slice())
    }

    /// A grey pixel of mantissa 128: its value is 2^(e − 129).
    fn grey(e: u8) -> [u8; 4] {
        [128, 128, 128, e]
    }

    fn values(header: &str, pixels: &[[u8; 4]]) -> Vec<f32> {
        let values = parse(header, pixels.as_flattened()).unwrap().data;
        values.iter().map(|v| (v * 1024.0).round() / 1024.0).collect()
    }

    const HEAD: &str = "#?RADIANCE\n# made by hand\nFORMAT=32-bit_rle_rgbe\n\n";

    #[test]
    fn flat_pixels_and_orientations() {
        let pixels = [grey(129), grey(130), grey(131), grey(132), grey(133), grey(134)];
        let read = |size: &str| values(&format!("{HEAD}{size}\n"), &pixels);
        assert_eq!(read("-Y 2 +X 3"), [1.0, 2.0, 4.0, 8.0, 16.0, 32.0]);
        assert_eq!(read("+Y 2 +X 3"), [8.0, 16.0, 32.0, 1.0, 2.0, 4.0]);
        assert_eq!(read("-Y 2 -X 3"), [4.0, 2.0, 1.0, 32.0, 16.0, 8.0]);
        assert_eq!(read("+X 3 -Y 2"), [1.0, 4.0, 16.0, 2.0, 8.0, 32.0]);
        let exposed = "#?RGBE\nEXPOSURE=2\nEXPOSURE=2.0\n\n-Y 2 +X 3\n";
        assert_eq!(values(exposed, &pixels)[..3], [0.25, 0.5, 1.0]);
        let xyz = "#?RADIANCE\nFORMAT=32-bit_rle_xyze\n\n-Y 1 +X 1\n";
        assert_eq!(values(xyz, &[[1, 128, 2, 129]]), [1.0]);
        assert_eq!(values(&format!("{HEAD}-Y 1 +X 1\n"), &[[9, 9, 9, 0]]), [0.0]);
    }

    #[test]
    fn both_kinds_of_runs() {
        let old = [grey(129), [1, 1, 1, 3], grey(130), [1, 1, 1, 2], [1, 1, 1, 1]];
        let mut expected = vec![1.0; 4];
        expected.extend([2.0; 1 + 2 + 256]);
        assert_eq!(values(&format!("{HEAD}-Y 1 +X 263\n"), &old), expected);

        let mut new = vec![2, 2, 0, 10];
        for _ in 0..3 {
            new.extend([128 + 10, 128]);
        }
        new.extend([4, 129, 130, 131, 132, 128 + 6, 133]);
        let video = parse(&format!("{HEAD}-Y 1 +X 10\n"), &new).unwrap();
        assert!((video.data[3] - 8.0).abs() < 1e-5 && (video.data[9] - 16.0).abs() < 1e-5);
    }

    #[test]
    fn every_truncation_is_refused() {
        let mut whole = format!("{HEAD}-Y 1 +X 10\n").into_bytes();
        whole.extend([2, 2, 0, 10]);
        for _ in 0..4 {
            whole.extend([128 + 10, 128]);
        }
        assert!(read_picture(&mut whole.as_slice()).is_ok());
        for length in 0..whole.len() {
            assert!(read_picture(&mut &whole[..length]).is_err(), "{length} bytes");
        }
    }

    #[test]
    fn hostile_files_are_refused() {
        let fail = |header: &str, pixels: &[u8]| parse(header, pixels).unwrap_err().to_string();
        assert!(fail("P6\n1 1\n", &[]).contains("not a Radiance"));
        assert!(fail(&format!("{HEAD}-Y 99999999 +X 99999999\n"), &[]).contains("pixels"));
        assert!(fail(&format!("{HEAD}-Y 0 +X 3\n"), &[]).contains("pixels"));
        assert!(fail(&format!("{HEAD}-Y -1 +X 3\n"), &[]).contains("usable size"));
        assert!(fail(&format!("{HEAD}-Y 1 +Y 3\n"), &[]).contains("usable size"));
        assert!(fail("#?RADIANCE\nFORMAT=jpeg\n\n-Y 1 +X 1\n", &[0; 4]).contains("jpeg"));
        assert!(fail("#?RADIANCE\nEXPOSURE=0\n\n-Y 1 +X 1\n", &[0; 4]).contains("exposure"));
        assert!(fail(&format!("#?RADIANCE\n{}", "x\n".repeat(2000)), &[]).contains("without end"));
        assert!(fail(&format!("#?RADIANCE\n{}", "x".repeat(10_000)), &[]).contains("header"));
        // A run before any pixel, runs past the end, and markers whose count overflows.
        assert!(fail(&format!("{HEAD}-Y 1 +X 9\n"), &[1, 1, 1, 2]).contains("run"));
        assert!(fail(&format!("{HEAD}-Y 1 +X 2\n"), &[9, 9, 9, 9, 1, 1, 1, 2]).contains("run"));
        let zeros = [&[9, 9, 9, 9][..], &[1, 1, 1, 0].repeat(9), &[1, 1, 1, 255]].concat();
        assert!(parse(&format!("{HEAD}-Y 1 +X 2\n"), &zeros).is_err());
        assert!(fail(&format!("{HEAD}-Y 1 +X 8\n"), &[2, 2, 0, 8, 0]).contains("run"));
        assert!(fail(&format!("{HEAD}-Y 1 +X 8\n"), &[2, 2, 0, 8, 137, 1]).contains("run"));
    }
}
