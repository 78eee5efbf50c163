//! A colour picture to draw on.

use std::path::Path;

use font8x8::{BASIC_FONTS, GREEK_FONTS, LATIN_FONTS, UnicodeFonts};

use crate::Result;
use crate::video::{MAX_PIXELS, VideoError, png};

/// R, G, B.
pub type Colour = [u8; 3];

pub(super) const WHITE: Colour = [255; 3];
pub(super) const BLACK: Colour = [0; 3];
pub(super) const INK: Colour = [40; 3];
pub(super) const RULE: Colour = [222; 3];

/// Width and height of a character at scale 1.
const GLYPH: usize = 8;

/// What plots draw on: pixels, or the elements of a vector picture. Coordinates are in pixels from the top left corner.
pub trait Surface {
    /// Fills `width`×`height` pixels from (x, y).
    fn fill(&mut self, x: i64, y: i64, width: usize, height: usize, colour: Colour);
    /// A smooth line of the given thickness between two points (pixel centres are at .5). Nothing if a coordinate is
    /// not finite.
    fn line(&mut self, from: (f32, f32), to: (f32, f32), thickness: f32, colour: Colour);
    /// Text with its top left corner at (x, y); characters are 8×8 pixels times `scale`.
    fn text(&mut self, x: i64, y: i64, text: &str, scale: usize, colour: Colour);
}

/// A colour picture; whatever is drawn outside of it is cut off.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Canvas {
    width: usize,
    height: usize,
    pixels: Vec<Colour>,
}

impl Canvas {
    /// A picture of one colour; an error if there are no or too many pixels.
    pub fn new(width: usize, height: usize, colour: Colour) -> Result<Self, VideoError> {
        match width.checked_mul(height) {
            Some(len @ 1..=MAX_PIXELS) => Ok(Self { width, height, pixels: vec![colour; len] }),
            _ => Err(VideoError::Shape(format!("a picture of {width}×{height} pixels cannot be drawn"))),
        }
    }

    /// Columns.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// The pixels [y, x].
    pub fn pixels(&self) -> &[Colour] {
        &self.pixels
    }

    /// Writes the picture as PNG.
    pub fn write(&self, path: impl AsRef<Path>) -> Result<()> {
        png::write_rgb(path, &self.pixels, self.width)
    }

    /// Mixes `share` of `colour` into a pixel.
    fn mix(&mut self, x: i64, y: i64, colour: Colour, share: f32) {
        let inside = (0..self.width as i64).contains(&x) && (0..self.height as i64).contains(&y);
        if inside {
            let pixel = &mut self.pixels[y as usize * self.width + x as usize];
            for (old, new) in pixel.iter_mut().zip(colour) {
                *old = (f32::from(*old) + share * (f32::from(new) - f32::from(*old))).round() as u8;
            }
        }
    }

    /// A grey picture [y, x] with its top left corner at (x, y); each of its pixels becomes `zoom`×`zoom`.
    pub fn grey(&mut self, x: i64, y: i64, pixels: &[u8], width: usize, zoom: usize) {
        for (row, line) in pixels.chunks(width.max(1)).enumerate() {
            for (column, &value) in line.iter().enumerate() {
                let (x, y) = (x + (column * zoom) as i64, y + (row * zoom) as i64);
                self.fill(x, y, zoom, zoom, [value; 3]);
            }
        }
    }
}

impl Surface for Canvas {
    fn fill(&mut self, x: i64, y: i64, width: usize, height: usize, colour: Colour) {
        let clip = |from: i64, len: usize, limit: usize| {
            let end = from.saturating_add_unsigned(len as u64).clamp(0, limit as i64);
            from.clamp(0, limit as i64) as usize..end as usize
        };
        let columns = clip(x, width, self.width);
        for row in clip(y, height, self.height) {
            self.pixels[row * self.width..][columns.clone()].fill(colour);
        }
    }

