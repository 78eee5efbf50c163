//! What a pane can show, and its pixels.

use serde::{Deserialize, Serialize};

use crate::frame::{Frame, Plane};
use crate::place::Part;
use crate::tone::ToneTable;
use pix2hdr::sensor::{Pattern, Schedule};

/// What a pane can show.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Picture {
    /// Pixel values as the camera delivers them.
    Mosaic,
    /// The same, each kind of pixel as a picture of its own.
    SubFrames,
    /// The box filter.
    Filtered,
    /// What the net makes of it.
    Ours,
    /// Ground truth.
    Truth,
    /// Ours less truth.
    Difference,
    /// The box filter less truth.
    FilteredDifference,
}

impl Picture {
    /// All pictures, in the order of their keys.
    pub const ALL: [Self; 7] = [
        Self::Mosaic,
        Self::Filtered,
        Self::Ours,
        Self::Truth,
        Self::SubFrames,
        Self::Difference,
        Self::FilteredDifference,
    ];

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Mosaic => "mosaic",
            Self::SubFrames => "sub-frames",
            Self::Filtered => "box filter",
            Self::Ours => "pix2hdr",
            Self::Truth => "truth",
            Self::Difference => "pix2hdr − truth",
            Self::FilteredDifference => "box − truth",
        }
    }

    /// What it is, for a tooltip.
    pub fn describe(self) -> &'static str {
        match self {
            Self::Mosaic => "pixel values as the camera delivers them, brightness as they are",
            Self::SubFrames => "the pixels of each exposure and phase as a picture of their own",
            Self::Filtered => {
                "each pixel divided by its exposure, averaged over 3×3: what the net is held against"
            }
            Self::Ours => "what the net makes of the mosaic",
            Self::Truth => "what the simulated camera looks at",
            Self::Difference => "blue: too dark, orange: too bright, in the tone curve's domain",
            Self::FilteredDifference => "the same for the box filter",
        }
    }

    /// Whether its values are pixel values instead of irradiance.
    pub fn is_raw(self) -> bool {
        matches!(self, Self::Mosaic | Self::SubFrames)
    }

    /// Whether `frame` has what it shows.
    pub fn is_there(self, frame: &Frame) -> bool {
        match self {
            Self::Mosaic | Self::SubFrames => frame.mosaic.is_some(),
            Self::Filtered => frame.filtered.is_some(),
            Self::Ours => frame.ours.is_some(),
            Self::Truth => frame.truth.is_some(),
            Self::Difference => frame.ours.is_some() && frame.truth.is_some(),
            Self::FilteredDifference => frame.filtered.is_some() && frame.truth.is_some(),
        }
    }

    /// The value at row `y`, column `x`: y, p or a difference of p.
    pub fn value(self, frame: &Frame, kinds: &Kinds, y: usize, x: usize) -> Option<f32> {
        if y >= frame.height || x >= frame.width {
            return None;
        }
        let of = |plane: &Option<Vec<f32>>, y: usize, x: usize| {
            plane.as_ref().and_then(|plane| plane.get(y * frame.width + x)).copied()
        };
        match self {
            Self::Mosaic => of(&frame.mosaic, y, x),
            Self::SubFrames => {
                let (y, x) = kinds.source(y, x, [frame.height, frame.width])?;
                of(&frame.mosaic, y, x)
            }
            Self::Filtered => of(&frame.filtered, y, x),
            Self::Ours => of(&frame.ours, y, x),
            Self::Truth => of(&frame.truth, y, x),
            Self::Difference => Some(of(&frame.ours, y, x)? - of(&frame.truth, y, x)?),
            Self::FilteredDifference => Some(of(&frame.filtered, y, x)? - of(&frame.truth, y, x)?),
        }
    }

    /// The planes that it is made of: one, or the two that are compared.
    pub(crate) fn planes(self) -> (Plane, Option<Plane>) {
        match self {
            Self::Mosaic | Self::SubFrames => (Plane::Mosaic, None),
            Self::Filtered => (Plane::Filtered, None),
            Self::Ours => (Plane::Ours, None),
            Self::Truth => (Plane::Truth, None),
            Self::Difference => (Plane::Ours, Some(Plane::Truth)),
            Self::FilteredDifference => (Plane::Filtered, Some(Plane::Truth)),
        }
    }

    /// Whether cells that were computed can be marked in it.
    pub(crate) fn shows_cells(self) -> bool {
        matches!(self, Self::Ours | Self::Difference)
    }

    /// The pixels, R, G, B, of a part of it. Where several pixels of the frame share one, it is their mean. `marked`
    /// marks cells that were computed. The twin of `shaders/picture.wgsl`, which draws panes.
    pub fn pixels(
        self,
        frame: &Frame,
        kinds: &Kinds,
        part: &Part,
        table: &ToneTable,
        marked: bool,
    ) -> Vec<u8> {
        let Part { rows, cols, stride } = part;
        let mut pixels = Vec::with_capacity(3 * part.extent()[0] * part.extent()[1]);
        // Kinds of pixels must not be mixed.
        let reach = if self.is_raw() { 1 } else { *stride };
        let mean = |plane: &[f32], y: usize, x: usize| {
            let (mut sum, mut n) = (0.0, 0.0);
            for v in y..(y + reach).min(frame.height) {
                for u in x..(x + reach).min(frame.width) {
                    sum += finite(plane[v * frame.width + u]);
                    n += 1.0;
                }
            }
            sum / n
        };
        let (first, second) = self.planes();
        let Some(plane) = frame.plane(first) else { return pixels };
        let other = match second.map(|second| frame.plane(second)) {
            Some(None) => return pixels,
            other => other.flatten(),
        };
        let computed = frame.computed.as_ref().filter(|_| marked && self.shows_cells());
        for (j, y) in rows.clone().step_by(*stride).enumerate() {
            for (i, x) in cols.clone().step_by(*stride).enumerate() {
                let mut colour = match (self, other) {
                    (Self::Mosaic, _) => table.pixel_value(mean(plane, y, x), [j, i]),
                    (Self::SubFrames, _) => match kinds.source(y, x, [frame.height, frame.width]) {
                        Some((y, x)) => table.pixel_value(finite(plane[y * frame.width + x]), [j, i]),
                        None => [0; 3],
                    },
                    (_, Some(other)) => table.difference(mean(plane, y, x), mean(other, y, x)),
                    (_, None) => table.colour(mean(plane, y, x), i, j),
                };
                if computed.is_some_and(|computed| computed.is(y, x)) {
                    for (value, mark) in colour.iter_mut().zip(COMPUTED) {
                        *value = u8::midpoint(*value, mark);
                    }
                }
                pixels.extend(colour);
            }
        }
        pixels
    }
}

