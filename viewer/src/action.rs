//! What a user can do, and what that asks of others.

use crate::picture::Picture;
use crate::preferences::Arrangement;
use crate::source::SourceName;
use crate::tone::Curve;
use pix2hdr::synth::Settings;

/// What a user can do.
#[derive(Clone, Debug, PartialEq)]
pub enum Action {
    /// Starts or stops.
    Play,
    /// Stops, and moves by so many frames.
    Step(i64),
    /// Moves to a frame.
    GoTo(usize),
    /// To the first frame, or the oldest in memory.
    First,
    /// To the last frame, or the newest in memory.
    Last,
    /// Sets frames per second.
    Rate(f64),
    /// The next higher rate.
    Faster,
    /// The next lower rate.
    Slower,
    /// Switches looping.
    Loop,
    /// Sets the exposure.
    Exposure(f32),
    /// Changes the exposure by so many stops.
    Expose(f32),
    /// Chooses the tone curve.
    Curve(Curve),
    /// The next tone curve.
    NextCurve,
    /// Switches the clipping warning.
    Clipping,
    /// Switches dithering.
    Dither,
    /// Sets the range of difference pictures.
    Difference(f32),
    /// Arranges panes.
    Arrange(Arrangement),
    /// The next arrangement.
    NextArrangement,
    /// Shows a picture in a pane.
    Show(usize, Picture),
    /// Shows a picture in the chosen pane.
    ShowHere(Picture),
    /// Chooses the next pane.
    NextPane,
    /// Moves the divider to a place.
    Divider(f32),
    /// Moves the divider by so much.
    MoveDivider(f32),
    /// Fits pictures into their panes.
    Fit,
    /// One point per pixel.
    Actual,
    /// Zooms by a factor around a point of a pane, or its middle.
    Zoom(f32, Option<[f32; 2]>),
    /// Moves pictures by so many points.
    Pan([f32; 2]),
    /// Shows the time series of a pixel, or no longer.
    Pick([usize; 2]),
    /// The same for the pixel under the pointer, or else in the middle of the picture.
    PickHere,
    /// Forgets all pixels.
    Unpick,
    /// Switches the marks on computed cells.
    Overlay,
    /// Opens or closes the dials.
    Dials,
    /// Opens or closes the time series.
    Series,
    /// Opens or closes the list of keys.
    Help,
    /// The next theme.
    NextTheme,
    /// The range begins here.
    RangeFrom,
    /// The range ends here.
    RangeTo,
    /// The range is all of memory again.
    NoRange,
    /// Writes the frame as EXR.
    SaveExr,
    /// Writes the first pane as PNG.
    SavePng,
    /// Writes the range.
    Record,
    /// Copies the picked pixels' values, or else those of all panes under the pointer.
    Copy,
    /// Changes the engine.
    Tune(Settings),
    /// The next net.
    NextNet,
    /// The next executor.
    NextExecutor,
    /// The next precision.
    NextPrecision,
    /// The next mode of skipping.
    NextSkip,
    /// Multiplies the allowed error of bounded skipping.
    AllowMore(f64),
    /// Multiplies the range of difference pictures.
    WidenDifference(f32),
    /// Opens a source.
    Open(SourceName),
    /// Puts the cursor where a source is typed.
    Type,
    /// Ends the viewer.
    Quit,
}

/// What an action asks of others.
#[derive(Clone, Debug, PartialEq)]
pub enum Effect {
    /// The engine: go on from this frame.
    Seek(usize),
    /// The engine: take these settings, go on from this frame.
    Tune(Settings, usize),
    /// The engine: open this.
    Open(SourceName),
    /// Put the cursor where a source is typed.
    Type,
    /// Write the frame as EXR.
    SaveExr,
    /// Write the first pane as PNG.
    SavePng,
    /// Write these frames.
    Record([usize; 2]),
    /// Put values on the clipboard.
    Copy,
    /// End.
    Quit,
}
