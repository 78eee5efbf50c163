//! How good a video is: measures against the truth, plots and contact sheets.

mod canvas;
mod contact_sheet;
mod measures;
mod plot;
mod suite;
mod svg;

pub use canvas::{Canvas, Colour, Surface};
pub use contact_sheet::{ContactSheet, Panel};
pub use measures::{
    Comparison, Evaluation, Measures, SquaredError, WorstFrame, WorstPatch, compare, evaluate, normalise,
    ssim, temporal_contrast,
};
pub use plot::Plot;
pub use suite::{Light, Method, Scores, Suite, SuiteReport};
pub use svg::Svg;
