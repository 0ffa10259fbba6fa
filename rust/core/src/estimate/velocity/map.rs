//! Gains that depend on the posture.

use crate::check::{expect, expect_length};
use crate::error::DesignError;
use crate::linear::{add_scaled, dot};
use crate::scalar::{Scalar, exp_m1};

/// k(y) = P y + Σ aₘ sin(m·y) + bₘ cos(m·y), the observer's gain being ∂k/∂y (Cristofaro and De Luca 2023, Section 3.2).
///
/// Every such ∂k/∂y is a Jacobian, so that the observer needs no velocity: it takes differences of k itself.
///
/// ```
/// use linkside_core::estimate::velocity::{Gains, GainMap};
/// // One joint: 80 1/s where it points forwards, 40 where it points back.
/// let map = GainMap { linear: vec![60.0], waves: vec![1.0], sine: vec![20.0], cosine: vec![0.0] };
/// let gains = Gains::Mapped(map);
/// # drop(gains);
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct GainMap {
    /// P, n × n [1/s].
    pub linear: Vec<f64>,
    /// The waves m, one row of n each: whole numbers for revolute joints.
    pub waves: Vec<f64>,
    /// aₘ, one row of n each [1/s].
    pub sine: Vec<f64>,
    /// bₘ, one row of n each [1/s].
    pub cosine: Vec<f64>,
}

impl GainMap {
    /// # Errors
    /// Arrays that do not fit `n` joints or each other, a number that is not finite.
    pub(super) fn check(&self, n: usize) -> Result<(), DesignError> {
        let waves = self.waves.len().next_multiple_of(n);
        let parts = [
            ("the linear part of a gain map", &self.linear, n * n),
            ("the waves of a gain map", &self.waves, waves),
            ("the sine part of a gain map", &self.sine, waves),
            ("the cosine part of a gain map", &self.cosine, waves),
        ];
        for (what, values, expected) in parts {
            expect_length(what, values.len(), expected)?;
            for &value in values {
                expect(value.is_finite(), what, value, "a finite number")?;
            }
        }
        Ok(())
    }

    /// At least the largest ‖∂k/∂y‖ [1/s].
    pub(super) fn bound(&self) -> f64 {
        let n = self.linear.len().isqrt();
        let square = |row: &[f64]| dot(row, row);
        let parts = self.sine.chunks_exact(n).zip(self.cosine.chunks_exact(n));
        let waves = self.waves.chunks_exact(n).zip(parts);
        square(&self.linear).sqrt() + waves.map(|(m, (a, b))| (square(m) * (square(a) + square(b))).sqrt()).sum::<f64>()
    }

    /// ∂k/∂y at `to` (n × n), and k(`to`) − k(`to` − `by`) (n).
    #[inline(always)]
    pub(super) fn evaluate(&self, to: &[f64], by: &[f64], jacobian: &mut [f64], change: &mut [f64]) {
        let n = to.len();
        jacobian.copy_from_slice(&self.linear);
        for (out, row) in change.iter_mut().zip(self.linear.chunks_exact(n)) {
            *out = dot(row, by);
        }
        let parts = self.sine.chunks_exact(n).zip(self.cosine.chunks_exact(n));
        for (wave, (sine, cosine)) in self.waves.chunks_exact(n).zip(parts) {
            let phase = dot(wave, to);
            let (s, c) = Scalar::sin_cos(phase);
            let (s_before, c_before) = Scalar::sin_cos(phase - dot(wave, by));
            for i in 0..n {
                change[i] += sine[i] * (s - s_before) + cosine[i] * (c - c_before);
                add_scaled(&mut jacobian[i * n..][..n], sine[i] * c - cosine[i] * s, wave);
            }
        }
    }
}

/// Room for what a map does with an innovation.
#[derive(Clone, Debug)]
pub(super) struct Mapped {
    /// k(y) and its Jacobian.
    map: GainMap,
    /// T/2 [s].
    half: f64,
    /// Scratch: 1 + ½ T ∂k/∂y (n × n), and the change that is looked for (n).
    matrix: Vec<f64>,
    change: Vec<f64>,
}

impl Mapped {
    pub(super) fn new(map: GainMap, period: f64) -> Self {
        let (matrix, change) = (vec![0.0; map.linear.len()], vec![0.0; map.linear.len().isqrt()]);
        Self { map, half: 0.5 * period, matrix, change }
    }

