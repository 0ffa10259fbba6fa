//! After a choice of particles: copies are spread again, and the cloud gets back the mean and covariance that it had.
//!
//! A choice at random moves the cloud's mean, and these errors add up where the readings say little; copies of one
//! particle stay copies where there is no process noise. Both are undone by x ← m + L (a L₁⁻¹ (x − m₁) + h ζ) with
//! a² + h² = 1: shrunk and spread by a normal kernel (Liu and West 2001), from the moments m₁, L₁ L₁ᵀ that chance left
//! to those that the weights said.

use super::cloud::{Block, Wide};
use super::proposal::draw;
use crate::random::Stream;
use crate::scalar::{Lanes, Scalar};
use crate::simd::Kernel;

/// Mean and lower factor of the covariance of a cloud.
#[derive(Clone, Debug)]
pub(super) struct Moments {
    /// Weighted mean (entries).
    pub(super) mean: Vec<f64>,
    /// L by rows, with L Lᵀ the covariance; a column of zeros where there is no spread that is not others'.
    pub(super) factor: Vec<f64>,
}

/// A spread this small, as a part of the variance, is rounding.
const ROUNDING: f64 = 1e-13;

impl Moments {
    pub(super) fn new(entries: usize) -> Self {
        Self { mean: vec![0.0; entries], factor: vec![0.0; entries * entries] }
    }

    /// L from the covariance's upper triangle by rows.
    pub(super) fn factorise(&mut self, covariance: &[f64]) {
        let n = self.mean.len();
        let l = &mut self.factor;
        let mut packed = covariance.iter();
        for j in 0..n {
            for i in j..n {
                l[i * n + j] = packed.next().copied().unwrap_or(0.0);
            }
        }
        for j in 0..n {
            // Cholesky's, column by column; a pivot that is rounding beside its own variance is a direction without
            // spread.
            let variance = l[j * n + j];
            for k in 0..j {
                let a = l[j * n + k];
                l[j * n + j] -= a * a;
            }
            let pivot = l[j * n + j];
            let root = if pivot > ROUNDING * variance { pivot.sqrt() } else { 0.0 };
            l[j * n + j] = root;
            for i in j + 1..n {
                for k in 0..j {
                    l[i * n + j] -= l[i * n + k] * l[j * n + k];
                }
                l[i * n + j] = if root > 0.0 { l[i * n + j] / root } else { 0.0 };
            }
        }
    }

    /// |L⁻¹ B|² and the number of columns of L, B in place.
    pub(super) fn measure(&self, b: &mut [f64]) -> (f64, usize) {
        let (n, l) = (b.len(), &self.factor);
        let (mut square, mut rank) = (0.0, 0);
        for i in 0..n {
            let known: f64 = (0..i).map(|k| l[i * n + k] * b[k]).sum();
            let root = l[i * n + i];
            b[i] = if root > 0.0 { (b[i] - known) / root } else { 0.0 };
            (square, rank) = (square + b[i] * b[i], rank + usize::from(root > 0.0));
        }
        (square, rank)
    }

    /// X of L Lᵀ X = B, in place; zero where L has no column.
    pub(super) fn solve(&self, b: &mut [f64]) {
        let (n, l) = (b.len(), &self.factor);
        let divided = |value: f64, root: f64| if root > 0.0 { value / root } else { 0.0 };
        for i in 0..n {
            let known: f64 = (0..i).map(|k| l[i * n + k] * b[k]).sum();
            b[i] = divided(b[i] - known, l[i * n + i]);
        }
        for i in (0..n).rev() {
            let known: f64 = (i + 1..n).map(|k| l[k * n + i] * b[k]).sum();
            b[i] = divided(b[i] - known, l[i * n + i]);
        }
    }
}

/// Spreads a block's particles.
pub(super) struct Regularise<'a> {
    /// Whose particles.
    pub(super) block: &'a mut Block,
    /// What the cloud's moments should be.
    pub(super) wanted: &'a Moments,
    /// What they are.
    pub(super) found: &'a Moments,
    /// h.
    pub(super) kernel: f64,
    /// Of the kernel's normal numbers.
    pub(super) stream: Stream,
}

impl Kernel for Regularise<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { block, wanted, found, kernel, stream } = self;
        let shrunk = (1.0 - kernel * kernel).sqrt();
        let d = wanted.mean.len();
        for group in 0..block.groups() {
            let items = block.items(group);
            draw(&stream, items, &mut block.scratch.normal[..d]);
            // L₁⁻¹ (x − m₁) by forward substitution, shrunk and spread, then m + L of it.
            let (deviation, normal) = (&mut block.scratch.before, &block.scratch.normal);
            for (a, row) in block.state.iter().take(d).enumerate() {
                let mut value = Lanes(row.0[group]) + -found.mean[a];
                let (earlier, own) = deviation.split_at_mut(a);
                for (b, other) in earlier.iter().enumerate() {
                    value -= *other * found.factor[a * d + b];
                }
                let root = found.factor[a * d + a];
                own[0] = if root > 0.0 { value * (1.0 / root) } else { Wide::default() };
            }
            for (standard, normal) in deviation.iter_mut().zip(normal) {
                *standard = *standard * shrunk + *normal * kernel;
            }
            for (a, row) in block.state.iter_mut().take(d).enumerate() {
                let mut value = Wide::constant(wanted.mean[a]);
                for (b, standard) in deviation[..=a].iter().enumerate() {
                    value += *standard * wanted.factor[a * d + b];
                }
                row.0[group] = value.0;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_factor_solves_and_leaves_out_what_follows_from_others() {
        let mut moments = Moments::new(3);
        // The second entry is twice the first.
        moments.factorise(&[1.0, 2.0, 0.5, 4.0, 1.0, 1.5]);
        assert_eq!(moments.factor[4], 0.0);
        let x = [0.7, 0.0, -0.4];
        let mut b = [x[0] + 0.5 * x[2], 2.0 * x[0] + x[2], 0.5 * x[0] + 1.5 * x[2]];
        moments.solve(&mut b);
        for (found, expected) in b.iter().zip(x) {
            assert!((found - expected).abs() < 1e-14, "{b:?}");
        }
    }
}
