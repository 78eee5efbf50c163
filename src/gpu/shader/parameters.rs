//! What a shader is given before it is compiled, and with each dispatch.

use std::collections::BTreeMap;
use std::fmt;

use crate::network::{MU, SATURATED};

/// A value by a name.
#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    /// An i32 or a u32, as the shader declares it.
    Integer(i64),
    /// An f32.
    Float(f32),
    /// A bool.
    Bool(bool),
    /// A value of any other type, in WGSL.
    Other(String),
}

impl fmt::Display for Value {
    /// In WGSL.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Integer(value) => write!(f, "{value}"),
            Self::Float(value) => write!(f, "{value:?}f"),
            Self::Bool(value) => write!(f, "{value}"),
            Self::Other(value) => write!(f, "{value}"),
        }
    }
}

macro_rules! integers {
    ($($integer:ty),*) => {$(
        impl From<$integer> for Value {
            fn from(value: $integer) -> Self {
                Self::Integer(value as i64)
            }
        }
    )*};
}
integers!(i32, u32, usize);

impl From<f32> for Value {
    fn from(value: f32) -> Self {
        Self::Float(value)
    }
}

impl From<bool> for Value {
    fn from(value: bool) -> Self {
        Self::Bool(value)
    }
}

impl Value {
    /// An array of values that are written as `element` says.
    pub fn array<T: fmt::Display>(element: &str, values: impl IntoIterator<Item = T>) -> Self {
        let values: Vec<String> = values.into_iter().map(|value| value.to_string()).collect();
        Self::Other(format!("array<{element}, {}>({})", values.len(), values.join(", ")))
    }
}

/// Values by name, in lower case: of a shader's parameters, which are constants of its text, and of its geometry, which
/// is uniform. The shader says which of them it wants, and as which of both. Also, which file stands for an included one.
#[derive(Clone, Debug)]
pub struct Parameters {
    values: BTreeMap<String, Value>,
    files: BTreeMap<String, &'static str>,
}

impl Default for Parameters {
    /// What is the same for all shaders: the tone curve, and from which pixel value on pixels are saturated.
    fn default() -> Self {
        let mut parameters = Self { values: BTreeMap::new(), files: BTreeMap::new() };
        parameters.set("saturated", SATURATED as f32);
        parameters.set("mu", MU as f32);
        parameters.set("ln_1p_mu", MU.ln_1p() as f32);
        parameters
    }
}

impl Parameters {
    /// Gives `name` a value.
    pub fn set(&mut self, name: &str, value: impl Into<Value>) {
        debug_assert_eq!(name, name.to_lowercase());
        self.values.insert(name.to_owned(), value.into());
    }

    /// Gives `name_t`, `name_y` and `name_x` the values along these axes.
    pub fn set_axes(&mut self, name: &str, [t, y, x]: [usize; 3]) {
        for (axis, value) in [("t", t), ("y", y), ("x", x)] {
            self.set(&format!("{name}_{axis}"), value);
        }
    }

    /// Includes `file` in place of the file that is included as `name`.
    pub fn include(&mut self, name: &str, file: &'static str) {
        self.files.insert(name.to_owned(), file);
    }

    /// The value of a name in any case.
    pub(super) fn get(&self, name: &str) -> Option<&Value> {
        self.values.get(&name.to_lowercase())
    }

    /// The file that is included as `name`, if not the one that stands there.
    pub(super) fn file(&self, name: &str) -> Option<&'static str> {
        self.files.get(name).copied()
    }
}
