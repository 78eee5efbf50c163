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
use exr::meta::attribute::{
    AttributeValue, ChannelDescription, Chromaticities, Compression, LineOrder, SampleType, Text,
};
use exr::meta::header::{Header, LayerAttributes};
use exr::prelude::f16;

pub use super::writing::PlaneWriting;

use super::format::{Destination, Format, WriteVideo};
use super::pixels::{
    check_complete, check_frame, check_pixels, check_size, check_values, half_of, luminance,
    luminance_weights,
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

/// What R, G and B are where a file says nothing.
const REC_709: Chromaticities = Chromaticities {
    red: Vec2(0.64, 0.33),
    green: Vec2(0.30, 0.60),
    blue: Vec2(0.15, 0.06),
    white: Vec2(0.3127, 0.3290),
};

/// Reads a picture as a video of one frame: channel Y, else the luminance of R, G and B (Rec. 709) in the first part
/// that has them; half, float or uint, the full resolution. Chromaticities in the header give R, G and B other weights.
/// The picture is the display window, black where the file has no pixels. Every pixel must be finite and ≥ 0.
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
        .ok_or_else(|| {
            VideoError::Format(format!("has no channel Y and no channels R, G and B; {}", listed(headers)))
        })?;
    let channels = channels.weighted(&headers[part])?;
    let Vec2(width, height) = headers[part].layer_size;
    check_size(width, height)?;
    let window = Window::of(&headers[part], len)?;
    // The decoder handles blocks in which all channels have all pixels.
    if headers[part].channels.list.iter().any(|channel| channel.sampling != Vec2(1, 1)) {
        let problem = "has subsampled channels, as luminance-chroma pictures do; write its channel Y alone, or R, G and \
                       B in full size";
        return Err(VideoError::Format(problem.into()).into());
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
    Ok(window.shown(Video::new(1, height, width, plane)?)?)
}

/// Where the pixels that a file has lie in the picture that it shows.
#[derive(Debug, PartialEq)]
struct Window {
    /// Row and column of the picture at which the first pixel lies.
    place: [i64; 2],
    /// Rows and columns of the picture.
    extent: [usize; 2],
}

impl Window {
    /// That of a part of a file of `len` bytes.
    fn of(header: &Header, len: u64) -> Result<Self, VideoError> {
        let (display, data) = (header.shared_attributes.display_window, header.own_attributes.layer_position);
        let Vec2(width, height) = display.size;
        check_size(width, height)?;
        // As for what a header promises of its pixels.
        check_memory(display.size, header.channels.bytes_per_pixel, len).map_err(|bytes| {
            VideoError::Format(format!(
                "its header promises a display window of {width}×{height} pixels, too large for a file of {bytes} bytes"
            ))
        })?;
        let offset = |data: i32, display: i32| i64::from(data) - i64::from(display);
        let place = [offset(data.y(), display.position.y()), offset(data.x(), display.position.x())];
        let size = header.layer_size;
        let apart =
            |place: i64, size: usize, extent: usize| place >= extent as i64 || place + size as i64 <= 0;
        if apart(place[0], size.y(), height) || apart(place[1], size.x(), width) {
            let problem = "no pixel of its data window lies in its display window";
            return Err(VideoError::Format(problem.into()));
        }
        Ok(Self { place, extent: [height, width] })
    }

    /// The picture, black where `data` has no pixels.
    fn shown(&self, data: Video) -> Result<Video, VideoError> {
        let [height, width] = self.extent;
        if self.place == [0, 0] && self.extent == [data.height, data.width] {
            return Ok(data);
        }
        let mut plane = vec![0.0; height * width];
        let [top, left] = self.place;
        let first = left.max(0) as usize;
        let end = (left + data.width as i64).min(width as i64) as usize;
        for (y, row) in data.data.chunks(data.width).enumerate() {
            let Some(y) = usize::try_from(y as i64 + top).ok().filter(|&y| y < height) else { continue };
            let skipped = (first as i64 - left) as usize;
            plane[y * width + first..y * width + end].copy_from_slice(&row[skipped..][..end - first]);
        }
        Video::new(1, height, width, plane)
    }
}

/// The channels of all parts, as a user names them.
fn listed(headers: &[Header]) -> String {
    const MOST: usize = 24;
    let names = headers.iter().flat_map(|header| {
        let part = header.own_attributes.layer_name.as_ref();
        let part = part.filter(|_| headers.len() > 1).map_or(String::new(), |name| format!("{name}: "));
        let deep = if header.deep { " (deep)" } else { "" };
        header.channels.list.iter().map(move |channel| format!("{part}{}{deep}", channel.name))
    });
    let names: Vec<String> = names.take(MOST + 1).collect();
    let more = if names.len() > MOST { ", …" } else { "" };
    format!("there are {}{more}", names[..names.len().min(MOST)].join(", "))
}

/// Refuses pixels that need far more memory than a file of `len` bytes can fill, whatever the compression; the error is
/// `len`.
fn check_memory(Vec2(width, height): Vec2<usize>, bytes_per_pixel: usize, len: u64) -> Result<(), u64> {
    // The best that deflate can do, which no other compression of the format surpasses.
    const MOST_COMPRESSION: u64 = 1032;
    // Bytes that cost nothing: small pictures may have large tiles.
    const FREE: u64 = 64 << 20;
    let bytes = width.saturating_mul(height).saturating_mul(bytes_per_pixel) as u64;
    if bytes > len.saturating_mul(MOST_COMPRESSION).max(FREE) { Err(len) } else { Ok(()) }
}

/// Refuses a header that promises far more than `len` bytes can hold, whatever the compression.
fn check_promise(header: &Header, len: u64) -> Result<(), VideoError> {
    let block = match header.blocks {
        BlockDescription::ScanLines => Vec2(header.layer_size.x(), header.compression.scan_lines_per_block()),
        BlockDescription::Tiles(tiles) => tiles.tile_size,
    };
    let check = |size| check_memory(size, header.channels.bytes_per_pixel, len);
    check(header.layer_size).and_then(|()| check(block)).map_err(|len| {
        let (Vec2(width, height), Vec2(columns, rows)) = (header.layer_size, block);
        VideoError::Format(format!(
            "its header promises {width}×{height} pixels in blocks of {columns}×{rows}, which {len} bytes cannot hold"
        ))
    })
}

/// Which channels make the plane, by index.
enum Channels {
    Y(usize),
    /// With the weight of each.
    Rgb([usize; 3], [f32; 3]),
}

impl Channels {
    fn of(header: &Header) -> Option<Self> {
        let find = |name: &str| header.channels.list.iter().position(|channel| channel.name.eq(name));
        match find("Y") {
            Some(y) if !header.deep => Some(Self::Y(y)),
            None if !header.deep => {
                let unit = |i: usize| luminance([0, 1, 2].map(|k| f32::from(u8::from(k == i))));
                Some(Self::Rgb([find("R")?, find("G")?, find("B")?], [unit(0), unit(1), unit(2)]))
            }
            _ => None,
        }
    }

    /// With the weights that the header's chromaticities give them.
    fn weighted(self, header: &Header) -> Result<Self, VideoError> {
        match (self, header.shared_attributes.chromaticities) {
            // Those of Rec. 709 have their own rounded numbers.
            (Self::Rgb(rgb, _), Some(given)) if given != REC_709 => {
                let [r, g, b, white] =
                    [given.red, given.green, given.blue, given.white].map(|Vec2(x, y)| [x, y].map(f64::from));
                let problem =
                    || VideoError::Format(format!("has chromaticities that show no white: {given:?}"));
                Ok(Self::Rgb(rgb, luminance_weights([r, g, b], white).ok_or_else(problem)?))
            }
            (channels, _) => Ok(channels),
        }
    }

    /// Weight of a channel in the plane.
    fn weight(&self, channel: usize) -> Option<f32> {
        match self {
            Self::Y(y) => (*y == channel).then_some(1.0),
            Self::Rgb(rgb, weights) => Some(weights[rgb.iter().position(|&c| c == channel)?]),
        }
    }

    fn count(&self) -> usize {
        match self {
            Self::Y(_) => 1,
            Self::Rgb(..) => 3,
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
        assert!(error.contains("no channel Y") && error.contains("there are Z"), "{error}");
    }

    /// A file of RGB pixels [3, 4] with these attributes.
    fn with_windows(display: [i32; 4], data: [i32; 2], chromaticities: Option<Chromaticities>) -> Vec<u8> {
        let pixel = |Vec2(x, y): Vec2<usize>| (0.0_f32, (1 + y * 4 + x) as f32, 0.0_f32);
        let channels = SpecificChannels::build()
            .with_channel("R")
            .with_channel("G")
            .with_channel("B")
            .with_pixel_fn(pixel);
        let mut image = Image::from_channels((4, 3), channels);
        let [x, y, width, height] = display;
        image.attributes.display_window =
            exr::meta::attribute::IntegerBounds::new((x, y), (width as usize, height as usize));
        image.attributes.chromaticities = chromaticities;
        image.layer_data.attributes.layer_position = Vec2(data[0], data[1]);
        let mut bytes = Cursor::new(Vec::new());
        image.write().non_parallel().to_buffered(&mut bytes).unwrap();
        bytes.into_inner()
    }

    /// Pixels lie at their place in the display window: outside of the file's it is black, and what lies outside of it
    /// is not shown.
    #[test]
    fn pixels_lie_at_their_place_in_the_display_window() {
        let read = |display, data| read_plane(Cursor::new(with_windows(display, data, Some(GREEN))));
        for (display, data) in [
            ([0, 0, 4, 3], [0, 0]),
            ([7, -9, 4, 3], [7, -9]),
            ([0, 0, 8, 6], [1, 2]),
            ([0, 0, 8, 6], [-2, -1]),
            ([0, 0, 8, 6], [6, 5]),
            ([-5, 3, 2, 1], [-6, 2]),
        ] {
            let picture = read(display, data).unwrap();
            let [left, top, width, height] = display;
            assert_eq!([picture.width as i32, picture.height as i32], [width, height]);
            for (i, &value) in picture.data.iter().enumerate() {
                let (x, y) = (left + i as i32 % width - data[0], top + i as i32 / width - data[1]);
                let there = (0..4).contains(&x) && (0..3).contains(&y);
                assert_eq!(
                    value,
                    if there { (1 + y * 4 + x) as f32 } else { 0.0 },
                    "{display:?} {data:?} {i}"
                );
            }
        }
        for data in [[8, 0], [0, 6], [-4, 0], [0, -3], [1 << 20, 0]] {
            let error = read([0, 0, 8, 6], data).unwrap_err().to_string();
            assert!(error.contains("display window"), "{error}");
        }
        // Nothing that a small file cannot fill.
        assert!(read([0, 0, 1 << 14, 1 << 14], [0, 0]).unwrap_err().to_string().contains("display window"));
    }

    /// CIE XYZ: all luminance is in the second channel.
    const GREEN: Chromaticities = Chromaticities {
        red: Vec2(1.0, 0.0),
        green: Vec2(0.0, 1.0),
        blue: Vec2(0.0, 0.0),
        white: Vec2(0.25, 0.25),
    };

    #[test]
    fn chromaticities_give_luminance() {
        let first = |chromaticities| {
            read_plane(Cursor::new(with_windows([0, 0, 4, 3], [0, 0], chromaticities))).unwrap().data[0]
        };
        assert_eq!(first(None), 0.7152);
        assert_eq!(first(Some(REC_709)), 0.7152);
        assert_eq!(first(Some(GREEN)), 1.0);
        let wide = Chromaticities {
            red: Vec2(0.708, 0.292),
            green: Vec2(0.170, 0.797),
            blue: Vec2(0.131, 0.046),
            ..REC_709
        };
        assert!((first(Some(wide)) - 0.678).abs() < 1e-4);
        let none = Chromaticities { white: Vec2(0.3, 0.0), ..REC_709 };
        let error = read_plane(Cursor::new(with_windows([0, 0, 4, 3], [0, 0], Some(none)))).unwrap_err();
        assert!(error.to_string().contains("no white"), "{error}");
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
