//! How likely recordings are under a robot's parameters, with the exact gradient: what calibration maximises.
//!
//! The density of a recording is the product of its readings' densities, each given those before it, and those are what a
//! Kalman filter computes (F. C. Schweppe, IEEE Trans. Information Theory 11, 1965). The filter is the one of
//! [`kalman`](super::kalman) on the jerk-driven model, written once more over a [`Scalar`](crate::scalar::Scalar),
//! so that derivative numbers go through it; with `f64` both give the same likelihood.
//!
//! Missing readings, sensors that are late and biases are in it as they are in the filter; outliers count linearly
//! where [`LikelihoodSettings::huber`] says so. The gradient is that of forward mode: four parameters ride on each pass
//! ([`Dual<4>`](crate::scalar::Dual)), passes go to all cores, and no difference of two likelihoods is ever taken.

mod evaluation;
mod evidence;
mod filter;
mod instants;
mod parameters;
mod recording;
mod response;

pub use evidence::{Evidence, Likelihood, LikelihoodSettings};
pub use parameters::Parameter;
pub use recording::LikelihoodRecording;
pub use response::{MotorMotion, Responded, Response};
