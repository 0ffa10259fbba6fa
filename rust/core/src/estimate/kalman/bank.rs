//! What a fault that begins now would do to all later innovations of a filter.

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
}

impl Bank {
    pub(super) fn new(model: &impl Model, length: u32) -> Self {
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
        }
    }

    pub(super) fn restart(&mut self) {
        self.age = 0;
        self.columns.fill(0.0);
        self.score.fill(0.0);
        self.information.fill(0.0);
    }

    /// Takes a sample with its residuals, each in standard deviations `std` of its innovation.
    #[inline(always)]
    pub(super) fn update(
        &mut self,
        model: &mut impl Model,
        dt: f64,
        correction: &Correction,
        residuals: &[f64],
        std: &[f64],
    ) {
        if self.age == self.length {
            self.restart();
        }
        self.age += 1;
        let (p, d) = (self.stride, model.dense());
        model.carry_noise_free(&mut self.columns, p, dt);
        let width = correction.gains.len() / residuals.len();
        for (i, residual) in residuals.iter().enumerate().filter(|(_, r)| r.is_finite()) {
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
            let weight = 1.0 / std[i];
            for (c, own) in self.own.iter().enumerate() {
                let s = own * weight;
                self.score[c] += s * residual;
                self.information[c] += s * s;
            }
        }
    }

    /// The channel whose fault explains most, its likelihood ratio (χ² with one degree) and the size of the fault.
    #[inline(always)]
    pub(super) fn worst(&self, channels: usize) -> (usize, f64, f64) {
        let mut worst = (0, 0.0, 0.0);
        for c in 0..channels {
            let ratio = self.score[c] * self.score[c] / self.information[c].max(f64::MIN_POSITIVE);
            if ratio > worst.1 {
                worst = (c, ratio, self.score[c] / self.information[c]);
            }
        }
        worst
    }
}
