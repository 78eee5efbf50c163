//! Which frames of a capture a window sees, also at the ends of the recording.

use std::ops::Range;

use crate::frame::{Extent, Frame};
use crate::network::Window;
use crate::sensor::Calibration;

/// The windows whose result frames cover schedule times `start` … `start + frames`. Window `k` gives the frames
/// at schedule times k·hop … (k + 1)·hop.
pub fn covering(window: Window, start: i64, frames: usize) -> Range<i64> {
    let hop = window.hop as i64;
    start.div_euclid(hop)..(start + frames as i64 - 1).div_euclid(hop) + 1
}

/// Schedule times that window `k` sees.
pub fn seen(window: Window, k: i64) -> Range<i64> {
    let first = k * window.hop as i64 - window.lead as i64;
    first..first + window.frames as i64
}

/// The frame of a recording of `frames` frames from schedule time `start` that stands in for schedule time `t`:
/// itself if it was recorded, else the nearest one at the same phase of the pattern. A recording shorter than
/// the pattern's period has none for some phases; then it is the nearest frame with the same exposures, else the
/// nearest.
pub fn stand_in(calibration: &Calibration, start: i64, frames: usize, t: i64) -> usize {
    let last = frames as i64 - 1;
    let wanted = t - start;
    let inside = wanted.clamp(0, last);
    let same_exposures = |index: i64| {
        (0..calibration.rows).all(|y| {
            (0..calibration.cols)
                .all(|x| calibration.exposure(start + index, y, x) == calibration.exposure(t, y, x))
        })
    };
    if inside == wanted {
        return inside as usize;
    }
    let period = calibration.period as i64;
    // The nearest recorded frame first.
    let mut near = (0..frames as i64).map(|distance| if wanted < 0 { distance } else { last - distance });
    near.clone()
        .take(calibration.period)
        .find(|index| (index - wanted).rem_euclid(period) == 0)
        .or_else(|| near.find(|&index| same_exposures(index)))
        .unwrap_or(inside) as usize
}

/// The row (or column) of a frame of `len` that stands in for row `i`: itself, or the nearest one at the same place of the
/// pattern's tile, which repeats every `tile`.
pub fn stand_in_row(len: usize, tile: usize, i: i64) -> usize {
    match usize::try_from(i) {
        Ok(i) if i < len => i,
        Ok(i) => i - (i + 1 - len).div_ceil(tile) * tile,
        Err(_) => i.rem_euclid(tile as i64) as usize,
    }
}

/// A frame of pixel values, extended to `wanted` by pixels at the same place of the pattern.
pub fn padded(frame: Frame, calibration: &Calibration, wanted: Extent) -> Frame {
    let Extent { height, width } = frame.extent();
    if frame.extent() == wanted {
        return frame;
    }
    let mut padded = Vec::with_capacity(wanted.pixels());
    for y in 0..wanted.height {
        let row = &frame.values()[stand_in_row(height, calibration.rows, y as i64) * width..][..width];
        padded.extend((0..wanted.width).map(|x| row[stand_in_row(width, calibration.cols, x as i64)]));
    }
    Frame::new(wanted, frame.time(), padded)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::{Form, Pattern, Response};

    fn calibration(pattern: &str) -> Calibration {
        let pattern = Pattern::built_in(pattern).unwrap();
        let response = Response::new(Form::Linear, pattern.shortest_exposure() as f64).unwrap();
        Calibration::new(&pattern, &response)
    }

    #[test]
    fn every_frame_comes_from_one_window() {
        let window = Window { frames: 16, lead: 4, hop: 8 };
        for (start, frames) in [(0, 1), (0, 8), (3, 20), (-5, 9), (7, 1)] {
            let windows = covering(window, start, frames);
            assert!(windows.start * 8 <= start && (windows.start + 1) * 8 > start);
            assert!(
                windows.end * 8 >= start + frames as i64 && (windows.end - 1) * 8 < start + frames as i64
            );
        }
        assert_eq!(seen(window, 1), 4..20);
    }

    #[test]
    fn stand_ins_keep_the_phase() {
        let calibration = calibration("mpve-1-4");
        for t in -30..60 {
            let index = stand_in(&calibration, 3, 20, t) as i64;
            assert_eq!((index + 3 - t).rem_euclid(8), 0, "time {t}");
            assert!((0..20).contains(&index));
            if (3..23).contains(&t) {
                assert_eq!(index + 3, t);
            }
        }
    }

    #[test]
    fn short_recordings_keep_the_exposure() {
        let calibration = calibration("interleaved");
        // Frames 0 and 1 are exposed for 2 frames, the others for 8; three frames are known.
        assert_eq!(stand_in(&calibration, 0, 3, 7), 2);
        assert_eq!(stand_in(&calibration, 0, 3, -1), 2);
        assert_eq!(stand_in(&calibration, 0, 1, 7), 0);
    }

    #[test]
    fn rows_stand_in_for_the_same_place_of_the_tile() {
        for (len, tile) in [(5, 2), (4, 4), (7, 4), (2, 2)] {
            for i in -16..len as i64 + 16 {
                let row = stand_in_row(len, tile, i);
                assert!(row < len && row % tile == i.rem_euclid(tile as i64) as usize);
                let distance = (i - row as i64).unsigned_abs() as usize;
                let outside = (-i).max(i + 1 - len as i64).max(0) as usize;
                assert_eq!(distance, outside.next_multiple_of(tile));
            }
        }
    }
}
