// Exposure in frames of the read-out that covers pixel (y, x) in frame t, counted from the output's first frame.
fn exposure_of(t: i32, y: i32, x: i32) -> f32 {
    let phase = (i32(schedule.x) + FIRST_FRAME + t) % PATTERN_PERIOD;
    return exposures[(phase * PATTERN_ROWS + y % PATTERN_ROWS) * PATTERN_COLS + x % PATTERN_COLS];
}
