//! Link-side state estimation for robots with elastic joints.
//!
//! | symbol | meaning | unit |
//! | --- | --- | --- |
//! | q, q̇, q̈ | link side | rad, or m where prismatic |
//! | θ, θ̇ | motor side, reflected through the gear to the link side | rad |
//! | τ | motor torque, likewise reflected | N m |
//! | K, D, B | stiffness, damping, motor inertia of a drive | N m/rad, N m s/rad, kg m² |
//! | S | inertial coupling of motors to links, strictly upper triangular | kg m² |
//! | M, C, g | links' inertia, Coriolis matrix (Christoffel), gravity torque | |
//!
//! From bottom to top: [`scalar`] numbers, [`spatial`] algebra, the [`robot`], its [`dynamics`], what is
//! [`estimate`]d with them, and [`control`]. The crate knows nothing of Python, allocates nothing in a step and does not panic there.
//!
//! Where to begin; each has an example that runs:
//!
//! | to | take |
//! | --- | --- |
//! | describe a robot | [`Robot`](robot::Robot), or [`demo::arm`] to try things on |
//! | follow links live, without their masses | [`AccelerationObserver`](estimate::observer::AccelerationObserver) |
//! | know the uncertainty of an estimate | [`ExtendedKalmanFilter`](estimate::kalman::ExtendedKalmanFilter) on [`JerkDriven`](estimate::kalman::JerkDriven), moved by jerk |
//! | the same from motor torques | … on [`ElasticModel`](estimate::kalman::ElasticModel), the elastic-joint dynamics |
//! | estimate a recording by all of its samples | [`Smoother`](estimate::kalman::Smoother) |
//! | expect outliers, limits, or beliefs that are not normal | [`ParticleFilter`](estimate::particle::ParticleFilter) |
//! | velocities of a rigid robot | [`VelocityObserver`](estimate::velocity::VelocityObserver) |
//! | make recordings with a known truth | [`simulate`](simulate::simulate) |
//! | find a robot's parameters | [`Likelihood`](estimate::likelihood::Likelihood), with its gradient |
//!
//! Filters and observers have `step` for a sample in a control loop and `run` for a recording, with the same bits; errors come before
//! anything has changed. Arrays are row-major, one row a sample; NaN is a reading that is missing.
// Nothing a user gives makes a panic: what cannot fail says why where it is.
#![deny(
    clippy::expect_used,
    clippy::panic,
    clippy::todo,
    clippy::unimplemented,
    clippy::unreachable,
    clippy::unwrap_used
)]

mod check;
pub mod control;
pub mod demo;
pub mod dynamics;
pub mod error;
pub mod estimate;
pub mod interrupt;
mod linear;
mod lu;
pub mod memory;
pub mod parallel;
mod random;
pub mod robot;
pub mod scalar;
pub mod simd;
pub mod simulate;
pub mod spatial;
