//! What is remembered from one start to the next.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::clock::RATE_RANGE;
use crate::picture::Picture;
use crate::tone::Display;
use pix2hdr::system::settings_folder;
use pix2hdr::video::atomic;
use pix2hdr::{At, Result};

/// Exposures in stops.
pub const EXPOSURES: [f32; 2] = [-8.0, 16.0];

/// Shortest and longest side of a window that is remembered, in points.
pub const WINDOW: [f32; 2] = [150.0, 8192.0];

/// How large everything can be drawn.
pub const SCALES: [f32; 2] = [0.5, 4.0];

/// How panes are arranged.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Arrangement {
    /// One pane.
    Single,
    /// Two side by side.
    Pair,
    /// Two in one place, with a divider that can be dragged.
    Divider,
    /// Four side by side, or two by two.
    #[default]
    Four,
}

impl Arrangement {
    /// All arrangements.
    pub const ALL: [Self; 4] = [Self::Single, Self::Pair, Self::Divider, Self::Four];

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Single => "one",
            Self::Pair => "two",
            Self::Divider => "A|B",
            Self::Four => "four",
        }
    }

    /// Number of pictures.
    pub fn panes(self) -> usize {
        match self {
            Self::Single => 1,
            Self::Pair | Self::Divider => 2,
            Self::Four => 4,
        }
    }
}

/// Light or dark.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Theme {
    /// As the system has it.
    #[default]
    System,
    /// Dark.
    Dark,
    /// Light.
    Light,
}

/// What is remembered from one start to the next.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
#[allow(clippy::struct_excessive_bools)] // Switches of an interface.
pub struct Preferences {
    /// How panes are arranged.
    pub arrangement: Arrangement,
    /// What one pane shows.
    pub single: Picture,
    /// What two panes show.
    pub pair: [Picture; 2],
    /// What four panes show.
    pub four: [Picture; 4],
    /// Where the divider is, from 0 (left) to 1.
    pub divider: f32,
    /// How irradiance is shown.
    pub display: Display,
    /// Frames per second.
    pub rate: f64,
    /// Whether files begin again at their end.
    pub looping: bool,
    /// Whether computed cells are marked.
    pub overlay: bool,
    /// Whether the panel of dials is open.
    pub dials: bool,
    /// Whether the time series is open.
    pub series: bool,
    /// Light or dark.
    pub theme: Theme,
    /// Width and height of the window at a scale of 1, in points.
    pub window: [f32; 2],
    /// How much larger than usual everything is drawn.
    pub scale: f32,
}

impl Default for Preferences {
    fn default() -> Self {
        Self {
            arrangement: Arrangement::Four,
            single: Picture::Ours,
            pair: [Picture::Mosaic, Picture::Ours],
            four: [Picture::Mosaic, Picture::Filtered, Picture::Ours, Picture::Truth],
            divider: 0.5,
            display: Display::default(),
            rate: 30.0,
            looping: true,
            overlay: false,
            dials: true,
            series: false,
            theme: Theme::System,
            window: [1280.0, 800.0],
            scale: 1.0,
        }
    }
}

impl Preferences {
    /// The preferences in a file; the defaults if there is none, or none that can be understood.
    pub fn read(path: &Path) -> Self {
        let read = std::fs::read(path).ok();
        let preferences: Option<Self> = read.and_then(|bytes| serde_json::from_slice(&bytes).ok());
        preferences.unwrap_or_default().within_bounds()
    }

    /// Where they are kept: the user's folder for configuration.
    pub fn path() -> Option<PathBuf> {
        settings_folder().map(|folder| folder.join("view.json"))
    }

    /// Writes them.
    pub fn write(&self, path: &Path) -> Result<()> {
        let text = serde_json::to_vec_pretty(self).at(path)?;
        atomic::write_bytes(path, &text)
    }

    /// Files are edited by hand too.
    fn within_bounds(mut self) -> Self {
        let or = |value: f32, range: [f32; 2], default: f32| {
            if value.is_finite() { value.clamp(range[0], range[1]) } else { default }
        };
        self.divider = or(self.divider, [0.0, 1.0], 0.5);
        self.display.exposure = or(self.display.exposure, EXPOSURES, 0.0);
        self.display.difference = or(self.display.difference, [0.001, 1.0], 0.1);
        self.window = self.window.map(|side| or(side, WINDOW, 800.0));
        self.scale = or(self.scale, SCALES, 1.0);
        self.rate = if self.rate.is_finite() { self.rate.clamp(RATE_RANGE[0], RATE_RANGE[1]) } else { 30.0 };
        self
    }

    /// What the panes show.
    pub fn pictures(&self) -> &[Picture] {
        match self.arrangement {
            Arrangement::Single => std::slice::from_ref(&self.single),
            Arrangement::Pair | Arrangement::Divider => &self.pair,
            Arrangement::Four => &self.four,
        }
    }

    pub(crate) fn pictures_mut(&mut self) -> &mut [Picture] {
        match self.arrangement {
            Arrangement::Single => std::slice::from_mut(&mut self.single),
            Arrangement::Pair | Arrangement::Divider => &mut self.pair,
            Arrangement::Four => &mut self.four,
        }
    }
}
