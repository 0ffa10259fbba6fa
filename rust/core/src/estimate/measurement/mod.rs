//! What sensors read in a state, and how that changes with it: h(x) and its derivatives, written once.
//!
//! A channel's row is the text of `read`. It is generic three times over: over the scalar (`f64`, derivative numbers,
//! lanes), over what a model knows of its motors (`view`: a load behind a spring, or states of their own), and over
//! what is wanted (`wanted`: values, the whole Jacobian, or a Jacobian in which q̈ is itself a function of the state).
//! Filters, smoothers, particles, likelihood and simulator read it.
//!
//! To add a kind of sensor: a variant of [`Kind`] and of [`Channel`], and its row, all in one file.

mod channel;
mod evaluation;
mod low_pass;
mod motion;
mod view;
mod wanted;

pub use channel::{Channel, Kind};
pub(crate) use channel::{read, read_all};
pub use evaluation::Evaluation;
pub(crate) use low_pass::{low_pass, low_pass_or_none};
pub(crate) use motion::{LinkMotion, Loading, Sensing};
pub(crate) use view::{Driven, Elastic, MotorStand, OfDrives, Springs};
pub(crate) use wanted::{Chained, Jacobian, OutsideColumns, Values, Wanted};
