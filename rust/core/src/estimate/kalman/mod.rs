//! Kalman filter and smoother, and the models that they run on.

mod channels;
mod correction;
mod driven;
mod elastic;
mod filter;
mod gaussian;
mod jerk;
mod model;
mod output;
mod recording;
mod slope;
mod smoother;
mod transition;

pub use channels::{Channel, Evaluation};
pub use driven::JerkDriven;
pub use elastic::{Discretization, ElasticModel, ElasticNoise, ElasticSettings};
pub use filter::{ExtendedKalmanFilter, FilterSettings, MOST_ITERATIONS};
pub use gaussian::{Gaussian, Row, Symmetric};
pub use jerk::{Further, JerkModel, Noise};
pub use model::{Linearised, Model};
pub(crate) use output::Tool;
pub use output::{FilterOutput, Keep};
pub use recording::{Inputs, KalmanRecording, KalmanSample};
pub use smoother::Smoother;
