//! The operations of a layer graph. Everything of one operation that a graph and a plan have to know is in its file, and
//! [`for_each_operation`] lists them all.

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

use std::sync::Arc;

use serde::{Deserialize, Serialize};

pub use blend::{Blend, BlendStep};
pub use box_estimate::BoxEstimate;
pub use concat::Concat;
pub use convolution::{Conv3d, ConvTranspose3d};
pub use features::{Features, FeaturesStep};
pub use fuse::Fuse;
pub use inverse_response::InverseResponse;
pub use log_irradiance::LogIrradiance;
use operation::{Computed, Computes, Operation, Parts};

use super::kernel::{ConvolutionStep, Parameter};

/// Gives all operations to the macro `$with`: the name that graphs, the shader and the CPU twin have for it, and its
/// type. Those that are computed have a kernel; of those that are placed, inputs only have to lie in the right places.
///
/// What has to be done for every operation is written once, as a macro that takes this table: the types
/// [`Op`] and [`Kernel`], the choice of the twin, and the list of shaders.
macro_rules! for_each_operation {
    ($with:ident) => {
        $with! {
            computed: {
                box_estimate: BoxEstimate,
                log_irradiance: LogIrradiance,
                features: Features,
                conv3d: Conv3d,
                conv_transpose3d: ConvTranspose3d,
                inverse_response: InverseResponse,
                fuse: Fuse,
                blend: Blend,
            }
            placed: {
                concat: Concat,
            }
        }
    };
}
pub(crate) use for_each_operation;

macro_rules! define {
    (computed: { $($name:ident: $Op:ident,)* } placed: { $($placed:ident: $Placed:ident,)* }) => {
        /// The operations.
        #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
        #[serde(tag = "op", rename_all = "snake_case")]
        pub enum Op {
            $(#[doc = concat!("`", stringify!($name), "`.")] $Op($Op),)*
            $(#[doc = concat!("`", stringify!($placed), "`.")] $Placed($Placed),)*
        }

        /// What a step of a plan computes.
        #[derive(Clone, Debug)]
        pub enum Kernel {
            $(#[doc = concat!("Results of `", stringify!($name), "`.")] $Op(<$Op as Computed>::Step),)*
        }

        impl Op {
            /// What is known of the operation.
            pub(super) fn operation(&self) -> &dyn Operation {
                match self {
                    $(Self::$Op(op) => op,)*
                    $(Self::$Placed(op) => op,)*
                }
            }

            /// What computes some of the results; `None` where inputs only have to lie in the right places.
            pub(super) fn kernel(&self, parts: &Parts<'_>) -> Option<Kernel> {
                match self {
                    $(Self::$Op(op) => Some(Kernel::$Op(op.step(parts))),)*
                    $(Self::$Placed(_) => None,)*
                }
            }
        }

        impl Kernel {
            /// Names of all kernels, which are those of their operations, their shaders and their CPU twins.
            pub const NAMES: &[&str] = &[$(stringify!($name)),*];

            /// Name of the kernel.
            pub fn name(&self) -> &'static str {
                match self {
                    $(Self::$Op(_) => stringify!($name),)*
                }
            }

            /// The convolution, if it is one.
            pub fn convolution(&self) -> Option<&Arc<ConvolutionStep>> {
                match self {
                    $(Self::$Op(step) => Computes::convolution(step),)*
                }
            }

            /// Its parameters by the names that shaders have for them.
            pub fn parameters(&self) -> Vec<(&'static str, Parameter)> {
                match self {
                    $(Self::$Op(step) => step.parameters(),)*
                }
            }
        }
    };
}
for_each_operation!(define);
