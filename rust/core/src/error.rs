//! What can be wrong with what a user gives us. Below the boundary kernels do not fail.

use thiserror::Error;

/// A robot that cannot be computed with.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum RobotError {
    /// No moving body.
    #[error("the robot has no moving joint")]
    NoBodies,
    /// A body before its parent.
    #[error("body {body} comes before its parent {parent}")]
    Order {
        /// The body.
        body: usize,
        /// Its parent.
        parent: usize,
    },
    /// A joint index twice, or none for a joint.
    #[error("joint {joint} must move exactly one body, it moves {count}")]
    Joint {
        /// The joint.
        joint: usize,
        /// How many bodies it moves.
        count: usize,
    },
    /// An axis that is not of length one.
    #[error("the axis of body {body} has length {length}, expected 1")]
    Axis {
        /// The body.
        body: usize,
        /// The axis' length.
        length: f64,
    },
    /// A quantity out of its range.
    #[error("{what} of {owner} is {value}, expected {expected}")]
    Range {
        /// Which quantity.
        what: &'static str,
        /// Whose.
        owner: String,
        /// Its value.
        value: f64,
        /// What was expected.
        expected: &'static str,
    },
    /// A frame on a body that does not exist.
    #[error("{owner} is on body {body}, there are {count}")]
    Body {
        /// Which frame.
        owner: String,
        /// The body it names.
        body: usize,
        /// How many there are.
        count: usize,
    },
    /// Arrays that do not fit together.
    #[error("{what} has {found} entries, expected {expected}")]
    Length {
        /// Which array.
        what: &'static str,
        /// Its length.
        found: usize,
        /// What was expected.
        expected: usize,
    },
}
