//! What can be wrong with graphs and weights.

/// What can be wrong with a graph or a weights file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum NetworkError {
    /// The file is not a weights file of this format.
    #[error("not a pix2hdr weights file: {0}")]
    Format(String),
    /// A node of the graph is wrong.
    #[error("graph node '{node}': {problem}")]
    Node {
        /// The node's name.
        node: String,
        /// What is wrong with it.
        problem: String,
    },
    /// The graph as a whole is wrong.
    #[error("graph '{0}': {1}")]
    Graph(String, String),
    /// A tensor is missing, superfluous, of the wrong shape or type, or not finite.
    #[error("tensor '{tensor}': {problem}")]
    Tensor {
        /// The tensor's name.
        tensor: String,
        /// What is wrong with it.
        problem: String,
    },
    /// No preset of that name.
    #[error("no weights file or preset '{0}'; presets are {1}")]
    NoPreset(String, String),
    /// The preset has no trained weights.
    #[error("preset '{0}' has no trained weights yet; train it, or name a weights file")]
    Untrained(String),
}

impl crate::error::ModuleError for NetworkError {}
