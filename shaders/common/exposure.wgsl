// Exposure in frames of the read-out that covers pixel (y, x) in frame t of the window.
fn exposure_of(t: i32, y: i32, x: i32) -> f32 {
    let phase = (i32(schedule.x) + t) % PATTERN_PERIOD;
    return exposures[(phase * PATTERN_ROWS + y % PATTERN_ROWS) * PATTERN_COLS + x % PATTERN_COLS];
}
