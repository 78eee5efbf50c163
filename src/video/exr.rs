//! OpenEXR pictures: one monochrome plane.

use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use exr::block::lines::LineRef;
use exr::block::reader::ChunksReader;
use exr::error::Error as ExrError;
use exr::image::write::WritableImage;
use exr::image::{AnyChannel, AnyChannels, Blocks, Encoding, FlatSamples, Image, Layer};
use exr::math::Vec2;
use exr::meta::BlockDescription;
use exr::meta::attribute::{AttributeValue, ChannelDescription, Compression, LineOrder, SampleType, Text};
use exr::meta::header::{Header, LayerAttributes};
use exr::prelude::f16;

pub use super::writing::PlaneWriting;

use super::format::{Destination, Format, WriteVideo};
use super::pixels::{
    check_complete, check_frame, check_pixels, check_size, check_values, half_of, luminance,
};
use super::{Video, VideoError, check_free};
use crate::frame::Plane;
use crate::{At, Error, Result};

/// Single pictures.
pub(super) const FORMAT: Format = Format {
    name: "an .exr picture",
    endings: &["exr"],
    single: true,
    open: |path| Ok(Box::new(read(path)?)),
    begin: Some(begin),
    counts: None,
};

/// Reads a picture as a video of one frame: channel Y, else the luminance of R, G and B (Rec. 709) in the first part
/// that has them; half, float or uint, the full resolution. Every pixel must be finite and ≥ 0.
pub fn read(path: impl AsRef<Path>) -> Result<Video> {
    read_frame(path, 0)
}

/// As [`read`]; a pixel that is refused is named as one of frame `t`.
pub(super) fn read_frame(path: impl AsRef<Path>, t: usize) -> Result<Video> {
    let path = path.as_ref();
    let plane = File::open(path).at(path).and_then(|file| read_plane(BufReader::new(file)).at(path))?;
    check_pixels(&plane.data, t, plane.width).at(path)?;
    Ok(plane)
}

fn read_plane(mut content: impl Read + Seek) -> Result<Video> {
    let len = content.seek(SeekFrom::End(0))?;
    content.rewind()?;
    let reader = exr::block::read(content, false).map_err(problem)?;
    let headers = reader.headers();
    // The decoder makes room for a block of any part before it reads it.
    headers.iter().try_for_each(|header| check_promise(header, len))?;
    let (part, channels) = headers
        .iter()
        .enumerate()
        .find_map(|(part, header)| Some((part, Channels::of(header)?)))
        .ok_or_else(|| VideoError::Format("has no channel Y and no channels R, G and B".into()))?;
    let Vec2(width, height) = headers[part].layer_size;
    check_size(width, height)?;
    // The decoder handles blocks in which all channels have all pixels.
    if headers[part].channels.list.iter().any(|channel| channel.sampling != Vec2(1, 1)) {
        return Err(
            VideoError::Format("has subsampled channels; write Y or R, G and B in full size".into()).into()
        );
    }

    let chunks = reader
        .filter_chunks(false, |_, _, block| block.layer == part && block.level == Vec2(0, 0))
        .map_err(problem)?;
    // Sums over channels go on top of zeros; how often each pixel was written tells whether blocks are missing. Zeroed
    // memory costs nothing until it is used, so that a lie about the size costs nothing either.
    let mut plane = vec![0.0_f32; width * height];
    let mut writes = vec![0_u8; width * height];
    chunks
        .decompress_sequential(false, |meta, block| {
            for line in block.lines(&meta.headers[part].channels) {
                let Some(weight) = channels.weight(line.location.channel) else { continue };
                let kind = meta.headers[part].channels.list[line.location.channel].sample_type;
                let Vec2(x, y) = line.location.position;
                let end = x + line.location.sample_count;
                if y >= height || end > width {
                    return Err(ExrError::Invalid("a block outside the picture".into()));
                }
                let range = y * width + x..y * width + end;
                add_line(&line, kind, weight, &mut plane[range.clone()])?;
                for count in &mut writes[range] {
                    *count = count.saturating_add(1);
                }
            }
            Ok(())
        })
        .map_err(problem)?;
    if writes.iter().any(|&count| usize::from(count) != channels.count()) {
        return Err(VideoError::Format("is incomplete: blocks of pixels are missing".into()).into());
    }
    Ok(Video::new(1, height, width, plane)?)
}

