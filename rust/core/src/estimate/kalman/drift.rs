//! The channels' biases over a step of time, apart from all else: each forgets, and wanders.

use super::gaussian::{Gaussian, Symmetric};
use crate::estimate::bias::{BiasStep, bias_step};
use crate::linear::Real;
use core::ops::Range;

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
        let mut of_one = (f64::NAN, BiasStep { decay: 1.0, variance: 0.0 });
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
        // Diagonal in biases: F scales their rows and columns, so that the dense part of the state is not touched.
        self.scale(covariance, dt);
        for (b, decay, variance) in self.steps(dt) {
            mean[b] *= decay;
            covariance.data[b * covariance.stride + b] += variance;
        }
    }

    /// The adjoint of [`predict`](Self::predict), without the noise.
    #[inline(always)]
    pub(super) fn retreat(&self, lambda: &mut [f64], information: &mut Symmetric, dt: f64) {
        self.scale(information, dt);
        self.steps(dt).for_each(|(b, decay, _)| lambda[b] *= decay);
    }

    /// Rows and columns of the biases times their decay, those that follow each other and decay alike at once.
    #[inline(always)]
    fn scale(&self, p: &mut Symmetric, dt: f64) {
        let (mut run, mut factor) = (0..0, 1.0);
        for (b, decay, _) in self.steps(dt) {
            if b != run.end || decay != factor {
                scale(p, run, factor);
                (run, factor) = (b..b, decay);
            }
            run.end = b + 1;
        }
        scale(p, run, factor);
    }

    /// Columns (states × `stride`) through the step: each bias' row decays. It is its own adjoint.
    #[inline(always)]
    pub(super) fn carry<T: Real>(&self, columns: &mut [T], stride: usize, dt: f64) {
        for (b, decay, _) in self.steps(dt) {
            for x in &mut columns[b * stride..][..stride] {
                *x *= T::of(decay);
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

/// Rows and columns of these states times `factor`.
#[inline(always)]
fn scale(p: &mut Symmetric, states: Range<usize>, factor: f64) {
    if factor == 1.0 {
        return;
    }
    p.data[states.start * p.stride..states.end * p.stride].iter_mut().for_each(|x| *x *= factor);
    for row in p.data.chunks_exact_mut(p.stride).take(p.n) {
        row[states.clone()].iter_mut().for_each(|x| *x *= factor);
    }
}
