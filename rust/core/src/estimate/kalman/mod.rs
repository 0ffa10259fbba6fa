//! Kalman filter and smoother, and the models that they run on.

mod channels;
mod correction;
mod drift;
mod driven;
mod elastic;
mod filter;
mod gaussian;
mod information;
mod jerk;
mod model;
mod output;
mod recording;
mod slope;
mod smoother;
mod step_noise;
mod transition;

pub use channels::{Channel, Evaluation};
pub use driven::JerkDriven;
pub use elastic::{Discretization, ElasticModel, ElasticNoise, ElasticSettings};
pub use filter::{ExtendedKalmanFilter, FilterSettings};
pub use gaussian::{Gaussian, Row, Symmetric};
pub use jerk::{Further, JerkModel, Noise};
pub use model::{Linearised, Model};
pub(crate) use output::Tool;
pub use output::{FilterOutput, Keep};
pub use recording::{Inputs, KalmanRecording, KalmanSample};
pub use smoother::Smoother;