    fn line(&mut self, from: (f32, f32), to: (f32, f32), thickness: f32, colour: Colour) {
        let ((x0, y0), (x1, y1)) = (from, to);
        if ![x0, y0, x1, y1, thickness].iter().all(|v| v.is_finite()) {
            return;
        }
        let reach = thickness / 2.0 + 1.0;
        let span = |a: f32, b: f32, limit: usize| {
            let (low, high) = (a.min(b) - reach, a.max(b) + reach);
            low.clamp(0.0, limit as f32) as i64..high.clamp(0.0, limit as f32).ceil() as i64
        };
        let (dx, dy) = (x1 - x0, y1 - y0);
        let length_squared = dx * dx + dy * dy;
        for y in span(y0, y1, self.height) {
            for x in span(x0, x1, self.width) {
                let (px, py) = (x as f32 + 0.5 - x0, y as f32 + 0.5 - y0);
                let along = if length_squared > 0.0 { (px * dx + py * dy) / length_squared } else { 0.0 };
                let along = along.clamp(0.0, 1.0);
                let distance = (px - along * dx).hypot(py - along * dy);
                let share = (thickness / 2.0 + 0.5 - distance).clamp(0.0, 1.0);
                if share > 0.0 {
                    self.mix(x, y, colour, share);
                }
            }
        }
    }

    fn text(&mut self, x: i64, y: i64, text: &str, scale: usize, colour: Colour) {
        for (i, character) in text.chars().enumerate() {
            let left = x + (i * GLYPH * scale) as i64;
            for (row, bits) in glyph(character).into_iter().enumerate() {
                for column in (0..GLYPH).filter(|column| bits >> column & 1 == 1) {
                    let (x, y) = (left + (column * scale) as i64, y + (row * scale) as i64);
                    self.fill(x, y, scale, scale, colour);
                }
            }
        }
    }
}

/// Width of a text in pixels.
pub(super) fn text_width(text: &str, scale: usize) -> usize {
    text.chars().count() * GLYPH * scale
}

/// Height of a text in pixels.
pub(super) fn text_height(scale: usize) -> usize {
    GLYPH * scale
}

/// Eight rows, the leftmost pixel in the lowest bit; a question mark for what the font lacks.
fn glyph(character: char) -> [u8; 8] {
    let character = match character {
        '−' | '–' | '—' => '-',
        'μ' => 'µ',
        '’' => '\'',
        other => other,
    };
    let found = BASIC_FONTS
        .get(character)
        .or_else(|| LATIN_FONTS.get(character))
        .or_else(|| GREEK_FONTS.get(character))
        .or_else(|| BASIC_FONTS.get('?'));
    found.unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn drawing_outside_is_cut_off() {
        let mut canvas = Canvas::new(8, 6, WHITE).unwrap();
        canvas.fill(-3, -3, 4, 4, BLACK);
        canvas.fill(i64::MAX, i64::MIN, usize::MAX, usize::MAX, BLACK);
        canvas.text(-4, 3, "A\u{1f600}", 3, BLACK);
        canvas.grey(6, 4, &[0; 9], 3, 2);
        canvas.line((-1e30, 3.0), (1e30, 3.0), 1.0, BLACK);
        canvas.line((f32::NAN, 3.0), (1.0, f32::INFINITY), 1.0, BLACK);
        assert_eq!(canvas.pixels()[0], BLACK);
        assert_eq!(canvas.pixels()[7], WHITE);
        assert_eq!(canvas.pixels()[5 * 8 + 7], BLACK);
    }

    #[test]
    fn lines_cover_pixels_by_their_area() {
        let mut canvas = Canvas::new(5, 5, WHITE).unwrap();
        canvas.line((0.0, 2.5), (5.0, 2.5), 1.0, BLACK);
        assert_eq!(canvas.pixels()[2 * 5 + 2], BLACK);
        assert_eq!(canvas.pixels()[5 + 2], WHITE);
        let mut canvas = Canvas::new(5, 5, WHITE).unwrap();
        canvas.line((0.0, 2.0), (5.0, 2.0), 1.0, BLACK);
        assert_eq!(canvas.pixels()[5 + 2], [128; 3]);
        assert_eq!(canvas.pixels()[2 * 5 + 2], [128; 3]);
    }

    #[test]
    fn letters_read_from_left_to_right() {
        let mut canvas = Canvas::new(8, 8, WHITE).unwrap();
        canvas.text(0, 0, "L", 1, BLACK);
        let column = |x: usize| (0..8).filter(|y| canvas.pixels()[y * 8 + x] == BLACK).count();
        assert!(column(1) > column(5));
        assert!([' ', '1', 'µ', '×', 'Ω', '−', '·'].iter().all(|c| *c == ' ' || glyph(*c) != glyph('?')));
    }

    #[test]
    fn absurd_sizes_are_refused() {
        assert!(Canvas::new(0, 5, WHITE).is_err());
        assert!(Canvas::new(usize::MAX, 2, WHITE).is_err());
        assert!(Canvas::new(1 << 20, 1 << 20, WHITE).is_err());
    }
}
