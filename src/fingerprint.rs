//! What the bits of a result depend on.
//!
//! Each part of a run writes it of itself, so that nobody has to know all of it: a result that was begun is only gone on
//! with where every part says the same.

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::Result;

/// What the bits of a result depend on, by words that a user knows.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Fingerprint(BTreeMap<String, Value>);

/// A part of a run on which the bits of its result depend.
pub trait Fingerprinted {
    /// Notes all of it that the bits depend on.
    fn mark(&self, fingerprint: &mut Fingerprint) -> Result<()>;
}

/// A part that is not as it was.
#[derive(Clone, Debug, PartialEq)]
pub struct Difference {
    /// What it is.
    pub key: String,
    /// What it was.
    pub before: Value,
    /// What it is now.
    pub now: Value,
}

impl Fingerprint {
    /// That of a part, and of the program's version.
    pub fn of(part: &dyn Fingerprinted) -> Result<Self> {
        let mut fingerprint = Self::default();
        fingerprint.note("version", env!("CARGO_PKG_VERSION"))?;
        fingerprint.add(part)?;
        Ok(fingerprint)
    }

    /// Adds another part.
    pub fn add(&mut self, part: &dyn Fingerprinted) -> Result<()> {
        part.mark(self)
    }

    /// Notes a value, which no other part calls so.
    pub fn note(&mut self, key: &str, value: impl Serialize) -> Result<()> {
        let before = self.0.insert(key.to_owned(), serde_json::to_value(value)?);
        assert!(before.is_none(), "two parts of a run note '{key}'");
        Ok(())
    }

    /// The text that [`Fingerprint::read`] reads.
    pub fn text(&self) -> Result<Vec<u8>> {
        Ok(serde_json::to_vec_pretty(self)?)
    }

    /// Reads a fingerprint.
    pub fn read(text: &[u8]) -> Result<Self> {
        Ok(serde_json::from_slice(text)?)
    }

    /// The first part of this one that was not so `before`, or is none any more.
    pub fn difference(&self, before: &Self) -> Result<Option<Difference>> {
        // Numbers as they come back from text.
        let now = Self::read(&self.text()?)?;
        let keys: BTreeSet<_> = before.0.keys().chain(now.0.keys()).collect();
        let value = |of: &Self, key: &String| of.0.get(key).cloned().unwrap_or_default();
        let mut differences = keys.into_iter().map(|key| Difference {
            key: key.clone(),
            before: value(before, key),
            now: value(&now, key),
        });
        Ok(differences.find(|difference| difference.before != difference.now))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Part(&'static str, f64);

    impl Fingerprinted for Part {
        fn mark(&self, fingerprint: &mut Fingerprint) -> Result<()> {
            fingerprint.note(self.0, self.1)
        }
    }

    fn of(parts: &[Part]) -> Fingerprint {
        let mut fingerprint = Fingerprint::of(&parts[0]).unwrap();
        parts[1..].iter().for_each(|part| fingerprint.add(part).unwrap());
        fingerprint
    }

    #[test]
    fn what_differs_is_named() {
        let two = |a: f64, b: f64| of(&[Part("a", a), Part("b", b)]);
        // A number that text does not give back to the last digit is the same number all the same.
        let made = two(0.1 + 0.2, 1.0 / 3.0);
        assert_eq!(made.difference(&Fingerprint::read(&made.text().unwrap()).unwrap()).unwrap(), None);
        let difference = two(0.1, 1.0).difference(&two(0.1, 2.0)).unwrap().unwrap();
        assert_eq!(difference, Difference { key: "b".into(), before: 2.0.into(), now: 1.0.into() });
        let new = of(&[Part("a", 0.1), Part("c", 1.0)]);
        assert_eq!(new.difference(&of(&[Part("a", 0.1)])).unwrap().unwrap().key, "c");
        assert_eq!(two(0.1, 1.0).difference(&new).unwrap().unwrap().key, "b");
    }

    #[test]
    #[should_panic(expected = "note 'a'")]
    fn no_part_hides_another_one() {
        of(&[Part("a", 1.0), Part("a", 2.0)]);
    }
}
