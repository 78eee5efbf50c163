//! Names of pictures.

/// Name of the picture of frame `t`.
pub fn frame_name(t: usize) -> String {
    format!("frame-{t:05}.exr")
}

/// Whether a name is one that [`frame_name`] gives.
pub fn is_frame_name(name: &str) -> bool {
    let digits = name.strip_prefix("frame-").and_then(|rest| rest.strip_suffix(".exr"));
    digits.is_some_and(|d| d.len() >= 5 && d.bytes().all(|b| b.is_ascii_digit()))
}
