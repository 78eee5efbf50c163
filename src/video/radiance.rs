//! Radiance pictures (`.hdr`): run-length encoded or flat, read as luminance.
//!
//! Read here, not by the crate `image`: that refuses the signature `#?RGBE`, which many panoramas carry, leaves turned
//! pictures turned, and brings a colour management library along, for a format of one page.

use std::fs::File;
use std::io::{BufRead, BufReader, Read, Take};
use std::path::Path;

use super::format::Format;
use super::pixels::{check_pixels, check_size, luminance, luminance_weights, reserve};
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

/// Longest header that is read; programs keep whole command lines in it.
const MAX_HEADER: u64 = 1 << 20;

/// Reads a picture as a video of one frame, in the file's own units: luminance of its colours (Rec. 709), or Y of XYZ.
/// `EXPOSURE` and `COLORCORR` lines are undone, as the format asks, and `PRIMARIES` give colours other weights.
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
    /// What the three components add to the luminance.
    weights: [f32; 3],
    exposure: f32,
    layout: Layout,
}

impl Header {
    fn luminance(&self, [a, b, c, e]: [u8; 4]) -> f32 {
        if e == 0 {
            return 0.0;
        }
        let unit = 2.0_f64.powi(i32::from(e) - 128 - 8) / f64::from(self.exposure);
        let [wa, wb, wc] = self.weights;
        let sum = wa * f32::from(a) + wb * f32::from(b) + wc * f32::from(c);
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
    let content = &mut content.take(MAX_HEADER);
    let signature = read_line(content)?;
    if !signature.starts_with("#?") {
        return Err(VideoError::Format("is not a Radiance picture".into()).into());
    }
    let (mut xyz, mut exposure, mut correction) = (false, 1.0_f32, [1.0_f32; 3]);
    let mut colours = [luminance([1.0, 0.0, 0.0]), luminance([0.0, 1.0, 0.0]), luminance([0.0, 0.0, 1.0])];
    loop {
        let line = read_line(content)?;
        if line.is_empty() {
            break;
        }
        let unusable = || VideoError::Format(format!("has an unusable line {line:?} in its header"));
        match line.split_once('=').map(|(key, value)| (key.trim(), value.trim())) {
            Some(("FORMAT", "32-bit_rle_rgbe")) => xyz = false,
            Some(("FORMAT", "32-bit_rle_xyze")) => xyz = true,
            Some(("FORMAT", format)) => {
                return Err(VideoError::Format(format!("has the unknown format {format:?}")).into());
            }
            // Programs write 0 for an exposure that they do not know.
            Some(("EXPOSURE", value)) => match numbers(value) {
                Some([0.0]) => {}
                Some([factor]) => exposure *= factor,
                None => return Err(unusable().into()),
            },
            Some(("COLORCORR", value)) => {
                let factors: [f32; 3] = numbers(value).ok_or_else(unusable)?;
                correction = [0, 1, 2].map(|i| correction[i] * factors[i]);
            }
            Some(("PRIMARIES", value)) => {
                let [rx, ry, gx, gy, bx, by, wx, wy] = numbers(value).ok_or_else(unusable)?.map(f64::from);
                let primaries = [[rx, ry], [gx, gy], [bx, by]];
                colours = luminance_weights(primaries, [wx, wy]).ok_or_else(unusable)?;
            }
            _ => {} // comments and attributes that do not change the pixels
        }
    }
    let layout = Layout::parse(&read_line(content)?)?;
    let usable = |factor: f32| factor.is_normal() && factor > 0.0;
    if !usable(exposure) {
        return Err(VideoError::Format(format!("has an exposure of {exposure}")).into());
    }
    if !correction.into_iter().all(usable) {
        return Err(VideoError::Format(format!("has a colour correction of {correction:?}")).into());
    }
    let weights = if xyz { [0.0, 1.0, 0.0] } else { colours };
    Ok(Header { weights: [0, 1, 2].map(|i| weights[i] / correction[i]), exposure, layout })
}

/// As many numbers as are asked for, with blanks between.
fn numbers<const N: usize>(text: &str) -> Option<[f32; N]> {
    let numbers: Option<Vec<f32>> = text.split_whitespace().map(|word| word.parse().ok()).collect();
    numbers?.try_into().ok()
}

/// One line without its end.
fn read_line(content: &mut Take<&mut impl BufRead>) -> Result<String> {
    let mut line = Vec::new();
    content.read_until(b'\n', &mut line)?;
    if line.pop() != Some(b'\n') {
        let problem = match content.limit() {
            0 => format!("has a header of more than {MAX_HEADER} bytes"),
            _ => "ends within its header".into(),
        };
        return Err(VideoError::Format(problem).into());
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

    /// What programs write into headers beside a size and a format.
    #[test]
    fn headers_as_programs_write_them() {
        let first = |lines: &str, pixel| values(&format!("#?RADIANCE\n{lines}\n\n-Y 1 +X 1\n"), &[pixel])[0];
        assert_eq!(first("EXPOSURE=0", grey(129)), 1.0);
        assert_eq!(first("EXPOSURE = 2\nEXPOSURE= 0.0", grey(129)), 0.5);
        assert_eq!(first("FORMAT = 32-bit_rle_rgbe ", grey(129)), 1.0);
        assert_eq!(first(" FORMAT= 32-bit_rle_xyze\t", [1, 128, 2, 129]), 1.0);
        assert_eq!(first(&format!("pfilt -e 1 {}", "x".repeat(100_000)), grey(129)), 1.0);
        assert_eq!(first("rpict\n".repeat(5000).trim_end(), grey(129)), 1.0);
        assert_eq!(first("COLORCORR=2 2 2\nCOLORCORR= 2 2 2", grey(129)), 0.25);
        // Green of a correction, and of primaries that are those of XYZ.
        let green = [0, 128, 0, 129];
        assert_eq!(first("COLORCORR=1 0.7152 1", green), 1.0);
        assert_eq!(first("PRIMARIES= 1 0 0 1 0 0 0.25 0.25", green), 1.0);
        assert_eq!(first("PRIMARIES=1 0 0 1 0 0 0.25 0.25", [128, 0, 128, 129]), 0.0);
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
        for bad in ["EXPOSURE=-1", "EXPOSURE=inf", "COLORCORR=0 1 1", "EXPOSURE=1e30\nEXPOSURE=1e30"] {
            let error = fail(&format!("#?RADIANCE\n{bad}\n\n-Y 1 +X 1\n"), &[0; 4]);
            assert!(error.contains("exposure") || error.contains("correction"), "{bad}: {error}");
        }
        for bad in ["EXPOSURE=much", "COLORCORR=1 2", "PRIMARIES=1 2 3", "PRIMARIES=0 0 0 0 0 0 0 0"] {
            assert!(fail(&format!("#?RADIANCE\n{bad}\n\n-Y 1 +X 1\n"), &[0; 4]).contains(bad));
        }
        assert!(fail(&format!("#?RADIANCE\n{}", "x\n".repeat(2000)), &[]).contains("within its header"));
        assert!(fail(&format!("#?RADIANCE\n{}", "x\n".repeat(1 << 20)), &[]).contains("more than 1048576"));
        assert!(fail(&format!("#?RADIANCE\n{}", "x".repeat(1 << 21)), &[]).contains("more than 1048576"));
        // A run before any pixel, runs past the end, and markers whose count overflows.
        assert!(fail(&format!("{HEAD}-Y 1 +X 9\n"), &[1, 1, 1, 2]).contains("run"));
        assert!(fail(&format!("{HEAD}-Y 1 +X 2\n"), &[9, 9, 9, 9, 1, 1, 1, 2]).contains("run"));
        let zeros = [&[9, 9, 9, 9][..], &[1, 1, 1, 0].repeat(9), &[1, 1, 1, 255]].concat();
        assert!(parse(&format!("{HEAD}-Y 1 +X 2\n"), &zeros).is_err());
        assert!(fail(&format!("{HEAD}-Y 1 +X 8\n"), &[2, 2, 0, 8, 0]).contains("run"));
        assert!(fail(&format!("{HEAD}-Y 1 +X 8\n"), &[2, 2, 0, 8, 137, 1]).contains("run"));
    }
}
