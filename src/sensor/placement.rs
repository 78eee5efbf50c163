//! How the frames of a recording lie on the sensor: where they were cut out, and how they were turned.

use serde::{Deserialize, Serialize};

use super::Pattern;

/// How frames were turned against the sensor, under the names that image programs use. Rotations are clockwise.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
pub enum Orientation {
    /// As the sensor is read out
    #[default]
    Normal,
    /// Left and right exchanged
    FlipHorizontal,
    /// Upside down, as in a mirror
    FlipVertical,
    /// Turned by half
    #[serde(rename = "rotate-180")]
    #[cfg_attr(feature = "cli", value(name = "rotate-180"))]
    Rotate180,
    /// Rows and columns exchanged
    Transpose,
    /// A quarter clockwise
    #[serde(rename = "rotate-90")]
    #[cfg_attr(feature = "cli", value(name = "rotate-90"))]
    Rotate90,
    /// A quarter counter-clockwise
    #[serde(rename = "rotate-270")]
    #[cfg_attr(feature = "cli", value(name = "rotate-270"))]
    Rotate270,
    /// Rows and columns exchanged, then turned by half
    Transverse,
}

impl Orientation {
    /// All of them; the plainest first.
    pub const ALL: [Self; 8] = [
        Self::Normal,
        Self::FlipHorizontal,
        Self::FlipVertical,
        Self::Rotate180,
        Self::Transpose,
        Self::Rotate90,
        Self::Rotate270,
        Self::Transverse,
    ];

    /// Its name, as descriptions and options have it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Normal => "normal",
            Self::FlipHorizontal => "flip-horizontal",
            Self::FlipVertical => "flip-vertical",
            Self::Rotate180 => "rotate-180",
            Self::Transpose => "transpose",
            Self::Rotate90 => "rotate-90",
            Self::Rotate270 => "rotate-270",
            Self::Transverse => "transverse",
        }
    }

    /// Whether a row of the frame is a column of the sensor.
    pub fn transposes(self) -> bool {
        matches!(self, Self::Transpose | Self::Rotate90 | Self::Rotate270 | Self::Transverse)
    }

    /// Whether the frame's rows and columns run against the sensor's.
    fn reverses(self) -> [bool; 2] {
        match self {
            Self::Normal | Self::Transpose => [false, false],
            Self::FlipHorizontal | Self::Rotate90 => [false, true],
            Self::FlipVertical | Self::Rotate270 => [true, false],
            Self::Rotate180 | Self::Transverse => [true, true],
        }
    }

    /// Rows and columns of what has `extent` before or behind the turn.
    pub fn turned([rows, cols]: [usize; 2], transposes: bool) -> [usize; 2] {
        if transposes { [cols, rows] } else { [rows, cols] }
    }

    /// The sensor's row and column that a frame of `extent` shows at `place`.
    pub fn sensor_place(self, extent: [usize; 2], place: [usize; 2]) -> [usize; 2] {
        let reverses = self.reverses();
        let along = |axis: usize| {
            if reverses[axis] { extent[axis] - 1 - place[axis] } else { place[axis] }
        };
        Self::turned([along(0), along(1)], self.transposes())
    }
}

/// How the frames of a recording lie on the sensor. The sensor's frames begin with the first pixel of its pattern's tile.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize)]
pub struct Placement {
    /// Row and column, as the frame shows them, at which its first pixel lies in the turned tile. A crop of a recording
    /// from row y and column x on adds [y, x].
    pub tile_origin: [usize; 2],
    /// How the frame was turned.
    pub orientation: Orientation,
}

impl Placement {
    /// Frames as the sensor is read out, from its first pixel on.
    pub const WHOLE: Self = Self { tile_origin: [0, 0], orientation: Orientation::Normal };

    /// For each pixel of the tile that frames show, row by row, the number of the pixel in a sensor's tile of `tile` [rows,
    /// columns].
    pub(super) fn tile_places(self, tile: [usize; 2]) -> Vec<usize> {
        let Self { tile_origin: [row, col], orientation } = self;
        let shown @ [rows, cols] = Orientation::turned(tile, orientation.transposes());
        let place = |y: usize, x: usize| {
            let [v, u] = orientation.sensor_place(shown, [(y + row % rows) % rows, (x + col % cols) % cols]);
            v * tile[1] + u
        };
        (0..rows).flat_map(|y| (0..cols).map(move |x| place(y, x))).collect()
    }

    /// A sensor's pattern as the frames show it.
    #[must_use]
    pub fn shown(self, sensor: &Pattern) -> Pattern {
        let tile = [sensor.rows(), sensor.cols()];
        let schedules = self.tile_places(tile).into_iter().map(|i| sensor.schedules()[i].clone()).collect();
        sensor.rearranged(Orientation::turned(tile, self.orientation.transposes()), schedules)
    }

    /// The sensor's pattern, from one that the frames show.
    #[must_use]
    pub fn on_sensor(self, shown: &Pattern) -> Pattern {
        let tile = Orientation::turned([shown.rows(), shown.cols()], self.orientation.transposes());
        let mut schedules = shown.schedules().to_vec();
        for (i, schedule) in self.tile_places(tile).into_iter().zip(shown.schedules()) {
            schedules[i].clone_from(schedule);
        }
        shown.rearranged(tile, schedules)
    }

