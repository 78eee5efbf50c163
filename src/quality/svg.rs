//! A vector picture to draw on.

use std::fmt::Write;

use super::canvas::{Colour, Surface, text_height, text_width};

/// A vector picture (SVG) with a white ground.
#[derive(Clone, Debug)]
pub struct Svg {
    width: usize,
    height: usize,
    elements: String,
}

impl Svg {
    /// An empty picture.
    pub fn new(width: usize, height: usize) -> Self {
        Self { width, height, elements: String::new() }
    }

    /// The file.
    pub fn finish(self) -> String {
        let Self { width, height, elements } = self;
        format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" \
             viewBox=\"0 0 {width} {height}\" font-family=\"monospace\">\n\
             <rect width=\"{width}\" height=\"{height}\" fill=\"#ffffff\"/>\n{elements}</svg>\n"
        )
    }

    fn element(&mut self, text: std::fmt::Arguments<'_>) {
        // Writing to a string cannot fail.
        let _ = writeln!(self.elements, "{text}");
    }
}

impl Surface for Svg {
    fn fill(&mut self, x: i64, y: i64, width: usize, height: usize, colour: Colour) {
        let colour = hex(colour);
        self.element(format_args!(
            "<rect x=\"{x}\" y=\"{y}\" width=\"{width}\" height=\"{height}\" fill=\"{colour}\"/>"
        ));
    }

    fn line(&mut self, from: (f32, f32), to: (f32, f32), thickness: f32, colour: Colour) {
        let ((x0, y0), (x1, y1)) = (from, to);
        if [x0, y0, x1, y1, thickness].iter().all(|v| v.is_finite()) {
            let colour = hex(colour);
            self.element(format_args!(
                "<line x1=\"{x0:.2}\" y1=\"{y0:.2}\" x2=\"{x1:.2}\" y2=\"{y1:.2}\" stroke=\"{colour}\" \
                 stroke-width=\"{thickness:.2}\" stroke-linecap=\"round\"/>"
            ));
        }
    }

    fn text(&mut self, x: i64, y: i64, text: &str, scale: usize, colour: Colour) {
        let (width, height, colour) = (text_width(text, scale), text_height(scale), hex(colour));
        let text = text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;");
        // As wide as the picture font, whose letters are square: all places are laid out for it.
        self.element(format_args!(
            "<text x=\"{x}\" y=\"{}\" font-size=\"{height}\" textLength=\"{width}\" \
             lengthAdjust=\"spacingAndGlyphs\" fill=\"{colour}\">{text}</text>",
            y + height as i64 * 7 / 8,
        ));
    }
}

fn hex([r, g, b]: Colour) -> String {
    format!("#{r:02x}{g:02x}{b:02x}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn marks_of_the_language_are_escaped_and_bad_coordinates_left_out() {
        let mut svg = Svg::new(40, 30);
        svg.text(1, 2, "a < b & c", 1, [1, 2, 255]);
        svg.line((0.0, f32::NAN), (1.0, 1.0), 1.0, [0; 3]);
        let text = svg.finish();
        assert!(text.contains(">a &lt; b &amp; c</text>") && text.contains("#0102ff"), "{text}");
        assert!(!text.contains("NaN") && !text.contains("<line"), "{text}");
    }
}
