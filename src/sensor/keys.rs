//! The keys of `capture.json`: reading them, and saying what is wrong with one.

use std::fmt;

use serde::de::{Deserialize, Deserializer, Error, MapAccess, Visitor};
use serde_json::{Map, Value, json};

use super::{CaptureInfo, SensorError};

/// Each key, and a form of it that is right.
const KEYS: [(&str, &str); 17] = [
    (
        "pattern",
        "a built-in name, as \"mpve-1-4\", or {\"tile\": [[[2, 1], [4, 2]], [[4, 0], [4, 1]]]} of [exposure, phase]",
    ),
    ("timing", "\"covering\" or \"hold\""),
    ("schedule_start", "a whole number, as 3"),
    ("tile_origin", "[row, column], as [0, 2]"),
    (
        "orientation",
        "\"normal\", \"flip-horizontal\", \"flip-vertical\", \"rotate-180\", \"transpose\", \"rotate-90\", \"rotate-270\" or \"transverse\"",
    ),
    ("bit_depth", "a whole number, as 10"),
    ("black_level", "a number, as 64"),
    ("white_level", "a number, as 1023"),
    ("frame_period_ms", "a number, as 1.0"),
    (
        "response",
        "\"linear\", {\"gamma\": 2.2}, {\"soft-knee\": 0.6}, {\"table\": [[0, 0], [1, 1]]} or the name of a CSV file, as \"response.csv\"",
    ),
    ("full_well_e", "a number, as 9000"),
    ("read_noise_e", "a number, as 2.67"),
    ("anchor", "a number, as 1.0"),
    ("dead_pixels", "[[row, column], …], as [[20, 31], [40, 7]]"),
    ("missing_count", "a whole number up to 65535, as 0"),
    ("frame_numbers", "the name of a file with a number a line, or the numbers themselves, as [0, 1, 3]"),
    (
        "time_stamps_ms",
        "the name of a file with a number a line, or the numbers themselves, as [0.0, 1.0, 3.0]",
    ),
];

/// The keys of an object, each of which is there once.
struct Keys(Map<String, Value>);

impl<'de> Deserialize<'de> for Keys {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Object;
        impl<'de> Visitor<'de> for Object {
            type Value = Keys;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("an object, as {\"pattern\": \"mpve-1-4\"}")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut object: A) -> Result<Keys, A::Error> {
                let mut keys = Map::new();
                while let Some((key, value)) = object.next_entry::<String, Value>()? {
                    if keys.contains_key(&key) {
                        return Err(A::Error::custom(format!("\"{key}\" is there twice; keep one of them")));
                    }
                    keys.insert(key, value);
                }
                Ok(Keys(keys))
            }
        }
        deserializer.deserialize_map(Object)
    }
}

/// The keys of a description, unread.
pub(super) fn parse(text: &str) -> Result<Map<String, Value>, SensorError> {
    match serde_json::from_str::<Keys>(text) {
        Ok(Keys(keys)) => Ok(keys),
        Err(error) if error.is_data() => Err(SensorError::Capture(error.to_string())),
        Err(error) => Err(SensorError::Capture(format!(
            "not JSON: {error} (which has no comments, no comma before a closing bracket and no NaN)"
        ))),
    }
}

/// What the keys say.
pub(super) fn info(keys: &Map<String, Value>) -> Result<CaptureInfo, SensorError> {
    serde_json::from_value(Value::Object(keys.clone()))
        .map_err(|error| SensorError::Capture(problem(keys).unwrap_or_else(|| error.to_string())))
}

