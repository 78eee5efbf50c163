//! Dead and hot pixels and missing read-outs: masked, and filled before anything else sees them.
//!
//! A net smears a wrong value over its whole receptive field. So a pixel without a value gets that of pixels with the
//! same shutters, which integrate at the same time: the nearest ones that have a value, weighted by 1/distance².
//! Where there are none near by, as in a frame that was dropped, it keeps the last value that it had.

use std::path::Path;

use super::{Pattern, SensorError};
use crate::{At, Result};

/// Neighbours that a value is made of.
const NEIGHBOURS: usize = 4;
/// How far neighbours may be, in pattern tiles.
const TILES: i64 = 3;
/// Places that are looked at for neighbours that have a value.
const PLACES: usize = 16 * NEIGHBOURS;

/// Which values of a recording are none, and where others are taken from.
#[derive(Clone, Debug, PartialEq)]
pub struct Defects {
    /// Whether a pixel [y, x] never has a value.
    dead: Vec<bool>,
    /// The count that stands for a missing read-out.
    missing: Option<u16>,
    /// For each pixel of the pattern tile, places with the same shutters, the nearest first.
    alike: Vec<Vec<Neighbour>>,
    rows: usize,
    cols: usize,
    height: usize,
    width: usize,
}

/// A place relative to a pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Neighbour {
    dy: i64,
    dx: i64,
    /// 1/distance².
    weight: f32,
}

impl Defects {
    /// Defects of frames of [rows, columns]: pixels (row, column) without a value, and the count of a missing read-out.
    pub fn new(
        pattern: &Pattern,
        [height, width]: [usize; 2],
        pixels: &[[usize; 2]],
        missing: Option<u16>,
    ) -> Result<Self, SensorError> {
        let mut dead = vec![false; height * width];
        for &[y, x] in pixels {
            if y >= height || x >= width {
                let problem = format!("dead pixel ({y}, {x}) is outside of its {height}×{width} pixels");
                return Err(SensorError::Capture(problem));
            }
            dead[y * width + x] = true;
        }
        let count = dead.iter().filter(|dead| **dead).count();
        if 2 * count > dead.len() {
            return Err(SensorError::Capture(format!("{count} of its {} pixels are dead", dead.len())));
        }
        let (rows, cols) = (pattern.rows(), pattern.cols());
        Ok(Self { dead, missing, alike: alike(pattern), rows, cols, height, width })
    }

    /// Reads a list of pixels: a row and a column a line, with a comma or blanks between. A first line of words is a
    /// heading, which says what is which (`row,column` or `x,y`); lines that begin with # are comments.
    pub fn read_pixels(path: impl AsRef<Path>) -> Result<Vec<[usize; 2]>> {
        let path = path.as_ref();
        Self::parse_pixels(&super::text::read_text(path).at(path)?).at(path)
    }

    fn parse_pixels(text: &str) -> Result<Vec<[usize; 2]>, SensorError> {
        let mut pixels = Vec::new();
        let (mut begun, mut column_first) = (false, false);
        let lines = text.lines().map(str::trim).enumerate();
        for (index, line) in lines.filter(|(_, line)| !line.is_empty() && !line.starts_with('#')) {
            let fields = line.split([',', ';', '\t', ' ']).filter(|field| !field.is_empty());
            let fields: Vec<&str> = fields.map(|field| field.trim_matches('"')).collect();
            let numbers: Option<Vec<usize>> = fields.iter().map(|field| field.parse().ok()).collect();
            let is_first = !std::mem::replace(&mut begun, true);
            match numbers.as_deref() {
                Some(&[column, row]) if column_first => pixels.push([row, column]),
                Some(&[row, column]) => pixels.push([row, column]),
                None if is_first && !line.starts_with(|c: char| c.is_ascii_digit() || c == '-') => {
                    column_first = heading_begins_with_column(&fields).ok_or_else(|| {
                        let problem =
                            format!("the heading '{line}' names no row and column; write row,column or x,y");
                        SensorError::Capture(format!("line {}: {problem}", index + 1))
                    })?;
                }
                _ => {
                    let problem = format!("line {}: '{line}' is not a row and a column", index + 1);
                    return Err(SensorError::Capture(problem));
                }
            }
        }
        Ok(pixels)
    }

