//! Shaders as text: the files, the template language that they are written in, and the values that they are given.

pub mod bindings;
mod dump;
mod parameters;
pub mod table;
mod template;
#[cfg(test)]
pub(super) mod validation;

pub use dump::dump;
pub use parameters::{Parameters, Value};
pub use table::ShaderFile;
pub use template::{Shader, as_it_stands, specialise};
