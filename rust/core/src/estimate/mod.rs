//! Estimators: a model and a method.

#![warn(clippy::disallowed_methods)] // no functions of the platform's library: clippy.toml

pub(crate) mod bias;
pub(crate) mod jerk_noise;
pub mod kalman;
pub mod likelihood;
pub mod measurement;
pub mod observer;
pub mod particle;
mod status;
pub mod velocity;

pub use status::Status;
