//! All that a user can choose of a synthesis.

use serde::{Deserialize, Serialize};

use super::{Backend, ExecutorChoice, Skip};
use crate::Result;
use crate::fingerprint::{Fingerprint, Fingerprinted};
use crate::network::{Model, Precision};
use crate::sensor::Pattern;

/// All that a user can choose of a synthesis.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// Weights file, or name of a built-in preset.
    pub weights: String,
    /// Where the net runs.
    pub executor: ExecutorChoice,
    /// Part of the name of the GPU adapter to use.
    pub adapter: Option<String>,
    /// How feature channels and weights are stored.
    pub precision: Precision,
    /// What may be left out.
    pub skip: Skip,
    /// Longest side of a tile's kept part, in pixels; as large as memory allows if there is none.
    pub tile: Option<usize>,
    /// Result frames of a window, in place of the net's own number.
    pub hop: Option<usize>,
    /// Views in which the camera's pattern looks the same, of whose results the mean is taken (see
    /// [`poses`](super::poses)); 0 or 1: the recording as it is.
    pub ensemble: usize,
    /// Whether results get better where a scene rests, by what each pixel read out since it last changed. The camera has
    /// to state its noise.
    pub accumulate: bool,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            weights: "fast".into(),
            executor: ExecutorChoice::default(),
            adapter: None,
            precision: Precision::default(),
            skip: Skip::default(),
            tile: None,
            hop: None,
            ensemble: 1,
            accumulate: false,
        }
    }
}

impl Settings {
    /// The net, for captures of `pattern`.
    pub fn model(&self, pattern: &Pattern) -> Result<Model> {
        Model::load_for(&self.weights, pattern)
    }

    /// Where it runs.
    pub fn backend(&self) -> Result<Backend> {
        Backend::choose(self.executor, self.adapter.as_deref(), self.precision)
    }
}

impl Fingerprinted for Settings {
    /// What is computed and in which parts; the net and where it runs note themselves.
    fn mark(&self, fingerprint: &mut Fingerprint) -> Result<()> {
        fingerprint.note("skip", self.skip)?;
        fingerprint.note("tile", self.tile)?;
        fingerprint.note("hop", self.hop)?;
        fingerprint.note("ensemble", self.ensemble)?;
        fingerprint.note("accumulate", self.accumulate)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Settings come back from JSON, what is not said is as by default, and what is not known is refused.
    #[test]
    fn settings_are_json() {
        let skip = Skip::Bounded(0.01);
        let settings = Settings { skip, hop: Some(8), executor: ExecutorChoice::Cpu, ..Settings::default() };
        let text = serde_json::to_string(&settings).unwrap();
        assert!(
            text.contains(r#""skip":{"bounded":0.01}"#) && text.contains(r#""executor":"cpu""#),
            "{text}"
        );
        assert_eq!(serde_json::from_str::<Settings>(&text).unwrap(), settings);
        assert_eq!(serde_json::from_str::<Settings>("{}").unwrap(), Settings::default());
        assert!(serde_json::from_str::<Settings>(r#"{"tiles": 3}"#).is_err());
    }
}