/// Refuses a header that promises far more than `len` bytes can hold, whatever the compression.
fn check_promise(header: &Header, len: u64) -> Result<(), VideoError> {
    // The best that deflate can do, which no other compression of the format surpasses.
    const MOST_COMPRESSION: u64 = 1032;
    // Bytes that cost nothing: small pictures may have large tiles.
    const FREE: u64 = 64 << 20;
    let block = match header.blocks {
        BlockDescription::ScanLines => Vec2(header.layer_size.x(), header.compression.scan_lines_per_block()),
        BlockDescription::Tiles(tiles) => tiles.tile_size,
    };
    let bytes = |Vec2(width, height): Vec2<usize>| {
        width.saturating_mul(height).saturating_mul(header.channels.bytes_per_pixel) as u64
    };
    if bytes(header.layer_size).max(bytes(block)) > len.saturating_mul(MOST_COMPRESSION).max(FREE) {
        let (Vec2(width, height), Vec2(columns, rows)) = (header.layer_size, block);
        return Err(VideoError::Format(format!(
            "its header promises {width}×{height} pixels in blocks of {columns}×{rows}, which {len} bytes cannot hold"
        )));
    }
    Ok(())
}

/// Which channels make the plane, by index.
enum Channels {
    Y(usize),
    Rgb([usize; 3]),
}

impl Channels {
    fn of(header: &Header) -> Option<Self> {
        let find = |name: &str| header.channels.list.iter().position(|channel| channel.name.eq(name));
        match find("Y") {
            Some(y) if !header.deep => Some(Self::Y(y)),
            None if !header.deep => Some(Self::Rgb([find("R")?, find("G")?, find("B")?])),
            _ => None,
        }
    }

    /// Weight of a channel in the plane.
    fn weight(&self, channel: usize) -> Option<f32> {
        match self {
            Self::Y(y) => (*y == channel).then_some(1.0),
            Self::Rgb(rgb) => {
                let mut unit = [0.0; 3];
                unit[rgb.iter().position(|&c| c == channel)?] = 1.0;
                Some(luminance(unit))
            }
        }
    }

    fn count(&self) -> usize {
        match self {
            Self::Y(_) => 1,
            Self::Rgb(_) => 3,
        }
    }
}

/// Adds a line of samples to a row of the plane.
fn add_line(line: &LineRef<'_>, kind: SampleType, weight: f32, row: &mut [f32]) -> Result<(), ExrError> {
    match kind {
        SampleType::F16 => add_samples(line.read_samples(), f16::to_f32, weight, row),
        SampleType::F32 => add_samples(line.read_samples(), |v: f32| v, weight, row),
        SampleType::U32 => add_samples(line.read_samples(), |v: u32| v as f32, weight, row),
    }
}

fn add_samples<T>(
    samples: impl Iterator<Item = Result<T, ExrError>>,
    value: impl Fn(T) -> f32,
    weight: f32,
    row: &mut [f32],
) -> Result<(), ExrError> {
    for (pixel, sample) in row.iter_mut().zip(samples) {
        *pixel += weight * value(sample?);
    }
    Ok(())
}

fn problem(error: ExrError) -> Error {
    match error {
        ExrError::Io(error) => error.into(),
        error => VideoError::Format(format!("not a usable OpenEXR file: {error}")).into(),
    }
}

/// A video of one frame, which is written at once when it is complete.
struct PictureWriter {
    path: PathBuf,
    extents: [usize; 3],
    how: PlaneWriting,
    frame: Option<Vec<f32>>,
}

fn begin(path: &Path, to: Destination<'_>) -> Result<Box<dyn WriteVideo>> {
    if to.extents[0] != 1 {
        let problem = "one .exr file holds one frame; name a folder or a .npy file";
        return Err(Error::Usage(problem.into())).at(path);
    }
    check_free(path, to.how.overwrite)?;
    let Destination { extents, how, .. } = to;
    Ok(Box::new(PictureWriter { path: path.to_owned(), extents, how: how.plane(), frame: None }))
}

