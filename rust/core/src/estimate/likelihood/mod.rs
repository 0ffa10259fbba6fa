//! What calibration compares recordings with: the links' [`Response`] to their motors, with its derivatives, and how
//! likely readings are under a robot's parameters.
//!
//! The density of a recording is the product of its readings' densities, each given those before it, and those are what a
//! Kalman filter computes (F. C. Schweppe, IEEE Trans. Information Theory 11, 1965). The filter is the one of
//! [`kalman`](super::kalman) on the jerk-driven model, written once more for sensors whose delay is a
//! parameter; both give the same likelihood.
//!
//! Missing readings, sensors that are late and biases are in it as they are in the filter; outliers count linearly
//! where [`LikelihoodSettings::huber`] says so.

mod density;
mod evaluation;
mod filter;
mod instants;
mod parameters;
mod recording;
mod response;

pub use density::{Likelihood, LikelihoodSettings};
pub use parameters::Parameter;
pub use recording::LikelihoodRecording;
pub use response::{MotorMotion, Responded, Response};
