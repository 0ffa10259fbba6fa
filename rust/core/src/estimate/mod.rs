//! Estimators: a model and a method.
//!
//! | folder | model | method |
//! | --- | --- | --- |
//! | [`observer`] | motor and spring of each joint, link accelerations measured | pole placement |
//! | [`kalman`] | links moved by jerk; or links and motors moved by torques | extended Kalman filter and smoother |
//! | [`particle`] | links moved by jerk | particles, a part of the state in closed form if wanted |
//! | [`velocity`] | rigid joints | reduced-order and full-order observers |
//! | [`likelihood`] | links moved by jerk, the robot's numbers as parameters | Kalman filter |
//!
//! What sensors read, [`measurement`], is written once for all of them.

#![warn(clippy::disallowed_methods)] // no functions of the platform's library: clippy.toml

pub(crate) mod bias;
pub(crate) mod jerk_noise;
pub mod kalman;
pub mod likelihood;
pub mod measurement;
pub mod observer;
pub mod particle;
pub(crate) mod slip;
mod status;
pub mod velocity;

pub use status::Status;