    /// Whether each pixel [y, x] never has a value.
    pub fn dead(&self) -> &[bool] {
        &self.dead
    }

    /// Whether a pixel with this count has no value: it is dead, or the count stands for a missing read-out.
    pub(super) fn is_none(&self, pixel: usize, count: f64) -> bool {
        self.dead[pixel] || self.missing.map(f64::from) == Some(count)
    }

    /// Replaces the values [y, x] of a frame that are none. `counts` are those that they were made of, and `before` the
    /// values of the frame before, filled; dark if there is none.
    pub(super) fn fill<C: Copy + Into<f64>>(&self, counts: &[C], values: &mut [f32], before: Option<&[f32]>) {
        let is_none = |pixel: usize| self.is_none(pixel, counts[pixel].into());
        let none: Vec<usize> = (0..values.len()).filter(|&pixel| is_none(pixel)).collect();
        for &pixel in &none {
            let (y, x) = (pixel / self.width, pixel % self.width);
            let place = |neighbour: &Neighbour| {
                let row = usize::try_from(y as i64 + neighbour.dy).ok().filter(|row| *row < self.height)?;
                let col = usize::try_from(x as i64 + neighbour.dx).ok().filter(|col| *col < self.width)?;
                Some((row * self.width + col, neighbour.weight)).filter(|(pixel, _)| !is_none(*pixel))
            };
            let near = self.alike[y % self.rows * self.cols + x % self.cols].iter().filter_map(place);
            // Values that are none are not read, so that filling some does not change others.
            let (sum, weights) = near
                .take(NEIGHBOURS)
                .fold((0.0, 0.0), |(sum, weights), (pixel, w)| (sum + w * values[pixel], weights + w));
            values[pixel] =
                if weights > 0.0 { sum / weights } else { before.map_or(0.0, |before| before[pixel]) };
        }
    }
}

/// For each pixel of the pattern tile, the places near it of pixels with the same shutters.
fn alike(pattern: &Pattern) -> Vec<Vec<Neighbour>> {
    let (rows, cols) = (pattern.rows() as i64, pattern.cols() as i64);
    // Pixels with the same shutters, by the first of them.
    let schedules = pattern.schedules();
    let kind: Vec<usize> = (0..schedules.len())
        .map(|i| schedules[..i].iter().position(|other| *other == schedules[i]).unwrap_or(i))
        .collect();
    let mut members = vec![Vec::new(); kind.len()];
    for (j, &first) in kind.iter().enumerate() {
        members[first].push((j as i64 / cols, j as i64 % cols));
    }
    let of = |i: usize| {
        let (y, x) = (i as i64 / cols, i as i64 % cols);
        let members = &members[kind[i]];
        // So many places lie within this distance many times over; tiles of thousands of pixels need no more of them.
        let reach = (PLACES * kind.len()).div_ceil(members.len()).isqrt() as i64;
        let [tiles_y, tiles_x] = [rows, cols].map(|size| (reach / size + 1).min(TILES));
        let mut places = Vec::new();
        for (ty, tx) in (-tiles_y..=tiles_y).flat_map(|ty| (-tiles_x..=tiles_x).map(move |tx| (ty, tx))) {
            for (member_y, member_x) in members {
                let (dy, dx) = (member_y + ty * rows - y, member_x + tx * cols - x);
                if (dy, dx) != (0, 0) && dy.abs().max(dx.abs()) <= reach {
                    places.push(Neighbour { dy, dx, weight: 1.0 / (dy * dy + dx * dx) as f32 });
                }
            }
        }
        // In one order for all time: by distance, then by place.
        places.sort_by_key(|place| (place.dy * place.dy + place.dx * place.dx, place.dy, place.dx));
        places.truncate(PLACES);
        places
    };
    (0..kind.len()).map(of).collect()
}

