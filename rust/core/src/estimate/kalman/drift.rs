//! The channels' biases over a step of time, apart from all else: each forgets, and wanders.

use super::gaussian::{Gaussian, Symmetric};
use crate::estimate::bias::bias_step;

/// What is known of the channels' biases: the state that each is, and how it moves.
#[derive(Clone, Copy, Debug)]
pub(super) struct Biases<'a> {
    /// The state that is each channel's bias.
    pub(super) states: &'a [Option<usize>],
    /// By how much each wanders in one second.
    pub(super) walk: &'a [f64],
    /// Over which time each forgets [s]; infinite for one that does not.
    pub(super) time: &'a [f64],
}

impl Biases<'_> {
    /// State, decay and variance of each bias over `dt` [s].
    #[inline(always)]
    fn steps(&self, dt: f64) -> impl Iterator<Item = (usize, f64, f64)> {
        // Channels of a kind forget over the same time: a hyperbolic tangent for each time and not for each channel.
        let mut of_one = (f64::NAN, bias_step(1.0, 1.0, dt));
        self.states.iter().zip(self.walk).zip(self.time).filter_map(move |((state, &walk), &time)| {
            let b = (*state)?;
            if time != of_one.0 {
                of_one = (time, bias_step(1.0, time, dt));
            }
            Some((b, of_one.1.decay, walk * walk * of_one.1.variance))
        })
    }

    /// b ← decay b, and its noise into P.
    #[inline(always)]
    pub(super) fn predict(&self, belief: &mut Gaussian, dt: f64) {
        let Gaussian { mean, covariance } = belief;
        for (b, decay, variance) in self.steps(dt) {
            // Diagonal in biases: F scales one row and one column, so that the dense part of the state is not touched.
            mean[b] *= decay;
            scale(covariance, b, decay);
            covariance.data[b * covariance.stride + b] += variance;
        }
    }

    /// The adjoint of [`predict`](Self::predict), without the noise.
    #[inline(always)]
    pub(super) fn retreat(&self, lambda: &mut [f64], information: &mut Symmetric, dt: f64) {
        for (b, decay, _) in self.steps(dt) {
            lambda[b] *= decay;
            scale(information, b, decay);
        }
    }

    /// Columns (states × `stride`) through the step: each bias' row decays. It is its own adjoint.
    #[inline(always)]
    pub(super) fn carry(&self, columns: &mut [f64], stride: usize, dt: f64) {
        for (b, decay, _) in self.steps(dt) {
            for x in &mut columns[b * stride..][..stride] {
                *x *= decay;
            }
        }
    }

    /// One row a bias of the root of what [`predict`](Self::predict) adds to P; gives the rest of `rows`.
    #[inline(always)]
    pub(super) fn noise_rows<'r>(&self, rows: &'r mut [f64], stride: usize, dt: f64) -> &'r mut [f64] {
        let mut rest = rows;
        for (b, _, variance) in self.steps(dt) {
            let (row, after) = rest.split_at_mut(stride);
            row[b] = variance.sqrt();
            rest = after;
        }
        rest
    }
}

/// Row and column `b` times `factor`.
#[inline(always)]
fn scale(p: &mut Symmetric, b: usize, factor: f64) {
    if factor == 1.0 {
        return;
    }
    for k in 0..p.n {
        p.data[b * p.stride + k] *= factor;
    }
    for k in 0..p.n {
        p.data[k * p.stride + b] *= factor;
    }
}
