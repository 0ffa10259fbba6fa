//! Late readings, by what they say of the present state.
//!
//! A late reading is of w, what its sensor holds, which follows from the path so far. A particle stands for the present
//! state x alone, so the reading has to be weighed by p(y | x, readings before). The joint density of x and w that the
//! Kalman filter beside has tells that: w − h(x), what has changed on the way through the sensor, is in the mean its
//! regression in x, and what this leaves is noise. As x moves in a way that readings before say nothing of, this is exact in
//! a linear model with normal noise; else h itself stays as it is for each particle, and only the change is linear.
//!
//! Nothing of the past is drawn for it. Draws made before their reading has come would meet it by chance alone.
//!
//! Readings of one past are correlated given x, so each is taken less what those before it tell, by L D Lᵀ of their
//! covariance: to all else they are then readings like any other, of channels that are mixed.

use super::cloud::Wide;
use crate::estimate::kalman::{Gaussian, JerkDriven, JerkModel};
use crate::estimate::measurement::Evaluation;
use crate::linear;

/// The late readings of a sample.
#[derive(Clone, Debug)]
pub(super) struct Past {
    /// Those that were read.
    pub(super) found: Vec<PastReading>,
    /// The factor of the covariance of x and w, by rows.
    joint: Vec<f64>,
    /// Where x is expected (states).
    centre: Vec<f64>,
    /// How each change depends on x (lines × states), and then how each mixed one does.
    rows: Vec<f64>,
    /// Covariance of what is left (lines × lines), and then L and D of it.
    left: Vec<f64>,
}

/// One late reading.
#[derive(Clone, Copy, Debug)]
pub(super) struct PastReading {
    pub(super) channel: usize,
    /// The reading, mixed with those before it.
    pub(super) value: f64,
    /// The change that is expected where x is.
    change: f64,
}

impl Past {
    /// Of the late sensors of `model`.
    pub(super) fn new(model: &JerkDriven) -> Self {
        let (lines, states) = (model.late_channels().count(), model.jerk_model().states());
        Self {
            found: Vec::with_capacity(lines),
            joint: vec![0.0; if lines > 0 { (states + lines).pow(2) } else { 0 }],
            centre: vec![0.0; states],
            rows: vec![0.0; lines * states],
            left: vec![0.0; lines * lines],
        }
    }

    /// Whether there is a late sensor.
    pub(super) fn is_empty(&self) -> bool {
        self.joint.is_empty()
    }

    /// Forgets the sample before.
    pub(super) fn clear(&mut self) {
        self.found.clear();
    }

    /// Takes over what the Kalman filter expects of late channels with a reading, before it has used that.
    pub(super) fn foretell(&mut self, model: &JerkDriven, belief: &Gaussian, readings: &[f64]) {
        self.clear();
        if self.is_empty() {
            return;
        }
        let Self { found, joint, centre, rows, left } = self;
        let d = centre.len();
        let read = || model.late_channels().filter(|line| !readings[line.channel].is_nan());
        let size = d + read().count();
        centre.copy_from_slice(&belief.mean[..d]);
        let states = || (0..d).chain(read().map(|line| line.state));
        for (row, r) in joint.chunks_exact_mut(size).zip(states()) {
            for (entry, c) in row.iter_mut().zip(states()) {
                *entry = belief.covariance.at(r, c);
            }
        }
        linear::cholesky(&mut joint[..size * size], size, size);
        let (own, others) = joint[..size * size].split_at(d * size);
        for (i, line) in read().enumerate() {
            let factor = &others[i * size..][..size];
            let row = &mut rows[i * d..][..d];
            regress(own, size, &factor[..d], row);
            for (j, other) in others.chunks_exact(size).enumerate() {
                left[i * (size - d) + j] = linear::dot(&factor[d..], &other[d..]);
            }
            for (slope, h) in row.iter_mut().zip(line.row) {
                *slope -= h;
            }
            let change = belief.mean[line.state] - line.prediction;
            found.push(PastReading { channel: line.channel, value: readings[line.channel], change });
        }
    }

    /// Takes correlations out, for readings with noise of `variance` of their own; gives each with the variance of its own.
    pub(super) fn decorrelate(&mut self, variance: impl Fn(usize) -> f64) -> impl Iterator<Item = (PastReading, f64)> {
        let Self { found, rows, left, centre, .. } = self;
        let (count, d) = (found.len(), centre.len());
        for (i, late) in found.iter().enumerate() {
            left[i * count + i] += variance(late.channel);
        }
        linear::factorise(&mut left[..count * count], count);
        for i in 1..count {
            let (done, own) = rows.split_at_mut(i * d);
            for (j, row) in done.chunks_exact(d).enumerate() {
                let part = left[i * count + j];
                linear::add_scaled(&mut own[..d], -part, row);
                found[i].value -= part * found[j].value;
                found[i].change -= part * found[j].change;
            }
        }
        found.iter().copied().zip(left.iter().copied().step_by(count + 1))
    }

    /// How each mixed reading depends on the state beside the links' own part (states).
    #[inline(always)]
    pub(super) fn row(&self, i: usize) -> &[f64] {
        let d = self.centre.len();
        &self.rows[i * d..][..d]
    }

    /// Turns what channels read at `state` into what late sensors do; with `slopes`, its derivatives as well.
    #[inline(always)]
    pub(super) fn mix(&self, model: &JerkModel, evaluation: &mut Evaluation<Wide>, state: &[Wide], slopes: bool) {
        let (n, count) = (3 * model.joints(), self.found.len());
        let Evaluation { prediction, jacobian, .. } = evaluation;
        for (i, late) in self.found.iter().enumerate() {
            for (j, before) in self.found[..i].iter().enumerate() {
                let part = self.left[i * count + j];
                let other = prediction[before.channel];
                prediction[late.channel] -= other * part;
                for k in 0..if slopes { n } else { 0 } {
                    let other = jacobian[before.channel * n + k];
                    jacobian[late.channel * n + k] -= other * part;
                }
            }
        }
        for (i, late) in self.found.iter().enumerate() {
            let row = self.row(i);
            let mut change = Wide::default() + late.change;
            for ((slope, x), centre) in row.iter().zip(state).zip(&self.centre) {
                change += (*x + -centre) * *slope;
            }
            prediction[late.channel] += change;
            for (entry, slope) in jacobian[late.channel * n..][..if slopes { n } else { 0 }].iter_mut().zip(row) {
                *entry = *entry + *slope;
            }
        }
    }
}

/// `out` = B L⁻¹ for a row B and the lower triangular L, rows of `stride`; zero where L has no column.
fn regress(l: &[f64], stride: usize, b: &[f64], out: &mut [f64]) {
    for k in (0..b.len()).rev() {
        let known: f64 = (k + 1..b.len()).map(|m| out[m] * l[m * stride + k]).sum();
        let pivot = l[k * stride + k];
        out[k] = if pivot > 0.0 { (b[k] - known) / pivot } else { 0.0 };
    }
}

#[cfg(test)]
#[allow(clippy::disallowed_methods)] // the oracle is the platform's
mod tests;
