//! A resolution chart in the manner of the USAF-1951 target.

use glam::Vec2;

use super::glyph::Text;
use super::shape::{Buckets, Stage, floor, rectangle};

/// Three bars upright and three across, each `bar` wide and 5 `bar` long, and the element's number.
#[derive(Clone, Debug)]
struct Element {
    /// Middle of the gap between the two triples.
    middle: Vec2,
    bar: f32,
    number: Text,
    /// Where the number stands from the middle.
    number_at: Vec2,
}

impl Element {
    /// Half extents about the middle.
    fn half(&self) -> Vec2 {
        Vec2::new(10.0, 3.0) * self.bar
    }
}

/// Bars and numbers on a square of half extent 1, about the origin.
#[derive(Clone, Debug)]
pub struct Chart {
    elements: Vec<Element>,
    nearby: Buckets,
}

impl Chart {
    /// Two columns of six elements, each element 2^(−1/6) of the one before; the next two octaves stand small
    /// in the free corner. The largest bars are 1/18 wide.
    pub fn new() -> Self {
        let mut elements = Vec::new();
        column(&mut elements, Vec2::new(0.42, -0.93), 1.0 / 18.0);
        column(&mut elements, Vec2::new(-0.55, -0.93), 0.5 / 18.0);
        column(&mut elements, Vec2::new(-0.33, 0.30), 0.25 / 18.0);
        column(&mut elements, Vec2::new(-0.70, 0.30), 0.125 / 18.0);
        let nearby = Buckets::new(elements.iter().map(|element| (element.middle, element.half())));
        Self { elements, nearby }
    }

    /// How much ink is at `p`, in [0, 1]; `stage` and `size` (the half extent of the chart in its units) say how
    /// sharp.
    pub fn ink(&self, stage: &Stage, p: Vec2, size: f32) -> f32 {
        for element in self.nearby.at(p).map(|index| &self.elements[index]) {
            let Element { middle, bar, number, number_at } = element;
            let q = p - *middle;
            if q.abs().cmpgt(element.half()).any() {
                continue;
            }
            let (left, right) = (q + Vec2::new(3.5 * bar, 0.0), q - Vec2::new(3.5 * bar, 0.0));
            let d = bars(left.perp(), *bar).min(bars(right, *bar)).min(number.distance(q - *number_at));
            return stage.cover(d * size);
        }
        0.0
    }
}

/// Adds six elements below each other from `top`, which is the middle of the column's upper edge.
fn column(elements: &mut Vec<Element>, top: Vec2, largest: f32) {
    let mut middle = top;
    for number in 1..=6 {
        let bar = largest * (-f32::from(number - 1_u8) / 6.0).exp2();
        let text = Text::new(&number.to_string(), 4.0 * bar, 0.2);
        middle.y += 3.0 * bar;
        elements.push(Element { middle, bar, number: text, number_at: Vec2::new(8.5 * bar, 0.0) });
        middle.y += 3.4 * bar;
    }
}

/// Signed distance to three bars `bar` wide, as far apart, 5 `bar` long along y.
fn bars(p: Vec2, bar: f32) -> f32 {
    let nearest = floor(p.x / (2.0 * bar) + 0.5).clamp(-1.0, 1.0);
    rectangle(Vec2::new(p.x - 2.0 * bar * nearest, p.y), Vec2::new(0.5 * bar, 2.5 * bar))
}

#[cfg(test)]
#[allow(clippy::float_cmp, reason = "these values are exact")]
mod tests {
    use super::*;

    #[test]
    fn bars_alternate() {
        let (chart, stage) = (Chart::new(), Stage::new(2000, 2000));
        let Element { middle, bar, .. } = chart.elements[0];
        let ink = |dx: f32| chart.ink(&stage, middle + Vec2::new(dx * bar, 0.0), 1.0);
        assert_eq!([ink(1.5), ink(2.5), ink(3.5), ink(4.5), ink(5.5)], [1.0, 0.0, 1.0, 0.0, 1.0]);
        assert_eq!(chart.ink(&stage, Vec2::new(0.99, 0.99), 1.0), 0.0);
    }

    #[test]
    fn elements_do_not_overlap_and_lie_on_the_chart() {
        let chart = Chart::new();
        for (i, a) in chart.elements.iter().enumerate() {
            let right = a.middle.x + a.number_at.x + a.number.half().x;
            assert!(right < 1.0 && a.middle.x - 6.0 * a.bar > -1.0 && a.middle.y + 3.0 * a.bar < 1.0, "{i}");
            for b in &chart.elements[..i] {
                let apart = (a.middle - b.middle).abs();
                let reach = 3.0 * (a.bar + b.bar);
                assert!(apart.y > reach || apart.x > 6.0 * a.bar + 10.0 * b.bar, "{i}");
            }
        }
    }
}
