//! Real recordings become captures.

use std::path::{Path, PathBuf};

use super::fit_response::{self, ResponseFit, fit_response};
use super::{Capture, CaptureFile, Detection, Finding, RatioCheck, Recording, ResponseSpec};
use crate::Result;
use crate::math::spread;
use crate::video::begin_counts;

/// How a recording is imported.
#[derive(Clone, Copy, Debug, Default)]
pub struct Importing {
    /// Whether response and black level are fitted to it (see [`fit_response`]).
    pub fit_response: bool,
    /// Whether tile origin, orientation, schedule start and timing are taken from the recording where it shows them.
    pub detect: bool,
    /// Whether files that are there are replaced.
    pub overwrite: bool,
}

/// What became of a recording.
#[derive(Debug)]
pub struct Imported {
    /// What is known of the capture that was written, without its frames.
    pub recording: Recording,
    /// Number of frames.
    pub frames: usize,
    /// Its files: counts and description.
    pub files: [PathBuf; 2],
    /// The fitted response, if one was asked for.
    pub fit: Option<ResponseFit>,
    /// What it showed of its schedule, if that was to be detected.
    pub detection: Option<Detection>,
    /// What still contradicts its description.
    pub findings: Vec<Finding>,
    /// How static pixels scale with their exposure, where that could be judged.
    pub exposure: Option<RatioCheck>,
}

/// Writes a recording as a capture into `folder`: frame by frame, each as the exposures that cover it.
///
/// Memory does not depend on the length of the recording, none of whose files can be written over.
pub fn import(mut file: CaptureFile, folder: &Path, how: Importing) -> Result<Imported> {
    let files = Capture::files(folder);
    for target in &files {
        file.outputs(how.overwrite).check(target)?;
    }
    let detection = if how.detect { Some(file.inspect()?.detection()) } else { None };
    if let Some(detection) = &detection {
        file.recording = detected(&file.recording, detection)?;
    }
    let frames = file.frames;
    let mut described = file.covering_excerpt(&spread(frames, fit_response::LOOKS).collect::<Vec<_>>())?;
    let fit = if how.fit_response { Some(fit_response(&described)?) } else { None };
    if let Some(fit) = &fit {
        described = described.with_response(fit)?;
    }
    let recording = described.recording();
    // The recording as it stands in its file, which is held against what is said of it.
    let mut recorded = recording.clone();
    recorded.info.timing = file.recording.info.timing;
    let inspection = file.inspection_of(&recorded);
    let mut writer = begin_counts(&files[0], [frames, recording.height, recording.width], file.bits())?;
    let mut covering = file.into_covering_counts(inspection);
    while let Some(counts) = covering.next()? {
        writer.push(&counts)?;
    }
    writer.finish()?;
    described.write_description(&files[1])?;
    let (findings, exposure) = (covering.inspection.findings(), covering.inspection.exposure());
    Ok(Imported { recording, frames, files, fit, detection, findings, exposure })
}

/// What is known of a recording, with what it shows of its schedule in place of what it is described as.
fn detected(recording: &Recording, detection: &Detection) -> Result<Recording> {
    let mut info = recording.info.clone();
    if let Some(schedule) = &detection.schedule {
        info.schedule_start = schedule.schedule_start;
        (info.tile_origin, info.orientation) =
            (schedule.placement.tile_origin, schedule.placement.orientation);
    }
    info.timing = detection.timing.unwrap_or(info.timing);
    // Its response was read when it was opened.
    info.response = ResponseSpec::Form(recording.response.form().clone());
    Recording::new(info, [recording.height, recording.width], None)
}