impl WriteVideo for PictureWriter {
    fn pushed(&self) -> usize {
        usize::from(self.frame.is_some())
    }

    fn push(&mut self, frame: Plane<'_>) -> Result<()> {
        check_frame(frame, self.pushed(), self.extents).at(&self.path)?;
        self.frame = Some(frame.values().to_vec());
        Ok(())
    }

    fn finish(self: Box<Self>) -> Result<()> {
        check_complete(self.pushed(), self.extents[0]).at(&self.path)?;
        write(&self.path, &self.frame.unwrap_or_default(), self.extents[2], self.how)
    }

    fn suspend(self: Box<Self>) -> Result<usize> {
        Ok(0)
    }
}

/// Writes one plane [y, x] as channel Y.
pub fn write(path: impl AsRef<Path>, plane: &[f32], width: usize, how: PlaneWriting) -> Result<()> {
    let path = path.as_ref();
    let height = plane.len() / width.max(1);
    check_values(plane, 0, [1, height, width]).and_then(|()| check_size(width, height)).at(path)?;
    let image = image(plane, width, height, how);
    super::atomic::write(path, |content| image.write().non_parallel().to_buffered(content).map_err(problem))
}

fn image(
    plane: &[f32],
    width: usize,
    height: usize,
    how: PlaneWriting,
) -> Image<Layer<AnyChannels<FlatSamples>>> {
    let (kind, samples) = if how.half {
        (SampleType::F16, FlatSamples::F16(plane.iter().map(|&v| half_of(v)).collect()))
    } else {
        (SampleType::F32, FlatSamples::F32(plane.to_vec()))
    };
    let channel = ChannelDescription::named("Y", kind);
    let channels = AnyChannels::sort(
        [AnyChannel {
            name: channel.name,
            sample_data: samples,
            quantize_linearly: channel.quantize_linearly,
            sampling: channel.sampling,
        }]
        .into_iter()
        .collect(),
    );
    let mut attributes = LayerAttributes::default();
    // A rational number of frames per million seconds is exact for every period in whole microseconds.
    let micros = how.frame_period_ms.map(|ms| (ms * 1e3).round());
    if let Some(micros) = micros.filter(|micros| (1.0..=f64::from(u32::MAX)).contains(micros)) {
        attributes.frames_per_second = Some((1_000_000, micros as u32));
    }
    if let Some(anchor) = how.anchor {
        attributes.other.insert(Text::new_or_panic("anchor"), AttributeValue::F32(anchor));
    }
    let encoding = Encoding {
        compression: Compression::ZIP16,
        blocks: Blocks::ScanLines,
        line_order: LineOrder::Increasing,
    };
    Image::from_layer(Layer::new((width, height), attributes, encoding, channels))
}

#[cfg(test)]
mod tests {
    use super::*;
    use exr::image::SpecificChannels;
    use exr::prelude::MetaData;
    use std::fs;
    use std::io::Cursor;

    const HALF: PlaneWriting = PlaneWriting { half: true, frame_period_ms: Some(1.0), anchor: Some(0.5) };
    const FLOAT: PlaneWriting = PlaneWriting { half: false, ..HALF };

    fn ramp(width: usize, height: usize) -> Vec<f32> {
        (0..width * height).map(|i| i as f32 / 16.0).collect()
    }

    fn folder() -> tempfile::TempDir {
        tempfile::tempdir().unwrap()
    }

    #[test]
    fn planes_round_trip_with_attributes() {
        let folder = folder();
        let path = folder.path().join("a.exr");
        for how in [HALF, FLOAT] {
            write(&path, &ramp(21, 35), 21, how).unwrap();
            assert_eq!(read(&path).unwrap(), Video::new(1, 35, 21, ramp(21, 35)).unwrap());
            let meta = MetaData::read_from_file(&path, true).unwrap();
            let attributes = &meta.headers[0].own_attributes;
            assert_eq!(attributes.frames_per_second, Some((1_000_000, 1000)));
            assert_eq!(attributes.other[&Text::new_or_panic("anchor")], AttributeValue::F32(0.5));
        }
    }

