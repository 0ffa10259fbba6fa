//! The measurement update, one channel after the other.
//!
//! The likelihood has an update of its own, which changes the covariance after every reading: derivative numbers want few
//! operations. This one touches the covariance once a sample, in padded rows that fill a processor's registers, and keeps
//! each channel's gain for the smoother. Both are the same mathematics; a test holds them equal.

use super::gaussian::{Gaussian, Innovation, Row, SHARP, Symmetric};
use super::model::Model;
use crate::estimate::Status;
use crate::linear;
use crate::scalar::log;

/// Scratch and outcome of a measurement update.
///
/// One channel after the other equals all at once where their noise is independent, and needs no inverse of S; a
/// channel that is missing or shut out is a turn of the loop that does nothing.
#[derive(Clone, Debug)]
pub(super) struct Correction {
    /// Where the channels are linearised.
    pub(super) reference: Vec<f64>,
    /// H P, each row after the channels before it (channels × states, padded).
    projections: Vec<f64>,
    /// k and m = g − s k/2 of each channel (channels × states, padded).
    pub(super) gains: Vec<f64>,
    halves: Vec<f64>,
    /// One channel's row of H, padded.
    row: Vec<f64>,
    /// Whether P is updated reading by reading.
    sharp: bool,
    /// Each after the channels before it.
    pub(super) innovations: Vec<Innovation>,
    /// Innovations before any is used are this, lower triangular with a diagonal of 1, times `innovations`.
    pub(super) factors: Vec<f64>,
    /// Channels left out at this sample by the gate.
    pub(super) gated: Vec<bool>,
    /// Flags, normalised innovation squared, readings used and log-likelihood of the sample.
    pub(super) status: u8,
    pub(super) nis: f64,
    pub(super) used: u32,
    pub(super) log_likelihood: f64,
}

impl Correction {
    pub(super) fn new(model: &impl Model, stride: usize) -> Self {
        let m = model.channels();
        Self {
            reference: vec![0.0; model.dense()],
            projections: vec![0.0; m * stride],
            gains: vec![0.0; m * stride],
            halves: vec![0.0; m * stride],
            row: vec![0.0; stride],
            sharp: false,
            innovations: vec![Innovation::NONE; m],
            factors: vec![0.0; m * m],
            gated: vec![false; m],
            status: 0,
            nis: 0.0,
            used: 0,
            log_likelihood: 0.0,
        }
    }

    /// Uses `readings`, all channels linearised at the reference.
    ///
    /// For one row h, with g = P hᵀ, s = h g + r and any gain k, Joseph's form (1 − k h) P (1 − k h)ᵀ + k r kᵀ is
    /// P − k mᵀ − m kᵀ with m = g − s k/2: symmetric by construction, an error of k entering squared, nothing inverted.
    /// P itself is touched once, when all channels are through; until then each g is corrected by those before it. Where a
    /// reading tells far more than is known, that difference has no digits: then P is updated reading by reading, by products.
    #[inline(always)]
    pub(super) fn update(&mut self, model: &impl Model, belief: &mut Gaussian, readings: &[f64], gate: Option<f64>) {
        (self.status, self.nis, self.used, self.log_likelihood) = (0, 0.0, 0, 0.0);
        // All of H P in one product: a channel's own g is then its row less what the channels before it took.
        self.project(model, belief);
        self.sharp = self.is_sharp(model, belief, readings);
        for (i, &reading) in readings.iter().enumerate() {
            if self.sharp {
                self.project_anew(model, belief, i);
            }
            self.innovations[i] = if reading.is_nan() {
                self.status |= Status::BRIDGED;
                Innovation::NONE
            } else {
                self.innovate(model, belief, i, reading, gate)
            };
            self.use_channel(belief, i);
            if self.sharp && self.innovations[i].variance.is_finite() {
                let stride = belief.covariance.stride;
                let (projection, variance) = (&self.projections[i * stride..][..stride], self.innovations[i].variance);
                belief.covariance.condition(&self.row, projection, variance, model.variance(i));
            }
        }
        if !self.sharp {
            belief.covariance.subtract_outer(&self.gains, &self.halves);
        }
        if self.used == 0 {
            self.status |= Status::PREDICTED;
        }
    }

    /// Rows of H P.
    #[inline(always)]
    fn project(&mut self, model: &impl Model, belief: &Gaussian) {
        let Symmetric { stride, ref data, .. } = belief.covariance;
        linear::product(model.linearised().jacobian, model.dense(), data, stride, &mut self.projections);
        for (projection, bias) in self.projections.chunks_exact_mut(stride).zip(model.biases()) {
            if let Some(b) = *bias {
                linear::add_scaled(projection, 1.0, &data[b * stride..][..stride]);
            }
        }
    }

