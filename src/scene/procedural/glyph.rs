//! Letters and digits as strokes, to be printed on things.

use glam::Vec2;

use super::shape::{rectangle, segment};

/// Columns and rows of the grid on which glyphs are drawn; the advance leaves a gap of two columns.
const GRID: Vec2 = Vec2::new(4.0, 6.0);
const ADVANCE: f32 = 6.0;

/// The strokes of a character: lines through grid points, each point two digits (column 0–4, row 0–6 downwards),
/// lines separated by spaces. Characters without strokes are blank.
fn strokes(character: char) -> &'static str {
    match character.to_ascii_uppercase() {
        'A' => "062046 1333",
        'B' => "06003041423303 3344453606",
        'C' => "4130100105163645",
        'D' => "06002042442606",
        'E' => "40000646 0333",
        'F' => "400006 0333",
        'G' => "41301001051636454323",
        'H' => "0006 4046 0343",
        'I' => "1030 1636 2026",
        'J' => "4045361605",
        'K' => "0006 400346",
        'L' => "000646",
        'M' => "0600234046",
        'N' => "06004640",
        'O' | '0' => "103041453616050110",
        'P' => "06003041423303",
        'Q' => "103041453616050110 2446",
        'R' => "06003041423303 2346",
        'S' => "413010010213334445361605",
        'T' => "0040 2026",
        'U' => "000516364540",
        'V' => "002640",
        'W' => "0016233640",
        'X' => "0046 4006",
        'Y' => "002340 2326",
        'Z' => "00400646",
        '1' => "112026 1636",
        '2' => "01103041420646",
        '3' => "0110304142334445361605 1333",
        '4' => "300444 3036",
        '5' => "400003334445361605",
        '6' => "3010010516364544331304",
        '7' => "004016",
        '8' => "130201103041423344453616050413 1333",
        '9' => "4233130201103041453616",
        '-' => "1333",
        '+' => "1333 2224",
        '.' => "2626",
        '/' => "0640",
        ':' => "2222 2525",
        _ => "",
    }
}

/// The lines of a character on the grid.
fn lines(character: char) -> Vec<[Vec2; 2]> {
    let point = |pair: &[u8]| Vec2::new(f32::from(pair[0] - b'0'), f32::from(pair[1] - b'0'));
    let line = |stroke: &'static str| {
        let points: Vec<Vec2> = stroke.as_bytes().chunks_exact(2).map(point).collect();
        points.windows(2).map(|ends| [ends[0], ends[1]]).collect::<Vec<_>>()
    };
    strokes(character).split(' ').flat_map(line).collect()
}

/// One line of text about the origin.
#[derive(Clone, Debug)]
pub struct Text {
    glyphs: Vec<Vec<[Vec2; 2]>>,
    /// Grid cells per unit.
    scale: f32,
    half: Vec2,
    /// Half the width of a stroke.
    pen: f32,
}

impl Text {
    /// `text` with letters of the given height; the strokes are `weight` heights thick.
    pub fn new(text: &str, height: f32, weight: f32) -> Self {
        let glyphs: Vec<_> = text.chars().map(lines).collect();
        // The height is that of the ink, half a stroke above and below the grid.
        let scale = GRID.y / (height * (1.0 - weight));
        let width = (ADVANCE * glyphs.len() as f32 - (ADVANCE - GRID.x)).max(0.0);
        Self { glyphs, scale, half: Vec2::new(width, GRID.y) / (2.0 * scale), pen: height * weight / 2.0 }
    }

    /// Half extents of the ink.
    pub fn half(&self) -> Vec2 {
        self.half + self.pen
    }

    /// Signed distance to the ink (at a distance, to its bounding box).
    pub fn distance(&self, p: Vec2) -> f32 {
        let bound = rectangle(p, self.half()) + 0.5 * self.pen;
        if bound > self.pen {
            return bound;
        }
        let q = (p + self.half) * self.scale;
        let gap = (ADVANCE - GRID.x) / 2.0;
        let last = self.glyphs.len().saturating_sub(1);
        let index = (((q.x + gap) / ADVANCE).max(0.0) as usize).min(last);
        let q = q - Vec2::new(ADVANCE * index as f32, 0.0);
        let nearest = self
            .glyphs
            .get(index)
            .into_iter()
            .flatten()
            .fold(ADVANCE, |nearest, [a, b]| nearest.min(segment(q, *a, *b)));
        nearest / self.scale - self.pen
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_letter_and_digit_has_strokes_on_the_grid_and_a_look_of_its_own() {
        let all: Vec<char> = ('A'..='Z').chain('1'..='9').chain("-+./:".chars()).collect();
        for (i, &c) in all.iter().enumerate() {
            assert!(!lines(c).is_empty(), "{c}");
            for p in lines(c).as_flattened() {
                assert!(p.cmpge(Vec2::ZERO).all() && p.cmple(GRID).all(), "{c}: {p}");
            }
            assert!(all[..i].iter().all(|&other| strokes(other) != strokes(c)), "{c}");
        }
        assert!(lines(' ').is_empty() && lines('é').is_empty());
    }

    #[test]
    fn ink_is_where_the_strokes_are() {
        let text = Text::new("HH", 1.0, 0.1);
        assert!((text.half().y - 0.5).abs() < 1e-6);
        let left = -text.half().x;
        assert!(text.distance(Vec2::new(left + 0.05, 0.3)) < 0.0, "left stem");
        assert!(text.distance(Vec2::new(0.0, 0.0)) > 0.0, "between the letters");
        assert!(text.distance(Vec2::new(left + 0.3, 0.3)) > 0.0, "between the stems");
        assert!(text.distance(Vec2::new(left + 0.3, 0.0)) < 0.0, "bar");
        assert!(text.distance(Vec2::new(3.0, 0.0)) > 1.0);
        assert!(Text::new("", 1.0, 0.1).distance(Vec2::ZERO) > 0.0);
    }
}
