//! How links respond to the motion of their motors: what sensors would read if nothing but the motors moved the links.
//!
//! M(q) q̈ + C q̇ + g + friction + S θ̈ = φ(θ − q) + D(θ̇ − q̇) is driven by the motors' motion as it was recorded. The motors'
//! positions have no density here, so that nothing but the other sensors' readings can tell a spring. Derivatives in the
//! parameters and in the initial state are those of the discrete solution, exact, and share one linearisation.

mod equation;
mod links;
mod sensors;

pub use links::{MotorMotion, Responded, Response};