/// Whether a heading of two fields names the column first; nothing if it does not name a row and a column.
fn heading_begins_with_column(fields: &[&str]) -> Option<bool> {
    let is_column = |field: &&str| match field.to_lowercase().as_str() {
        "x" | "col" | "column" => Some(true),
        "y" | "row" => Some(false),
        _ => None,
    };
    match fields.iter().map(is_column).collect::<Option<Vec<_>>>()?[..] {
        [first, second] if first != second => Some(first),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use serde_json::Map;

    use super::super::{Capture, CaptureFile, Form, Noise, Pattern, Sampler, Schedule, Timing};
    use crate::frame::Frame;
    use crate::video::Counts;
    use crate::video::Video;

    /// A ramp along x that brightens with time.
    fn capture(timing: Timing) -> Capture {
        let pixel = |i: usize| 0.1 + 0.005 * (i % 24) as f32 + 0.002 * (i / 384) as f32;
        let video = Video::new(20, 16, 24, (0..20 * 384).map(pixel).collect()).unwrap();
        let mut sampler = Sampler::new(Pattern::built_in("mpve-1-4").unwrap(), Form::Linear).unwrap();
        (sampler.noise, sampler.timing, sampler.bit_depth) = (Noise::NONE, timing, 16);
        sampler.sample(&video).unwrap()
    }

    fn all(capture: &Capture) -> Vec<Vec<f32>> {
        let mut source = capture.frames();
        std::iter::from_fn(|| source.next().unwrap()).map(Frame::into_values).collect()
    }

    fn with(sound: &Capture, pixels: &[[usize; 2]], missing: Option<u16>) -> Capture {
        let mut capture = sound.clone();
        capture.info.dead_pixels = pixels.to_vec();
        capture.info.missing_count = missing;
        capture
    }

    fn set(capture: &mut Capture, places: impl Iterator<Item = usize>, value: u16) {
        let Counts::U16(counts) = &mut capture.counts else { panic!("16 bits") };
        places.for_each(|i| counts[i] = value);
    }

    /// Hot and dead pixels, alone and in a row, come close to what they would have shown, and change no others.
    #[test]
    fn dead_pixels_are_filled_from_pixels_of_the_same_shutter() {
        for timing in [Timing::Covering, Timing::Hold] {
            let sound = capture(timing);
            let expected = all(&sound);
            // The last three have the same shutters, so that they are neighbours in the sense of the filling.
            let pixels = [[0, 0], [7, 12], [8, 11], [15, 23], [7, 11], [9, 11], [7, 7]];
            let mut broken = with(&sound, &pixels, None);
            for (i, &[y, x]) in pixels.iter().enumerate() {
                set(&mut broken, (0..20).map(|t| t * 384 + y * 24 + x), if i % 2 == 0 { 65535 } else { 0 });
            }
            for (t, (filled, expected)) in all(&broken).iter().zip(&expected).enumerate() {
                for (i, (value, wanted)) in filled.iter().zip(expected).enumerate() {
                    let dead = pixels.contains(&[i / 24, i % 24]);
                    // Neighbours are up to 4 columns away, which is 0.02 of irradiance in up to 8 frames.
                    let allowed = if dead { 0.09 } else { 0.0 };
                    assert!(
                        (value - wanted).abs() <= allowed,
                        "{timing:?}, frame {t}, pixel {i}: {value} for {wanted}"
                    );
                }
            }
        }
    }

    /// Missing read-outs are filled, and a frame without any keeps the values of the one before.
    #[test]
    fn missing_readouts_are_filled() {
        let sound = capture(Timing::Covering);
        let expected = all(&sound);
        let mut broken = with(&sound, &[], Some(65535));
        set(&mut broken, (0..10 * 384).step_by(53), 65535);
        set(&mut broken, 12 * 384..13 * 384, 65535);
        let filled = all(&broken);
        for t in 0..20 {
            let expected = &expected[if t == 12 { 11 } else { t }];
            for (value, wanted) in filled[t].iter().zip(expected) {
                assert!((value - wanted).abs() < 0.09, "frame {t}: {value} for {wanted}");
            }
        }
        assert!(filled[12] == filled[11], "a frame that is missing");
        // A file gives the same, frame by frame.
        let folder = tempfile::tempdir().unwrap();
        broken.write(folder.path()).unwrap();
        let mut source = CaptureFile::open(folder.path(), &Map::new()).unwrap().into_frames();
        for filled in &filled {
            assert!(source.next().unwrap().unwrap().values() == filled);
        }
    }

    /// Every built-in pattern has neighbours for every pixel of a small frame.
    #[test]
    fn all_patterns_have_neighbours() {
        for name in Pattern::NAMES {
            let pattern = Pattern::built_in(name).unwrap();
            let extent = [4 * pattern.rows(), 4 * pattern.cols()];
            for pixel in 0..extent[0] * extent[1] {
                let place = [pixel / extent[1], pixel % extent[1]];
                let defects = super::Defects::new(&pattern, extent, &[place], None).unwrap();
                let counts = vec![7u16; extent[0] * extent[1]];
                let mut values = vec![0.5; counts.len()];
                values[pixel] = 0.0;
                defects.fill(&counts, &mut values, None);
                assert_eq!(values[pixel], 0.5, "{name}, {place:?}");
            }
        }
    }

    /// The largest pattern tiles that there may be, of pixels that are alike or not: soon, and never another shutter's value.
    #[test]
    fn large_tiles_have_neighbours() {
        for (rows, cols) in [(64, 64), (1, 4096), (4096, 1)] {
            for kinds in [1, 2, 255] {
                // The read-outs of kind k: exposure 2^n at phase k − (2^n − 1).
                let schedule = |i: usize| {
                    let exposure = (i % kinds + 1).next_power_of_two();
                    Schedule::periodic(exposure, i % kinds).unwrap()
                };
                let schedules = (0..4096).map(schedule).collect();
                let pattern = Pattern::new("large", [rows, cols], schedules).unwrap();
                for (i, places) in super::alike(&pattern).iter().enumerate() {
                    assert!(!places.is_empty(), "{rows}×{cols}, {kinds} kinds: pixel {i} has none");
                    for place in places {
                        let y = (i / cols) as i64 + place.dy;
                        let x = (i % cols) as i64 + place.dx;
                        let [y, x] = [y.rem_euclid(rows as i64), x.rem_euclid(cols as i64)];
                        assert!(pattern.schedule(y as usize, x as usize) == &pattern.schedules()[i]);
                    }
                }
            }
        }
    }

    #[test]
    fn lists_of_pixels_are_read() {
        let parse = |text: &str| super::Defects::parse_pixels(text);
        let pixels = parse("row,column\n# hot\n3, 4\n5\t6\n\n7 8\n").unwrap();
        assert_eq!(pixels, [[3, 4], [5, 6], [7, 8]]);
        for heading in ["x,y", "X;Y", "\"x\", \"y\"", "column row", "col\tROW"] {
            assert_eq!(parse(&format!("# hot\n{heading}\n3, 4\n")).unwrap(), [[4, 3]], "{heading}");
        }
        for heading in ["y,x", "Row,Col"] {
            assert_eq!(parse(&format!("{heading}\n3, 4\n")).unwrap(), [[3, 4]], "{heading}");
        }
        for heading in ["a,b", "x,column", "row", "id,x,y", "x,y\nx,y"] {
            let error = parse(&format!("{heading}\n3, 4\n")).unwrap_err().to_string();
            assert!(error.contains("line"), "{error}");
        }
        for bad in ["1,2\nwhat\n", "1\n", "1,2,3\n", "-1,2\n", "1.5,2\n"] {
            let error = parse(bad).unwrap_err().to_string();
            assert!(error.contains("line"), "{error}");
        }
    }

    #[test]
    fn pixels_that_cannot_be_are_refused() {
        let pattern = Pattern::built_in("mpve-1-4").unwrap();
        let error = |pixels: &[[usize; 2]]| {
            super::Defects::new(&pattern, [2, 4], pixels, None).unwrap_err().to_string()
        };
        assert!(error(&[[2, 0]]).contains("(2, 0)"));
        assert!(error(&[[0, 0], [0, 1], [0, 2], [0, 3], [1, 1]]).contains("5 of its 8"));
    }
}