    /// Whether some reading's noise is lost beside the variance of its prediction.
    #[inline(always)]
    fn is_sharp(&self, model: &impl Model, belief: &Gaussian, readings: &[f64]) -> bool {
        let rows = self.projections.chunks_exact(belief.covariance.stride).zip(readings).enumerate();
        rows.filter(|(_, (_, reading))| !reading.is_nan())
            .any(|(i, (projection, _))| row(model, i).dot(projection) > SHARP * model.variance(i))
    }

    /// Channel `i`'s row of H P, by the covariance as it is now.
    #[inline(always)]
    fn project_anew(&mut self, model: &impl Model, belief: &Gaussian, i: usize) {
        let Symmetric { stride, ref data, .. } = belief.covariance;
        let (d, own) = (model.dense(), &mut self.row);
        own.fill(0.0);
        own[..d].copy_from_slice(row(model, i).dense);
        if let Some(b) = model.biases()[i] {
            own[b] = 1.0;
        }
        for (x, column) in self.projections[i * stride..][..stride].iter_mut().zip(data.chunks_exact(stride)) {
            *x = linear::dot(column, own);
        }
    }

    /// Channel `i`'s innovation after the channels before it; none when the gate shuts it out.
    #[inline(always)]
    fn innovate(
        &mut self,
        model: &impl Model,
        belief: &Gaussian,
        i: usize,
        reading: f64,
        gate: Option<f64>,
    ) -> Innovation {
        let stride = belief.covariance.stride;
        let row = row(model, i);
        let (before, own) = self.projections.split_at_mut(i * stride);
        let own = &mut own[..stride];
        for (j, earlier) in before.chunks_exact(stride).enumerate() {
            let variance = self.innovations[j].variance;
            if variance.is_finite() {
                // gᵢ ← gᵢ − (hᵢ gⱼ / sⱼ) gⱼ: the factors are also those of L in S = L D Lᵀ, which isolating a fault
                // wants.
                let factor = row.dot(earlier) / variance;
                self.factors[i * self.innovations.len() + j] = factor;
                if !self.sharp {
                    linear::add_scaled(own, -factor, earlier);
                }
            }
        }
        let variance = row.dot(own) + model.variance(i);
        let mut value = reading - model.linearised().prediction[i] - row.bias.map_or(0.0, |b| belief.mean[b]);
        // The channels stay linearised at the reference while the mean moves: h(x₀) + H (x̂ − x₀).
        for (k, h) in row.dense.iter().enumerate() {
            value -= h * (belief.mean[k] - self.reference[k]);
        }
        self.gated[i] |= gate.is_some_and(|g| value * value > g * g * variance);
        if self.gated[i] {
            self.status |= Status::GATED;
            return Innovation::NONE;
        }
        Innovation { value, variance }
    }

    /// Moves the mean by channel `i`'s innovation and readies what the covariance loses.
    #[inline(always)]
    fn use_channel(&mut self, belief: &mut Gaussian, i: usize) {
        let Innovation { value, variance } = self.innovations[i];
        let stride = belief.covariance.stride;
        let projection = &self.projections[i * stride..][..stride];
        let (gain, half) = (&mut self.gains[i * stride..][..stride], &mut self.halves[i * stride..][..stride]);
        if variance.is_infinite() {
            gain.fill(0.0);
            half.fill(0.0);
            return;
        }
        let precision = 1.0 / variance;
        for k in 0..stride {
            gain[k] = projection[k] * precision;
            half[k] = projection[k] - 0.5 * variance * gain[k];
        }
        linear::add_scaled(&mut belief.mean, value, gain);
        let squared = value * value / variance;
        self.nis += squared;
        self.used += 1;
        self.log_likelihood -= 0.5 * (squared + log(core::f64::consts::TAU * variance));
    }

    /// What is predicted against what is read, before any reading is used: differences and their standard deviations.
    pub(super) fn compare(
        &mut self,
        model: &impl Model,
        belief: &Gaussian,
        readings: &[f64],
        innovation: &mut [f64],
        std: &mut [f64],
    ) {
        self.project(model, belief);
        let stride = belief.covariance.stride;
        for (i, reading) in readings.iter().enumerate() {
            let row = row(model, i);
            let variance = row.dot(&self.projections[i * stride..][..stride]) + model.variance(i);
            let bias = row.bias.map_or(0.0, |b| belief.mean[b]);
            innovation[i] = reading - model.linearised().prediction[i] - bias;
            std[i] = variance.sqrt();
        }
    }
}

/// Channel `i`'s row of H.
#[inline(always)]
fn row(model: &impl Model, i: usize) -> Row<'_> {
    let d = model.dense();
    Row { dense: &model.linearised().jacobian[i * d..][..d], bias: model.biases()[i] }
}
