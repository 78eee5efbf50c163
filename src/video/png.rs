//! 8-bit PNG pictures, and the tone curve that turns HDR frames into them.

use std::path::Path;

use png::{BitDepth, ColorType, Encoder, EncodingError};

use super::{ToneRange, VideoError, atomic};
use crate::{At, Error, Result};

/// Writes a grey picture [y, x].
pub fn write_grey(path: impl AsRef<Path>, pixels: &[u8], width: usize) -> Result<()> {
    write(path.as_ref(), pixels, width, ColorType::Grayscale)
}

/// Writes a colour picture [y, x], R, G, B.
pub fn write_rgb(path: impl AsRef<Path>, pixels: &[[u8; 3]], width: usize) -> Result<()> {
    write(path.as_ref(), pixels.as_flattened(), width, ColorType::Rgb)
}

/// Writes a frame [y, x] of irradiance under the tone curve.
pub fn write_toned(path: impl AsRef<Path>, frame: &[f32], width: usize) -> Result<()> {
    let pixels: Vec<u8> = frame.iter().map(|&p| tone_byte(p)).collect();
    write_grey(path, &pixels, width)
}

/// The grey value of irradiance `p`: 255·l(p), with p clipped to [0, 1].
pub fn tone_byte(p: f32) -> u8 {
    ToneRange::WHOLE.byte(p)
}

fn write(path: &Path, bytes: &[u8], width: usize, kind: ColorType) -> Result<()> {
    let row = width * kind.samples();
    let height = bytes.len() / row.max(1);
    let sizes = u32::try_from(width).ok().zip(u32::try_from(height).ok());
    let Some((w, h)) = sizes.filter(|(w, h)| *w > 0 && *h > 0 && row * height == bytes.len()) else {
        let problem = format!("{} bytes are no picture {width} pixels wide", bytes.len());
        return Err(VideoError::Shape(problem)).at(path);
    };
    let problem = |error| match error {
        EncodingError::IoError(error) => Error::from(error),
        error => VideoError::Format(error.to_string()).into(),
    };
    atomic::write(path, |content| {
        let mut encoder = Encoder::new(content, w, h);
        encoder.set_color(kind);
        encoder.set_depth(BitDepth::Eight);
        let mut writer = encoder.write_header().map_err(problem)?;
        writer.write_image_data(bytes).map_err(problem)?;
        writer.finish().map_err(problem)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::File;
    use std::io::BufReader;

    fn read(path: &Path) -> (u32, u32, ColorType, Vec<u8>) {
        let mut reader = png::Decoder::new(BufReader::new(File::open(path).unwrap())).read_info().unwrap();
        let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut pixels).unwrap();
        (info.width, info.height, info.color_type, pixels)
    }

    #[test]
    fn pictures_come_back() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a/a.png");
        write_grey(&path, &[1, 2, 3, 4, 5, 6], 2).unwrap();
        assert_eq!(read(&path), (2, 3, ColorType::Grayscale, vec![1, 2, 3, 4, 5, 6]));
        write_rgb(&path, &[[1, 2, 3], [4, 5, 6]], 2).unwrap();
        assert_eq!(read(&path), (2, 1, ColorType::Rgb, vec![1, 2, 3, 4, 5, 6]));
        write_toned(&path, &[0.0, 1.0, 7.0, f32::NAN], 4).unwrap();
        assert_eq!(read(&path).3, [0, 255, 255, 0]);
        for width in [0, 4, 7] {
            assert!(write_grey(&path, &[1, 2, 3, 4, 5, 6], width).is_err());
        }
        assert!(write_grey(&path, &[], 3).is_err());
    }

    #[test]
    fn the_tone_curve_lifts_the_shadows() {
        // l(1/5000) = ln 2/ln 5001 = 0.0814.
        assert_eq!(tone_byte(1.0 / 5000.0), 21);
        assert_eq!(tone_byte(1.0), 255);
    }
}
