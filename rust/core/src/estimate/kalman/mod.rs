//! Kalman filter and smoother, and the models that they run on.

mod correction;
mod driven;
mod elastic;
mod filter;
mod gaussian;
mod jerk;
mod model;
mod output;
mod phases;
mod recording;
mod slope;
mod smoother;
mod transition;

pub use driven::JerkDriven;
pub use elastic::{Discretization, ElasticModel, ElasticNoise, ElasticSettings};
pub use filter::{ExtendedKalmanFilter, FilterSettings};
pub use gaussian::{Gaussian, Row, Symmetric};
pub use jerk::{JerkModel, Noise};
pub use model::{Linearised, Model};
pub(crate) use output::Tool;
pub use output::{FilterOutput, Keep};
pub use phases::Phases;
pub(crate) use phases::{Linearise, Predict};
pub use recording::{Inputs, KalmanRecording, KalmanSample};
pub use smoother::Smoother;
