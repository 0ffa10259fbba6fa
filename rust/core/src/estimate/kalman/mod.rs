//! Kalman filter and smoother, and the models that they run on.

mod bank;
mod consider;
mod consider_back;
mod correction;
mod driven;
mod elastic;
mod filter;
mod gaussian;
mod jerk;
mod model;
mod monitor;
mod output;
mod phases;
mod recording;
mod signal;
mod slope;
mod smoother;
mod transition;
mod uncertain;

pub use driven::JerkDriven;
pub use elastic::{Discretization, ElasticModel, ElasticNoise, ElasticSettings};
pub use filter::{ExtendedKalmanFilter, FilterSettings};
pub use gaussian::{Gaussian, Row, Symmetric};
pub use jerk::{JerkModel, Noise};
pub use model::{Linearised, Model};
pub use monitor::Finding;
pub(crate) use output::Tool;
pub use output::{FilterOutput, Keep};
pub use phases::Phases;
pub(crate) use phases::{Linearise, Predict};
pub use recording::{Inputs, KalmanRecording, KalmanSample};
pub use signal::Fault;
pub use smoother::Smoother;
pub use uncertain::{Tolerance, Uncertain};