/// As executors' results are read: what is not finite is black.
fn finite(value: f32) -> f32 {
    if value.is_finite() { value } else { 0.0 }
}

/// Colour of cells that were computed.
pub(crate) const COMPUTED: [u8; 3] = [230, 120, 0];

/// Most kinds of pixels that are told apart.
const MOST_KINDS: usize = 16;

/// The kinds of pixels that a pattern has, and where the nearest one of each kind is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Kinds {
    /// Words for each kind.
    pub names: Vec<String>,
    /// Sub-frames side by side.
    across: usize,
    /// Rows and columns of the pattern's tile.
    tile: [usize; 2],
    /// For each kind and place in the tile, the row and column of the nearest pixel of that kind, relative to the tile.
    nearest: Vec<Vec<[isize; 2]>>,
}

impl Default for Kinds {
    fn default() -> Self {
        Self { names: vec![String::new()], across: 1, tile: [1, 1], nearest: vec![vec![[0, 0]]] }
    }
}

impl Kinds {
    /// The kinds of `pattern`, in the order of their exposures and phases. Of patterns with very many (random codes),
    /// they are not told apart.
    pub fn new(pattern: &Pattern) -> Self {
        let mut kinds: Vec<&Schedule> = Vec::new();
        for kind in pattern.schedules() {
            if !kinds.contains(&kind) {
                kinds.push(kind);
            }
        }
        if kinds.len() > MOST_KINDS {
            return Self::default();
        }
        kinds.sort_by_key(|kind| kind.shutters().first().map(|s| (s.exposure(), s.start())));
        let (rows, cols) = (pattern.rows() as isize, pattern.cols() as isize);
        let nearest = |kind: &Schedule| -> Vec<[isize; 2]> {
            let places = || (0..rows).flat_map(|r| (0..cols).map(move |c| [r, c]));
            let others = || (-rows..2 * rows).flat_map(|r| (-cols..2 * cols).map(move |c| [r, c]));
            let is = |[r, c]: [isize; 2]| {
                *pattern.schedule(r.rem_euclid(rows) as usize, c.rem_euclid(cols) as usize) == *kind
            };
            let to = |[r, c]: [isize; 2]| {
                let distance = move |[v, u]: &[isize; 2]| (v - r).pow(2) + (u - c).pow(2);
                others().filter(|other| is(*other)).min_by_key(distance).unwrap_or([r, c])
            };
            places().map(to).collect()
        };
        let name = |kind: &Schedule| match kind.shutters() {
            [shutter] => format!("exposure {}, phase {}", shutter.exposure(), shutter.start()),
            shutters => format!("{} exposures", shutters.len()),
        };
        Self {
            names: kinds.iter().map(|kind| name(kind)).collect(),
            across: (kinds.len() as f64).sqrt().ceil() as usize,
            tile: [pattern.rows(), pattern.cols()],
            nearest: kinds.iter().map(|kind| nearest(kind)).collect(),
        }
    }

