//! The live viewer, a program that `pix2hdr view` starts.
//!
//! Everything that can be said without a window is said in plain modules. [`source`] opens what is looked at, [`camera`]
//! simulates one that runs live, and the [`engine`] synthesises on a thread of its own into the [`store`]. The [`state`]
//! says what the interface is set to and what each action changes: the [`clock`] which frame is shown, [`place`] where,
//! [`picture`] what of it, [`tone`] how bright; [`series`] and [`histogram`] are read off it, [`export`] writes it.
//! `app`, `panes`, `panels` and `keys` draw this with egui, and add nothing to it but the drawing; `screen` draws the
//! pictures, on the GPU. [`Arguments`] is the command line.

pub mod action;
mod app;
mod arguments;
pub mod camera;
pub mod choices;
pub mod clock;
mod effects;
pub mod engine;
pub mod export;
pub mod frame;
pub mod histogram;
pub mod keys;
mod lock;
mod message;
mod pace;
mod panels;
mod panes;
pub mod picture;
pub mod place;
pub mod preferences;
mod screen;
pub mod series;
pub mod source;
mod start;
pub mod state;
pub mod store;
pub mod tone;
mod window;

pub use app::Viewer;
pub use arguments::Arguments;
pub use pace::Pace;
pub use start::{Start, WindowDevice};
pub use window::run;