    /// All ways in which a sensor's tile of [rows, columns] can lie in a frame; the plainest first.
    pub fn all([rows, cols]: [usize; 2]) -> impl Iterator<Item = Self> {
        Orientation::ALL.into_iter().flat_map(move |orientation| {
            let [rows, cols] = Orientation::turned([rows, cols], orientation.transposes());
            let origins = (0..rows).flat_map(move |row| (0..cols).map(move |col| [row, col]));
            origins.map(move |tile_origin| Self { tile_origin, orientation })
        })
    }

    /// The built-in pattern that frames show as `pattern` where they lie in some other way than whole, and that way.
    pub fn of_built_in(pattern: &Pattern) -> Option<(Pattern, Self)> {
        let known = || Pattern::NAMES.into_iter().filter_map(|name| Pattern::built_in(name).ok());
        let pixels = pattern.schedules().len();
        if known().any(|known| known.samples_like(pattern)) {
            return None;
        }
        known().filter(|known| known.schedules().len() == pixels).find_map(|known| {
            let tile = [known.rows(), known.cols()];
            let found = Self::all(tile).find(|placement| placement.shown(&known).samples_like(pattern))?;
            Some((known, found))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::Schedule;

    /// A tile of which every pixel is another one.
    fn tile() -> Pattern {
        let schedules = (0..8).map(|phase| Schedule::periodic(8, phase).unwrap()).collect();
        Pattern::new("tile", [2, 4], schedules).unwrap()
    }

    fn phases(pattern: &Pattern) -> Vec<usize> {
        pattern.schedules().iter().map(|pixel| pixel.shutters()[0].start()).collect()
    }

    #[test]
    fn tiles_turn_as_pictures_do() {
        let shown = |tile_origin, orientation| {
            let shown = Placement { tile_origin, orientation }.shown(&tile());
            (shown.rows(), phases(&shown))
        };
        assert_eq!(shown([0, 0], Orientation::Normal), (2, vec![0, 1, 2, 3, 4, 5, 6, 7]));
        assert_eq!(shown([1, 3], Orientation::Normal), (2, vec![7, 4, 5, 6, 3, 0, 1, 2]));
        assert_eq!(shown([0, 0], Orientation::FlipHorizontal), (2, vec![3, 2, 1, 0, 7, 6, 5, 4]));
        assert_eq!(shown([0, 0], Orientation::FlipVertical), (2, vec![4, 5, 6, 7, 0, 1, 2, 3]));
        assert_eq!(shown([0, 0], Orientation::Rotate180), (2, vec![7, 6, 5, 4, 3, 2, 1, 0]));
        assert_eq!(shown([0, 0], Orientation::Transpose), (4, vec![0, 4, 1, 5, 2, 6, 3, 7]));
        assert_eq!(shown([0, 0], Orientation::Rotate90), (4, vec![4, 0, 5, 1, 6, 2, 7, 3]));
        assert_eq!(shown([0, 0], Orientation::Rotate270), (4, vec![3, 7, 2, 6, 1, 5, 0, 4]));
        assert_eq!(shown([0, 0], Orientation::Transverse), (4, vec![7, 3, 6, 2, 5, 1, 4, 0]));
        for orientation in Orientation::ALL {
            assert_eq!(serde_json::to_value(orientation).unwrap(), orientation.name());
            #[cfg(feature = "cli")]
            assert_eq!(
                clap::ValueEnum::to_possible_value(&orientation).unwrap().get_name(),
                orientation.name()
            );
        }
        assert_eq!(shown([3, 1], Orientation::Transpose), (4, vec![7, 3, 4, 0, 5, 1, 6, 2]));
    }

    #[test]
    fn every_placement_can_be_undone_and_is_recognised() {
        let placements: Vec<Placement> = Placement::all([2, 4]).collect();
        assert_eq!(placements.len(), 64);
        for placement in placements {
            let shown = placement.shown(&tile());
            assert_eq!(placement.on_sensor(&shown), tile(), "{placement:?}");
            // A frame from row 5 and column 6 on shows what lies there.
            let [row, col] = placement.tile_origin;
            let crop = Placement { tile_origin: [row + 5, col + 6], ..placement }.shown(&tile());
            for (y, x) in (0..9).flat_map(|y| (0..9).map(move |x| (y, x))) {
                assert_eq!(crop.schedule(y, x), shown.schedule(y + 5, x + 6), "{placement:?}");
            }
            for name in ["mpve-1-4", "mpve-1-16", "mpve-2x2-1-8"] {
                let known = Pattern::built_in(name).unwrap();
                let shown = placement.shown(&known);
                match Placement::of_built_in(&shown) {
                    Some((found, placement)) => assert!(placement.shown(&found).samples_like(&shown)),
                    None => assert!(shown.samples_like(&known), "{name}, {placement:?}"),
                }
            }
        }
        assert_eq!(Placement::of_built_in(&tile()), None);
    }
}
