//! The operations of a layer graph. Everything of one operation that a graph and a plan have to know is in its file.

mod blend;
mod box_estimate;
mod concat;
mod convolution;
mod features;
mod fuse;
mod inverse_response;
mod log_irradiance;
pub(super) mod operation;
pub(super) mod relation;

use serde::{Deserialize, Serialize};

pub use blend::Blend;
pub use convolution::{Conv3d, ConvTranspose3d};
pub use features::Features;
pub use inverse_response::InverseResponse;
use operation::Operation;

/// The operations.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "op", rename_all = "snake_case")]
pub enum Op {
    /// The box filter of design §4.
    BoxEstimate,
    /// l(R⁻¹(y)/e) of every pixel.
    LogIrradiance,
    /// Input normalisation, and folding of blocks into channels: measurement, estimate (, log irradiance).
    Features(Features),
    /// Convolution with its epilogue.
    Conv3d(Conv3d),
    /// Transposed convolution with its epilogue.
    ConvTranspose3d(ConvTranspose3d),
    /// Channels one behind the other.
    Concat,
    /// Rendered pixel values to irradiance (eq. 22).
    InverseResponse(InverseResponse),
    /// Weighted fusion (eq. 23).
    Fuse,
    /// Predicted kernels.
    Blend(Blend),
}

impl Op {
    /// What is known of the operation.
    pub(super) fn operation(&self) -> &dyn Operation {
        match self {
            Self::BoxEstimate => &box_estimate::BoxEstimate,
            Self::LogIrradiance => &log_irradiance::LogIrradiance,
            Self::Features(features) => features,
            Self::Conv3d(conv) => conv,
            Self::ConvTranspose3d(conv) => conv,
            Self::Concat => &concat::Concat,
            Self::InverseResponse(inverse) => inverse,
            Self::Fuse => &fuse::Fuse,
            Self::Blend(blend) => blend,
        }
    }
}
