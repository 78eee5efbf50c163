//! Which variant of a convolution is fastest here: measured once for each layer, and kept on disk.
//!
//! A layer is known by its specialised shader, so that a changed shader is measured again. Without a file that can be
//! written nothing is measured, and [`Variant::choose`] decides.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use std::{env, fs};

use super::Gpu;
use super::variant::Variant;
use crate::video::atomic;

/// How long layers of one plan may be measured, before the last one is begun. Those that are left are measured next
/// time.
const PATIENCE: Duration = Duration::from_secs(5);

/// The measured variants of one adapter.
#[derive(Debug)]
pub(super) struct Tuning {
    file: PathBuf,
    /// By hash of the shader.
    variants: BTreeMap<String, Variant>,
    begun: Instant,
    changed: bool,
}

/// The user's folder for what can be made again.
pub fn cache_folder() -> Option<PathBuf> {
    let of = |name| env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
    let folder = if cfg!(windows) {
        of("LOCALAPPDATA")
    } else if cfg!(target_os = "macos") {
        of("HOME").map(|home| home.join("Library/Caches"))
    } else {
        of("XDG_CACHE_HOME").or_else(|| of("HOME").map(|home| home.join(".cache")))
    };
    folder.map(|folder| folder.join("pix2hdr"))
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

    /// The variant for a layer with the shader `text`: the one that was measured before, or the fastest of
    /// `candidates` by `measure`.
    pub fn variant<E>(
        &mut self,
        gpu: &Gpu,
        text: &str,
        candidates: &[Variant],
        mut measure: impl FnMut(Variant) -> Result<Option<Duration>, E>,
    ) -> Result<Option<Variant>, E> {
        let key = hash(text);
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

/// A hash that is the same for every build: FNV-1a, 64 bits.
fn hash(text: &str) -> String {
    let step = |hash: u64, byte: u8| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
    format!("{:016x}", text.bytes().fold(0xcbf2_9ce4_8422_2325, step))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_hash_is_fnv_1a() {
        assert_eq!(hash(""), "cbf29ce484222325");
        assert_eq!(hash("a"), "af63dc4c8601ec8c");
        assert_eq!(hash("foobar"), "85944171f73967e8");
    }
}