/// What is wrong with the first key that cannot be used.
fn problem(keys: &Map<String, Value>) -> Option<String> {
    // A description without fault, but for the key that is tried.
    let sound = json!({ "pattern": "global", "bit_depth": 8, "white_level": 255 });
    keys.iter().find_map(|(key, value)| {
        let Some((_, form)) = KEYS.iter().find(|(known, _)| known == key) else {
            let plain = |key: &str| key.to_lowercase().replace(['_', '-', ' '], "");
            let (own, known) = (plain(key), KEYS.map(|(known, _)| known));
            let meant =
                known.iter().find(|known| own.starts_with(&plain(known)) || plain(known).starts_with(&own));
            return Some(match meant {
                Some(meant) => format!("no key \"{key}\"; it is called \"{meant}\""),
                None => format!("no key \"{key}\"; there are {}", known.join(", ")),
            });
        };
        let mut tried = sound.clone();
        tried[key] = value.clone();
        let fits = serde_json::from_value::<CaptureInfo>(tried).is_ok();
        let shown: String = value.to_string().chars().take(60).collect();
        (!fits).then(|| format!("\"{key}\" is {shown}; write {form}"))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn error(text: &str) -> String {
        parse(text).and_then(|keys| info(&keys)).unwrap_err().to_string()
    }

    /// Every key is in the list, with a form that can be used.
    #[test]
    fn all_keys_are_known() {
        let all = json!({
            "pattern": "mpve-1-4", "timing": "hold", "schedule_start": 3, "tile_origin": [0, 2],
            "orientation": "transverse", "bit_depth": 10, "black_level": 64, "white_level": 1023,
            "frame_period_ms": 1.0, "response": "linear", "full_well_e": 9000, "read_noise_e": 2.67, "anchor": 1.0,
            "dead_pixels": [[20, 31]], "missing_count": 0, "frame_numbers": "n.csv", "time_stamps_ms": "t.csv"
        });
        let written = serde_json::to_value(info(all.as_object().unwrap()).unwrap()).unwrap();
        for (key, _) in written.as_object().unwrap() {
            assert!(KEYS.iter().any(|(known, _)| known == key), "{key}");
        }
        assert_eq!(written.as_object().unwrap().len(), KEYS.len());
    }

    #[test]
    fn what_is_wrong_is_named_with_its_cure() {
        let with = |key: &str, value: &str| {
            let others = r#""pattern": "global", "bit_depth": 8, "white_level": 255"#;
            match key {
                "pattern" => error(&format!(r#"{{"bit_depth": 8, "white_level": 255, "pattern": {value}}}"#)),
                "bit_depth" => {
                    error(&format!(r#"{{"pattern": "global", "white_level": 255, "bit_depth": {value}}}"#))
                }
                "white_level" => {
                    error(&format!(r#"{{"pattern": "global", "bit_depth": 8, "white_level": {value}}}"#))
                }
                _ => error(&format!(r#"{{{others}, "{key}": {value}}}"#)),
            }
        };
        for (key, value, form) in [
            ("schedule_start", "3.0", "whole number"),
            ("bit_depth", "10.0", "whole number"),
            ("bit_depth", "\"10\"", "whole number"),
            ("white_level", "null", "a number"),
            ("response", r#"{"gama": 2.2}"#, r#"{"gamma": 2.2}"#),
            ("response", "[2.2]", r#"{"gamma": 2.2}"#),
            ("response", "2.2", r#"{"gamma": 2.2}"#),
            ("pattern", r#"{"tile": [[2, 1], [4, 2]]}"#, r#"{"tile": [[["#),
            ("pattern", r#"{"tile": [[[2.0, 1]]]}"#, r#"{"tile": [[["#),
            ("pattern", "[[2, 1]]", r#"{"tile": [[["#),
            ("timing", "\"Hold\"", "\"hold\""),
            ("dead_pixels", "[1, 2]", "[row, column]"),
            ("tile_origin", "[-1, 0]", "[row, column]"),
        ] {
            let error = with(key, value);
            assert!(error.contains(&format!("\"{key}\" is")) && error.contains(form), "{error}");
        }
        assert!(with("blacklevel", "64").contains("called \"black_level\""));
        assert!(with("frame_period", "1.0").contains("called \"frame_period_ms\""));
        assert!(with("colour", "1").contains("there are pattern, timing"));
        assert!(with("schedule_start", "1, \"schedule_start\": 2").contains("twice"));
        for broken in ["", "// mine\n{}", r#"{"pattern": "global",}"#, r#"{"white_level": NaN}"#] {
            assert!(error(broken).contains("not JSON"), "{broken}");
        }
        for other in ["[]", "null", "3"] {
            assert!(error(other).contains("an object, as {"), "{other}");
        }
        assert!(error("{}").contains("pattern"));
    }
}
