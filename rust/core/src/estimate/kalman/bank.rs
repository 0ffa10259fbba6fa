//! What a fault that begins now would do to all later innovations of a filter.

use super::consider::Consider;
use super::correction::Correction;
use super::model::Model;
use crate::linear;

/// Generalised likelihood ratios of a step in each channel (A. S. Willsky and H. L. Jones, IEEE Trans. Automatic Control
/// 21, 1976), for an onset that moves on from window to window.
///
/// The state takes a fault up, so that it soon shows in other channels than its own: its signature is carried along with
/// the filter, s = H Σ⁻ + e_c with Σ as in the consider filter. Without a fault (Σ s r)²/Σ s² is χ² with one degree.
#[derive(Clone, Debug)]
pub(super) struct Bank {
    /// Samples of a window.
    length: u32,
    pub(super) age: u32,
    stride: usize,
    columns: Vec<f64>,
    own: Vec<f64>,
    /// Σ s r and Σ s² of each channel.
    score: Vec<f64>,
    information: Vec<f64>,
    channels: usize,
    /// Σ s sₚ of each channel with each parameter: what an error of a parameter would look like.
    parameters: usize,
    shared: Vec<f64>,
    gain: Vec<f64>,
}

impl Bank {
    pub(super) fn new(model: &impl Model, parameters: usize, length: u32) -> Self {
        let stride = model.channels().next_multiple_of(linear::LANES);
        let row = || vec![0.0; stride];
        Self {
            length,
            age: 0,
            stride,
            columns: vec![0.0; model.states() * stride],
            own: row(),
            score: row(),
            information: row(),
            channels: model.channels(),
            parameters: parameters.next_multiple_of(linear::LANES),
            shared: vec![0.0; stride * parameters.next_multiple_of(linear::LANES)],
            gain: vec![0.0; parameters.next_multiple_of(linear::LANES)],
        }
    }

    pub(super) fn restart(&mut self) {
        self.age = 0;
        self.columns.fill(0.0);
        self.score.fill(0.0);
        self.information.fill(0.0);
        self.shared.fill(0.0);
    }

    /// Takes a sample.
    #[inline(always)]
    pub(super) fn update(
        &mut self,
        model: &mut impl Model,
        dt: f64,
        correction: &Correction,
        consider: Option<&Consider>,
    ) {
        if self.age == self.length {
            self.restart();
        }
        self.age += 1;
        let (p, d) = (self.stride, model.dense());
        model.carry_noise_free(&mut self.columns, p, dt);
        let width = correction.gains.len() / self.channels;
        for (i, innovation) in correction.innovations.iter().enumerate().filter(|(_, v)| v.variance.is_finite()) {
            self.own.fill(0.0);
            self.own[i] = 1.0;
            let row = &model.linearised().jacobian[i * d..][..d];
            for (h, column) in row.iter().zip(self.columns.chunks_exact(p)) {
                linear::add_scaled(&mut self.own, *h, column);
            }
            if let Some(b) = model.biases()[i] {
                linear::add_scaled(&mut self.own, 1.0, &self.columns[b * p..][..p]);
            }
            let gain = &correction.gains[i * width..][..width];
            for (k, column) in gain.iter().zip(self.columns.chunks_exact_mut(p)) {
                linear::add_scaled(column, -k, &self.own);
            }
            let precision = 1.0 / innovation.variance;
            for (c, s) in self.own.iter().take(self.channels).enumerate() {
                self.score[c] += s * innovation.value * precision;
                self.information[c] += s * s * precision;
                if let Some(consider) = consider {
                    let q = self.parameters;
                    let signature = &consider.signatures[i * q..][..q];
                    linear::add_scaled(&mut self.shared[c * q..][..q], s * precision, signature);
                }
            }
        }
    }

    /// The channel whose fault explains most, its likelihood ratio (χ² with one degree) and the size of the fault: of what
    /// the parameters do not explain, within what they may explain yet. Exact only where it is beyond `bound`.
    #[inline(always)]
    pub(super) fn worst(&mut self, consider: Option<&Consider>, bound: f64) -> (usize, f64, f64) {
        let (mut worst, q) = ((0, 0.0, 0.0), self.parameters);
        for c in 0..self.channels {
            let shared = &self.shared[c * q..][..q];
            let score = self.score[c] - consider.map_or(0.0, |consider| consider.explained(shared));
            let mut variance = self.information[c].max(f64::MIN_POSITIVE);
            if let Some(consider) = consider.filter(|_| score * score > bound * variance) {
                variance += consider.doubt(shared, &mut self.gain);
            }
            let ratio = score * score / variance;
            if ratio > worst.1 {
                worst = (c, ratio, score / self.information[c]);
            }
        }
        worst
    }
}
