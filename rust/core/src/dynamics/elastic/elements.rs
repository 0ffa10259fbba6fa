//! How the deflections of friction elements change.

use super::ElasticLayout;
use crate::robot::{FrictionElement, Robot};
use crate::scalar::Scalar;

/// A row of ∂ẋ/∂x: of a friction element's deflection.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ElementRow<T> {
    /// Which state it is.
    pub(crate) state: usize,
    /// Columns and entries: θ, θ̇, q̇ and its own.
    pub(crate) entries: [(usize, T); 4],
}

impl<T: Scalar> ElementRow<T> {
    pub(super) fn at(state: usize) -> Self {
        Self { state, entries: [(state, T::default()); 4] }
    }
}

/// ż of joint j's element at state k, and how it depends on the state.
#[inline(always)]
pub(super) fn element_row<T: Scalar>(
    robot: &Robot,
    layout: &ElasticLayout,
    x: &[T],
    (j, k, element): (usize, usize, &FrictionElement),
) -> (T, ElementRow<T>) {
    let (theta, dtheta, dq) = (layout.theta[j], layout.dtheta[j], layout.joints + j);
    let gear = robot.drives[j].ripple.output(x[theta]);
    let (rate, [by_slip, by_own]) = element.rate(x[k], gear.ratio * x[dtheta] - x[dq]);
    let turning = by_slip * gear.bend * x[dtheta];
    let entries = [(theta, turning), (dtheta, by_slip * gear.ratio), (dq, -by_slip), (k, by_own)];
    (rate, ElementRow { state: k, entries })
}