    /// The largest share of an error of velocity that is taken in a period.
    pub(super) fn share(&self) -> f64 {
        -exp_m1(-self.map.bound() * 2.0 * self.half)
    }

    /// What the `innovation` (n) of a `position` (n) adds to the velocity: (I + ½ T ∂k/∂y)⁻¹ times the change of k.
    ///
    /// The implicit midpoint rule: where M ∂k/∂y has a positive symmetric part the error shrinks at any rate of samples.
    #[inline(always)]
    pub(super) fn weigh(&mut self, position: &[f64], innovation: &[f64]) -> &[f64] {
        let Self { map, half, matrix, change } = self;
        map.evaluate(position, innovation, matrix, change);
        let n = position.len();
        for entry in matrix.iter_mut() {
            *entry *= *half;
        }
        for i in 0..n {
            matrix[i * n + i] += 1.0;
        }
        eliminate(matrix, change);
        change
    }
}

/// Solves a x = b in place by Gauss's elimination with row pivots; `a` is lost.
#[inline(always)]
fn eliminate(a: &mut [f64], b: &mut [f64]) {
    let n = b.len();
    for k in 0..n {
        let size = |i: &usize| a[i * n + k].abs();
        let pivot = (k..n).max_by(|i, j| size(i).total_cmp(&size(j))).unwrap_or(k);
        b.swap(k, pivot);
        for j in k..n {
            a.swap(k * n + j, pivot * n + j);
        }
        let (above, below) = a.split_at_mut((k + 1) * n);
        let row = &above[k * n..];
        let (solved, open) = b.split_at_mut(k + 1);
        for (other, value) in below.chunks_exact_mut(n).zip(open) {
            let factor = other[k] / row[k];
            add_scaled(&mut other[k..], -factor, &row[k..]);
            *value -= factor * solved[k];
        }
    }
    for k in (0..n).rev() {
        let sum = dot(&a[k * n + k + 1..][..n - k - 1], &b[k + 1..]);
        b[k] = (b[k] - sum) / a[k * n + k];
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn map() -> impl Strategy<Value = (GainMap, Vec<f64>, Vec<f64>)> {
        let numbers = |count| prop::collection::vec(-2.0..2.0, count);
        (1..6usize, 0..4usize).prop_flat_map(move |(n, count)| {
            let waves = prop::collection::vec((-3..4i32).prop_map(f64::from), count * n);
            (numbers(n * n), waves, numbers(count * n), numbers(count * n), numbers(n), numbers(n))
                .prop_map(|(linear, waves, sine, cosine, y, by)| (GainMap { linear, waves, sine, cosine }, y, by))
        })
    }

    fn evaluate(map: &GainMap, to: &[f64], by: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let (mut jacobian, mut change) = (vec![0.0; map.linear.len()], vec![0.0; to.len()]);
        map.evaluate(to, by, &mut jacobian, &mut change);
        (jacobian, change)
    }

    proptest! {
        #[test]
        fn the_jacobian_is_the_slope_of_the_change((map, y, by) in map()) {
            let n = y.len();
            let (jacobian, _) = evaluate(&map, &y, &by);
            let small: Vec<f64> = by.iter().map(|x| 1e-7 * x).collect();
            let (_, change) = evaluate(&map, &y, &small);
            for i in 0..n {
                prop_assert!((change[i] - dot(&jacobian[i * n..][..n], &small)).abs() < 1e-10);
            }
        }

        #[test]
        fn the_bound_holds((map, y, by) in map()) {
            let n = y.len();
            let (jacobian, _) = evaluate(&map, &y, &by);
            let largest = nalgebra::DMatrix::from_row_slice(n, n, &jacobian).singular_values().max();
            prop_assert!(largest <= map.bound() * (1.0 + 1e-12));
        }

        #[test]
        fn elimination_solves((map, y, by) in map()) {
            let n = y.len();
            let matrix = nalgebra::DMatrix::from_row_slice(n, n, &map.linear);
            prop_assume!(matrix.singular_values().min() > 1e-3);
            let (mut a, mut b) = (map.linear.clone(), by.clone());
            eliminate(&mut a, &mut b);
            let back = matrix * nalgebra::DVector::from_vec(b);
            prop_assert!(back.iter().zip(&by).all(|(x, y)| (x - y).abs() < 1e-9));
        }
    }
}
