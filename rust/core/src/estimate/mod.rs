//! Estimators: a model and a method.

pub mod kalman;
pub mod likelihood;
pub mod observer;
pub mod particle;
mod status;

pub use status::Status;
