//! An estimator and its robot in one file, and the estimator at work: all that a controller needs of linkside.
//!
//! Python, or `linkside compile robot.yaml --out robot.lsr`, writes the file. [`Estimator::read`] checks it and builds what it
//! describes; [`Estimator::step`] then takes a sample of named signals, and [`Estimator::get`] gives the estimate by name. What
//! it gives are the bits that Python gives. The C interface, `linkside-capi`, is these calls and no more.
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
