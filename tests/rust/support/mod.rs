//! What tests of random robots share: the robots, every kernel in one place, comparison.

mod compare;
mod kernels;
mod trees;

pub(crate) use compare::{check_close, check_same_bits};
pub(crate) use kernels::{DIRECTIONS, Kernels, State, gradients, multiply, packed, transposed, varied};
pub(crate) use trees::{Case, balanced_cases, cases, config, rigid_body, vectors};
