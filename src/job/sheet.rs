//! The contact sheet of a result, and the picture of what was skipped.

use std::path::{Path, PathBuf};

use super::{Resumable, Sink};
use crate::Result;
use crate::baseline::box_filter;
use crate::cpu::inverse_response;
use crate::frame::{Extent, Plane};
use crate::quality::{ContactSheet, Panel};
use crate::sensor::Recording;
use crate::synth::{Report, ResultFrame, Skip, Skipped};
use crate::video::{ToneRange, Video, png};

/// Frames on the contact sheet.
const SHOWN: usize = 6;

/// The contact sheet.
const SHEET: &str = "contact-sheet.png";
/// The picture of what was skipped.
const SKIPPED: &str = "skipped.png";

/// A few frames spread evenly over `frames`.
pub fn shown_frames(frames: usize) -> Vec<usize> {
    let shown = SHOWN.min(frames);
    (0..shown).map(|i| (2 * i + 1) * frames / (2 * shown)).collect()
}

/// Rows of mosaic, box filter and `results`, which are named rows of irradiance, all with the same black and white; `mosaics`
/// are the pixel values of the frames `shown`. Each pixel of a mosaic shows the irradiance that it alone would mean,
/// R⁻¹(y)/e.
pub fn contact_sheet(
    recording: &Recording,
    shown: &[usize],
    mosaics: &[Vec<f32>],
    results: &[(&str, &[Vec<f32>])],
) -> ContactSheet {
    let (extent, calibration) = (recording.extent(), recording.calibration());
    let schedule = |t: usize| recording.info.schedule_start + t as i64;
    let own = |(mosaic, &t): (&Vec<f32>, &usize)| -> Vec<f32> {
        let exposure = |i: usize| calibration.exposure(schedule(t), i / extent.width, i % extent.width);
        let irradiance =
            |(i, y): (usize, &f32)| inverse_response(calibration.inverse_response(), *y) / exposure(i);
        mosaic.iter().enumerate().map(irradiance).collect()
    };
    let filter = |(mosaic, &t): (&Vec<f32>, &usize)| -> Vec<f32> {
        let mut frame = Video::black(1, extent.height, extent.width);
        frame.frame_mut(0).copy_from_slice(mosaic);
        box_filter(&frame, &calibration, schedule(t)).data
    };
    let measured: Vec<Vec<f32>> = mosaics.iter().zip(shown).map(own).collect();
    let filtered: Vec<Vec<f32>> = mosaics.iter().zip(shown).map(filter).collect();
    // The box filter is there for every sheet of the recording, so all sheets of it look alike.
    let levels = ToneRange::of(filtered.iter().map(Vec::as_slice));
    let panels = |frames: &[Vec<f32>]| -> Vec<Panel> {
        frames.iter().map(|frame| Panel::toned(Plane::new(extent, frame), levels)).collect()
    };
    let heading = |t: &usize| format!("{:.0} ms", *t as f64 * recording.info.frame_period_ms);
    let sheet = ContactSheet::new((320 / extent.width.max(1)).clamp(1, 4))
        .columns(shown.iter().map(heading))
        .row("mosaic", panels(&measured))
        .row("box filter", panels(&filtered));
    results.iter().fold(sheet, |sheet, (name, frames)| sheet.row(*name, panels(frames)))
}

/// Collects what `contact-sheet.png` shows and, where something was skipped, `skipped.png`: the shown frames with what was
/// computed in red, and how often it was over the whole run.
pub struct Sheet {
    folder: PathBuf,
    recording: Recording,
    shown: Vec<usize>,
    mosaics: Vec<Vec<f32>>,
    /// Irradiance of the shown frames that there are.
    frames: Vec<Vec<f32>>,
    /// Which of them is known to have which cells computed.
    computed: Vec<(usize, Vec<bool>)>,
}

impl Sheet {
    /// Of a result in `folder`, of so many frames of a recording; `mosaic` gives the pixel values [y, x] of a frame.
    pub fn new(
        folder: PathBuf,
        recording: Recording,
        frames: usize,
        mosaic: impl FnMut(usize) -> Result<Vec<f32>>,
    ) -> Result<Self> {
        let shown = shown_frames(frames);
        let mosaics = shown.iter().copied().map(mosaic).collect::<Result<Vec<_>>>()?;
        Ok(Self { folder, recording, shown, mosaics, frames: Vec::new(), computed: Vec::new() })
    }

    /// The files that come into `folder`.
    pub fn files(folder: &Path, skip: Skip) -> Vec<PathBuf> {
        let skipped = (skip != Skip::Off).then_some(SKIPPED);
        [SHEET].into_iter().chain(skipped).map(|name| folder.join(name)).collect()
    }

    /// Shows frames that an earlier run left, too.
    pub fn look_back(&mut self, result: &Resumable) -> Result<()> {
        let begun = result.begun();
        for &t in self.shown.iter().filter(|t| **t < begun) {
            self.frames.extend(result.written(t)?);
        }
        Ok(())
    }
}

impl Sink for Sheet {
    /// The files.
    type Output = Vec<PathBuf>;

    fn take(&mut self, result: &ResultFrame) -> Result<()> {
        if self.shown.contains(&result.number) {
            if let Some((active, slab)) = &result.computed {
                self.computed.push((self.frames.len(), active.slab(*slab).to_vec()));
            }
            self.frames.push(result.frame.values().to_vec());
        }
        Ok(())
    }

    fn finish(self, run: &Report) -> Result<Vec<PathBuf>> {
        let Self { folder, recording, shown, mosaics, frames, computed } = self;
        let mut files = vec![folder.join(SHEET)];
        contact_sheet(&recording, &shown, &mosaics, &[("pix2hdr", &frames)]).write(&files[0])?;
        if let Some(skipped) = &run.skipping {
            let path = folder.join(SKIPPED);
            let levels = ToneRange::of(frames.iter().map(Vec::as_slice));
            let panel = |i: usize| Panel::toned(Plane::new(recording.extent(), &frames[i]), levels);
            let overlay: Vec<(Panel, Vec<bool>)> =
                computed.into_iter().map(|(i, cells)| (panel(i), cells)).collect();
            let (pixels, width) = skip_picture(&overlay, skipped, recording.extent());
            png::write_rgb(&path, &pixels, width)?;
            files.push(path);
        }
        Ok(files)
    }
}

/// The shown frames with the cells that were computed in red, and how often each cell was computed over the whole
/// run; its width in pixels.
fn skip_picture(
    shown: &[(Panel, Vec<bool>)],
    skipped: &Skipped,
    Extent { height, width }: Extent,
) -> (Vec<[u8; 3]>, usize) {
    const GAP: usize = 4;
    let whole = (width + GAP) * (shown.len() + 1) - GAP;
    let mut picture = vec![[255; 3]; whole * height];
    let cell = |y: usize, x: usize| y / skipped.cell[0] * skipped.grid[1] + x / skipped.cell[1];
    for y in 0..height {
        for x in 0..width {
            for (i, (panel, active)) in shown.iter().enumerate() {
                let grey = panel.pixels[y * width + x];
                let dark = grey / 2;
                let pixel = if active[cell(y, x)] { [128 + dark, dark, dark] } else { [grey; 3] };
                picture[y * whole + i * (width + GAP) + x] = pixel;
            }
            let often = f64::from(skipped.computed[cell(y, x)]) / skipped.slabs.max(1) as f64;
            picture[y * whole + shown.len() * (width + GAP) + x] = [(255.0 * often).round() as u8, 0, 0];
        }
    }
    (picture, whole)
}
