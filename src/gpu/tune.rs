//! Which variant of a convolution is fastest here: measured once for each layer, and kept on disk.
//!
//! A layer is known by its specialised shader and its size, so that a changed shader is measured again. Without a file that can be
//! written nothing is measured, and [`Variant::choose`] decides.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use super::Gpu;
use super::variant::Variant;
use crate::math::fnv_1a;
use crate::video::atomic;

/// How long layers of one plan may be measured, before the last one is begun. Those that are left are measured next
/// time.
const PATIENCE: Duration = Duration::from_secs(5);

/// The measured variants of one adapter.
#[derive(Debug)]
pub(super) struct Tuning {
    file: PathBuf,
    /// By hash of the layer.
    variants: BTreeMap<String, Variant>,
    begun: Instant,
    changed: bool,
}

impl Tuning {
    /// What was measured before on the adapter; nothing if the file cannot be written.
    pub fn open(gpu: &Gpu, folder: &Path) -> Option<Self> {
        let adapter = format!("{} {}", gpu.name(), gpu.adapter().driver);
        let file = folder.join(format!("variants-{}.json", hash(&adapter)));
        // What cannot be read is measured again.
        let variants = fs::read(&file).ok().and_then(|bytes| serde_json::from_slice(&bytes).ok());
        let tuning =
            Self { file, variants: variants.unwrap_or_default(), begun: Instant::now(), changed: false };
        match tuning.write() {
            Ok(()) => Some(tuning),
            Err(error) => {
                tracing::info!("kernels are not measured, since the outcome cannot be kept: {error}");
                None
            }
        }
    }

    /// The variant for a `layer`, known by its shader and its size: the one that was measured before, or the fastest of
    /// `candidates` by `measure`.
    pub fn variant<E>(
        &mut self,
        gpu: &Gpu,
        layer: &str,
        candidates: &[Variant],
        mut measure: impl FnMut(Variant) -> Result<Option<Duration>, E>,
    ) -> Result<Option<Variant>, E> {
        let key = hash(layer);
        let known = self.variants.get(&key).copied();
        if let Some(known) = known.filter(|&known| gpu.supports(known)) {
            return Ok(Some(known));
        }
        if self.begun.elapsed() > PATIENCE {
            return Ok(None);
        }
        let mut fastest: Option<(Duration, Variant)> = None;
        for &candidate in candidates {
            let Some(time) = measure(candidate)? else { continue };
            tracing::debug!("{candidate:?} takes {time:?}");
            if fastest.is_none_or(|(shortest, _)| time < shortest) {
                fastest = Some((time, candidate));
            }
        }
        if let Some((_, variant)) = fastest {
            self.variants.insert(key, variant);
            self.changed = true;
        }
        Ok(fastest.map(|(_, variant)| variant))
    }

    /// Keeps what has been measured.
    pub fn save(&self) {
        if !self.changed {
            return;
        }
        if let Err(error) = self.write() {
            tracing::info!("the measured kernels are not kept: {error}");
        }
    }

    fn write(&self) -> crate::Result<()> {
        let bytes = serde_json::to_vec_pretty(&self.variants).map_err(std::io::Error::from)?;
        atomic::write_bytes(&self.file, &bytes)
    }
}

/// What a layer or an adapter is known by.
fn hash(text: &str) -> String {
    format!("{:016x}", fnv_1a(text.bytes()))
}
