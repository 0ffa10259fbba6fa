//! Estimators: a model and a method.

pub mod kalman;
pub mod observer;
pub mod particle;
mod status;

pub use status::Status;