    #[test]
    fn half_clamps_instead_of_overflowing() {
        let folder = folder();
        let path = folder.path().join("a.exr");
        write(&path, &[1e6, 1.0], 2, HALF).unwrap();
        assert_eq!(read(&path).unwrap().data, [65504.0, 1.0]);
    }

    #[test]
    fn colours_become_luminance_at_every_compression() {
        let folder = folder();
        let path = folder.path().join("a.exr");
        let compressions = [
            Compression::Uncompressed,
            Compression::RLE,
            Compression::ZIP1,
            Compression::ZIP16,
            Compression::PIZ,
            Compression::PXR24,
            Compression::B44,
            Compression::B44A,
        ];
        for compression in compressions {
            for blocks in [Blocks::ScanLines, Blocks::Tiles(Vec2(16, 8))] {
                let channels = SpecificChannels::rgb(|_: Vec2<usize>| (0.25_f32, f16::from_f32(0.5), 2_u32));
                let encoding = Encoding { compression, blocks, line_order: LineOrder::Increasing };
                let layer = Layer::new((37, 19), LayerAttributes::default(), encoding, channels);
                Image::from_layer(layer).write().to_file(&path).unwrap();
                let video = read(&path).unwrap();
                assert_eq!((video.height, video.width), (19, 37));
                let expected = 0.2126 * 0.25 + 0.7152 * 0.5 + 0.0722 * 2.0;
                assert!(video.data.iter().all(|v| (v - expected).abs() < 1e-6), "{compression:?}");
            }
        }
    }

    #[test]
    fn other_channels_are_refused() {
        let folder = folder();
        let path = folder.path().join("a.exr");
        let channels = SpecificChannels::build().with_channel("Z").with_pixel_fn(|_: Vec2<usize>| (0.5_f32,));
        Image::from_channels((4, 4), channels).write().to_file(&path).unwrap();
        let error = read(&path).unwrap_err().to_string();
        assert!(error.contains("a.exr") && error.contains("no channel Y"), "{error}");
    }

    #[test]
    fn unusable_pixels_are_named() {
        let folder = folder();
        let path = folder.path().join("a.exr");
        for bad in [f32::NAN, f32::INFINITY, -0.5] {
            let pixel = move |Vec2(x, y): Vec2<usize>| (if (x, y) == (2, 3) { bad } else { 0.5 },);
            let channels = SpecificChannels::build().with_channel("Y").with_pixel_fn(pixel);
            Image::from_channels((4, 5), channels).write().to_file(&path).unwrap();
            let error = read(&path).unwrap_err().to_string();
            assert!(error.contains("frame 0, row 3, column 2"), "{error}");
        }
        assert!(write(&path, &[f32::NAN], 1, HALF).is_err());
        assert!(write(&path, &[], 1, HALF).is_err());
        assert!(write(&path, &[1.0; 3], 2, HALF).is_err());
        assert!(write(&path, &[1.0; 3], 0, HALF).is_err());
    }

    #[test]
    fn every_truncation_is_refused() {
        let folder = folder();
        let path = folder.path().join("a.exr");
        write(&path, &ramp(9, 40), 9, HALF).unwrap();
        let whole = fs::read(&path).unwrap();
        for length in 0..whole.len() {
            fs::write(&path, &whole[..length]).unwrap();
            assert!(read(&path).is_err(), "{length} of {} bytes", whole.len());
        }
    }

    /// Whatever a byte is changed to, reading ends in a result.
    #[test]
    fn no_changed_byte_panics() {
        let folder = folder();
        let path = folder.path().join("a.exr");
        write(&path, &ramp(9, 20), 9, HALF).unwrap();
        let whole = fs::read(&path).unwrap();
        for at in 0..whole.len() {
            for change in [0x80, 0xff] {
                let mut bytes = whole.clone();
                bytes[at] ^= change;
                if let Ok(video) = read_plane(Cursor::new(bytes)) {
                    assert_eq!(video.data.len(), video.height * video.width);
                }
            }
        }
    }
}
