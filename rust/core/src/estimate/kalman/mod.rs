//! Kalman filter and smoother, and the models that they run on.

mod correction;
mod driven;
mod elastic;
mod elastic_measurement;
mod filter;
mod gaussian;
mod jerk;
mod jerk_process;
mod late;
mod model;
mod output;
mod phases;
mod recording;
mod slope;
mod smoother;
mod transition;

pub use driven::{JerkDriven, JerkMeasurement};
pub use elastic::{Discretization, ElasticModel, ElasticNoise, ElasticProcess, ElasticSettings};
pub use elastic_measurement::ElasticMeasurement;
pub use filter::{ExtendedKalmanFilter, FilterSettings};
pub use gaussian::{Gaussian, Row, Symmetric};
pub use jerk::{JerkModel, Noise};
pub use jerk_process::JerkProcess;
pub use late::Lateness;
pub use model::{Linearised, Measurement, Model, Paired, Process, Report};
pub(crate) use output::Tool;
pub use output::{FilterOutput, Keep};
pub use phases::Phases;
pub(crate) use phases::{Linearise, Predict};
pub use recording::{Inputs, KalmanRecording, KalmanSample};
pub use smoother::Smoother;
