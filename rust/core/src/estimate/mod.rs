//! Estimators: a model and a method.

pub mod kalman;
pub mod observer;
mod status;
pub mod velocity;

pub use status::Status;
