//! Arithmetic of a joint's few states.

use super::sampled::{JointState, ORDER};

/// A matrix of a joint's states by rows, zero beyond the order of its model.
pub(super) type JointMatrix = [JointState; ORDER];

/// The unit matrix.
pub(super) fn identity() -> JointMatrix {
    core::array::from_fn(|i| core::array::from_fn(|j| f64::from(u8::from(i == j))))
}

/// A B.
#[inline(always)]
pub(super) fn multiply(a: &JointMatrix, b: &JointMatrix) -> JointMatrix {
    core::array::from_fn(|i| core::array::from_fn(|j| (0..ORDER).map(|k| a[i][k] * b[k][j]).sum()))
}

/// A x.
#[inline(always)]
pub(super) fn apply(a: &JointMatrix, x: &JointState) -> JointState {
    a.map(|row| row.iter().zip(x).map(|(a, x)| a * x).sum())
}

/// x xᵀ.
#[inline(always)]
pub(super) fn square(x: &JointState) -> JointMatrix {
    x.map(|one| x.map(|other| one * other))
}

/// A P Aᵀ.
#[inline(always)]
pub(super) fn congruence(a: &JointMatrix, p: &JointMatrix) -> JointMatrix {
    let product = multiply(a, p);
    core::array::from_fn(|i| core::array::from_fn(|j| (0..ORDER).map(|k| product[i][k] * a[j][k]).sum()))
}

/// A += factor · B.
#[inline(always)]
pub(super) fn add_scaled(a: &mut JointMatrix, factor: f64, b: &JointMatrix) {
    for (row, other) in a.iter_mut().zip(b) {
        row.iter_mut().zip(other).for_each(|(a, b)| *a += factor * b);
    }
}
