//! Kalman filter and smoother on the acceleration-driven model (Axelsson, Karlsson and Norrlöf 2012).

mod channels;
mod filter;
mod gaussian;
mod model;
mod output;
mod slope;
mod smoother;

pub use channels::{Channel, Evaluation};
pub use filter::{ExtendedKalmanFilter, FilterSettings, KalmanRecording, KalmanSample};
pub use gaussian::{Gaussian, Row, Symmetric};
pub use model::{Further, JerkModel, Noise};
pub use output::{FilterOutput, Keep};
pub use smoother::Smoother;
