//! An estimator and its robot in one file, and the estimator at work: all that a controller needs of linkside.
//!
//! Python, or `linkside compile robot.yaml --out robot.lsr`, writes the file. [`Estimator::read`] checks it and builds what it
//! describes; [`Estimator::step`] then takes a sample of named signals, and [`Estimator::get`] gives the estimate by name. What
//! it gives are the bits that Python gives. The C interface, `linkside-capi`, is these calls and no more.
//!
//! ```
//! use linkside_compiled::{Estimator, Sample, demo};
//!
//! # let file = demo::observer().to_bytes();
//! // In a controller: Estimator::read("robot.lsr")?
//! let mut estimator = Estimator::from_bytes(&file)?;
//! for _ in 0..100 {
//!     let sample = Sample { theta: &[0.1], tau: &[0.0], acceleration: &[0.0, 0.0, 9.81], ..Sample::default() };
//!     estimator.step(&sample)?;
//! }
//! let q = estimator.get("q").unwrap_or_default();
//! assert!((q[0] - 0.1).abs() < 1e-9 && estimator.status() == 0);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! [`description`] is what a file holds, as plain numbers: a program may also write one, with [`Description::to_bytes`].
// Nothing a user gives makes a panic: what cannot fail says why where it is.
#![deny(
    clippy::expect_used,
    clippy::panic,
    clippy::todo,
    clippy::unimplemented,
    clippy::unreachable,
    clippy::unwrap_used
)]

pub mod demo;
pub mod description;
mod estimator;
mod fields;
mod file;
mod filter;
mod sample;

pub use description::Description;
pub use estimator::Estimator;
pub use file::{FileError, VERSION};
pub use sample::{Sample, Signal};