    /// The exposure and the like of the sub-frames, with the row and column where each begins.
    pub fn corners(&self, [height, width]: [usize; 2]) -> impl Iterator<Item = (&str, [usize; 2])> {
        let down = self.names.len().div_ceil(self.across);
        let place =
            move |k: usize| [k / self.across * (height / down), k % self.across * (width / self.across)];
        self.names.iter().enumerate().map(move |(k, name)| (name.as_str(), place(k)))
    }

    /// The pixel that stands at row `y`, column `x` where the sub-frames lie side by side; `None` between them.
    pub fn source(&self, y: usize, x: usize, [height, width]: [usize; 2]) -> Option<(usize, usize)> {
        let down = self.names.len().div_ceil(self.across);
        let (rows, cols) = ((height / down).max(1), (width / self.across).max(1));
        let (r, c) = (y / rows, x / cols);
        if c >= self.across {
            return None;
        }
        let nearest = self.nearest.get(r * self.across + c)?;
        // Each sub-frame is the whole picture, so much smaller.
        let (y, x) = ((y - r * rows) * down, (x - c * cols) * self.across);
        let [v, u] = nearest[y % self.tile[0] * self.tile[1] + x % self.tile[1]];
        let y = (y - y % self.tile[0]).checked_add_signed(v)?;
        let x = (x - x % self.tile[1]).checked_add_signed(u)?;
        (y < height && x < width).then_some((y, x))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tone::Display;

    fn frame(height: usize, width: usize) -> Frame {
        let plane = |scale: f32| Some((0..height * width).map(|i| scale * i as f32 / 100.0).collect());
        Frame {
            number: 0,
            height,
            width,
            mosaic: plane(1.0),
            filtered: plane(0.5),
            ours: plane(0.25),
            truth: plane(0.25),
            ..Frame::default()
        }
    }

    #[test]
    fn every_picture_has_pixels_at_every_size() {
        let kinds = Kinds::new(&Pattern::built_in("mpve-1-4").unwrap());
        let table = ToneTable::new(Display::default());
        for (height, width) in [(2, 4), (5, 7), (33, 17)] {
            let frame = frame(height, width);
            for picture in Picture::ALL {
                for stride in [1, 2, 5] {
                    let part = Part { rows: 0..height, cols: 0..width, stride };
                    let pixels = picture.pixels(&frame, &kinds, &part, &table, false);
                    assert_eq!(pixels.len(), 3 * height.div_ceil(stride) * width.div_ceil(stride));
                }
            }
            assert_eq!(Picture::Ours.value(&frame, &kinds, height, 0), None);
        }
    }

    #[test]
    fn what_is_missing_has_no_pixels() {
        let frame = Frame { truth: None, ..frame(4, 4) };
        let table = ToneTable::new(Display::default());
        let part = Part { rows: 0..4, cols: 0..4, stride: 1 };
        assert!(Picture::Truth.pixels(&frame, &Kinds::default(), &part, &table, false).is_empty());
        assert!(!Picture::Difference.is_there(&frame) && Picture::Ours.is_there(&frame));
    }

    /// Each sub-frame holds pixels of one kind alone.
    #[test]
    fn sub_frames_keep_kinds_apart() {
        for name in ["mpve-1-4", "mpve-2x2-1-4", "global", "sve"] {
            let pattern = Pattern::built_in(name).unwrap();
            let kinds = Kinds::new(&pattern);
            let (height, width) = (16, 24);
            let mut found = Vec::new();
            let down = kinds.names.len().div_ceil(kinds.across);
            for r in 0..down {
                for c in 0..kinds.across {
                    let mut kind = None;
                    for y in r * height / down..(r + 1) * height / down {
                        for x in c * width / kinds.across..(c + 1) * width / kinds.across {
                            let Some((y, x)) = kinds.source(y, x, [height, width]) else { continue };
                            let schedule = pattern.schedule(y, x).clone();
                            assert_eq!(*kind.get_or_insert(schedule.clone()), schedule, "{name} {r} {c}");
                        }
                    }
                    found.extend(kind);
                }
            }
            assert_eq!(found.len(), kinds.names.len(), "{name}");
        }
    }

    #[test]
    fn shrunken_pictures_are_means_of_irradiance() {
        let frame = Frame { ours: Some(vec![0.0, 0.2, 0.2, 0.4]), ..frame(2, 2) };
        let table = ToneTable::new(Display { dither: false, ..Display::default() });
        let part = Part { rows: 0..2, cols: 0..2, stride: 2 };
        let pixels = Picture::Ours.pixels(&frame, &Kinds::default(), &part, &table, false);
        assert_eq!(pixels, table.colour(0.2, 0, 0));
    }
}
