//! Estimators: a model and a method.

pub(crate) mod jerk_noise;
pub mod kalman;
pub mod likelihood;
pub mod measurement;
pub mod observer;
pub mod particle;
mod status;
pub mod velocity;

pub use status::Status;
