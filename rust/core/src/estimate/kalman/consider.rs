//! Parameters that count without being estimated: the Schmidt–Kalman filter in its sensitivity form.
//!
//! S. F. Schmidt (1966); the sensitivity of the error follows D. C. Woodbury and J. L. Junkins (2010), and what the
//! innovations say of the parameters is the second stage of B. Friedland's filter (IEEE Trans. Automatic Control 14,
//! 1969). Gains stay those of the filter without parameters, so its mean does not change.

use super::correction::Correction;
use super::gaussian::Symmetric;
use super::model::Model;
use super::uncertain::Tolerance;
use crate::linear;

/// Samples of one sum from which the noise that lasts is told.
const BLOCK: u32 = 32;
/// Blocks that such noise is averaged over.
const BLOCKS: f64 = 8.0;
/// One sample of so many teaches the parameters: neighbours hardly differ, and the filter keeps its speed.
const THIN: u32 = 4;

/// How the error of the state depends on the parameters, and what is known of these.
///
/// With Σ = ∂(x − x̂)/∂p, predicted by Σ⁻ = F Σ + Ψ and corrected by Σ = (1 − K H) Σ⁻ − K N, the covariance of the
/// error is P + Σ E[p pᵀ] Σᵀ. An innovation's mean is s p, s = H Σ⁻ + N, so innovations tell p: E[p pᵀ] is its second
/// moment about the values of robot.yaml, given all readings so far.
#[derive(Clone, Debug)]
pub(super) struct Consider {
    /// Parameters.
    pub(super) count: usize,
    /// Numbers between rows.
    pub(super) stride: usize,
    /// Σ, states × stride.
    pub(super) columns: Vec<f64>,
    /// s of each channel after those before it, channels × stride.
    pub(super) signatures: Vec<f64>,
    prior: Vec<f64>,
    /// E[p] given the readings.
    mean: Vec<f64>,
    /// Cov[p] given the readings.
    spread: Symmetric,
    /// E[p pᵀ].
    moment: Symmetric,
    /// Variance of the noise of each channel's innovations as it lasts, in multiples of the filter's.
    lasting: Vec<f64>,
    teaches: Vec<bool>,
    sums: Vec<f64>,
    taken: u32,
    gain: Vec<f64>,
    wide: Vec<f64>,
    /// Σ E[p pᵀ] Σᵀ of the first states.
    pub(super) total: Vec<f64>,
    /// Innovations less what the parameters explain, in their standard deviations; NaN where not used.
    pub(super) residuals: Vec<f64>,
    variances: Vec<f64>,
}

impl Consider {
    pub(super) fn new(model: &impl Model) -> Option<Self> {
        let tolerances = model.tolerances();
        let (count, m, states) = (tolerances.len(), model.channels(), model.states());
        let stride = count.next_multiple_of(linear::LANES);
        let mut consider = Self {
            count,
            stride,
            columns: vec![0.0; states * stride],
            signatures: vec![0.0; m * stride],
            prior: tolerances.iter().map(|Tolerance { std, .. }| std * std).collect(),
            mean: vec![0.0; stride],
            spread: Symmetric::zeros(stride),
            moment: Symmetric::zeros(stride),
            lasting: vec![0.0; m],
            teaches: (0..m).map(|i| model.teaches(i)).collect(),
            sums: vec![0.0; m],
            taken: 0,
            gain: vec![0.0; stride],
            wide: vec![0.0; states * stride],
            total: vec![0.0; states * states],
            residuals: vec![f64::NAN; m],
            variances: vec![1.0; m],
        };
        consider.reset();
        (count > 0).then_some(consider)
    }

    /// Forgets all that readings said.
    pub(super) fn reset(&mut self) {
        self.columns.fill(0.0);
        self.mean.fill(0.0);
        self.spread.data.fill(0.0);
        for (i, variance) in self.prior.iter().enumerate() {
            self.spread.put(i, i, *variance);
        }
        self.lasting.fill(1.0);
        self.sums.fill(0.0);
        self.taken = 0;
        self.moment.data.copy_from_slice(&self.spread.data);
    }

    /// Σ through the update that `correction` has done, one channel after the other, and what it says of the parameters.
    #[inline(always)]
    pub(super) fn update(&mut self, model: &mut impl Model, correction: &Correction, states: usize) {
        let (p, d) = (self.stride, model.dense());
        model.signatures(p, &mut self.signatures);
        let gains = correction.gains.len() / correction.innovations.len();
        for (i, innovation) in correction.innovations.iter().enumerate() {
            let own = &mut self.signatures[i * p..][..p];
            if innovation.variance.is_infinite() {
                own.fill(0.0);
                continue;
            }
            let row = &model.linearised().jacobian[i * d..][..d];
            for (h, column) in row.iter().zip(self.columns.chunks_exact(p)) {
                linear::add_scaled(own, *h, column);
            }
            if let Some(b) = model.biases()[i] {
                linear::add_scaled(own, 1.0, &self.columns[b * p..][..p]);
            }
            let gain = &correction.gains[i * gains..][..states];
            for (k, column) in gain.iter().zip(self.columns.chunks_exact_mut(p)) {
                linear::add_scaled(column, -k, own);
            }
        }
        self.weigh(correction);
    }

    /// Residuals of the innovations, the noise that lasts in them, and the parameters by them.
    #[inline(always)]
    fn weigh(&mut self, correction: &Correction) {
        self.taken += 1;
        let learn = self.taken.is_multiple_of(THIN);
        for (i, innovation) in correction.innovations.iter().enumerate() {
            if innovation.variance.is_infinite() {
                self.residuals[i] = f64::NAN;
                continue;
            }
            let weight = 1.0 / innovation.variance.sqrt();
            let signature = &self.signatures[i * self.stride..][..self.stride];
            let residual = (innovation.value - linear::dot(signature, &self.mean)) * weight;
            self.sums[i] += residual;
            if learn {
                let noise = self.lasting[i].max(1.0) * innovation.variance;
                for (g, row) in self.gain.iter_mut().zip(self.spread.data.chunks_exact(self.stride)) {
                    *g = linear::dot(row, signature);
                }
                let known = linear::dot(&self.gain, signature);
                self.variances[i] = 1.0 + known * weight * weight;
                if self.teaches[i] {
                    self.learn(residual / weight, noise + known);
                }
            }
            self.residuals[i] = residual / self.variances[i].sqrt();
        }
        if self.taken.is_multiple_of(BLOCK) {
            for (lasting, sum) in self.lasting.iter_mut().zip(&mut self.sums) {
                *lasting += (*sum * *sum / f64::from(BLOCK) - *lasting) / BLOCKS;
                *sum = 0.0;
            }
        }
        if learn {
            self.moment.data.copy_from_slice(&self.spread.data);
            let doubt = self.doubt_of_model();
            for (m, row) in self.mean.iter().zip(self.moment.data.chunks_exact_mut(self.stride)) {
                linear::add_scaled(row, *m, &self.mean);
                row.iter_mut().for_each(|x| *x *= doubt);
            }
        }
    }

    /// Deviation of what lasts and no parameter explains, in deviations of the noise; at least 1. As long as it is there,
    /// the error that the parameters tell of is not all of the model's.
    #[inline(always)]
    fn doubt_of_model(&self) -> f64 {
        let (mut sum, mut count) = (0.0, 0.0);
        for (lasting, _) in self.lasting.iter().zip(&self.teaches).filter(|(_, teaches)| **teaches) {
            (sum, count) = (sum + lasting, count + 1.0);
        }
        if count > 0.0 { f64::max(sum / count, 1.0).sqrt() } else { 1.0 }
    }

    /// Kalman's update of the parameters by a residual of this variance, the gain holding Cov[p] s.
    #[inline(always)]
    fn learn(&mut self, residual: f64, variance: f64) {
        linear::add_scaled(&mut self.mean, residual / variance, &self.gain);
        for (g, row) in self.gain.iter().zip(self.spread.data.chunks_exact_mut(self.stride)) {
            linear::add_scaled(row, -g / variance, &self.gain);
        }
    }

    /// Σ E[p pᵀ] Σᵀ of the first `rows` states, into [`total`](Self::total), rows apart by `rows`.
    #[inline(always)]
    pub(super) fn sum_up(&mut self, rows: usize) {
        let Self { columns, moment, wide, total, stride, .. } = self;
        spread_of(&columns[..rows * *stride], moment, rows, wide, total);
    }

    pub(super) fn moment(&self) -> &Symmetric {
        &self.moment
    }

    /// Normalised innovation squared, with what the parameters explain and what they may.
    #[inline(always)]
    pub(super) fn nis(&self) -> f64 {
        self.residuals.iter().filter(|r| r.is_finite()).map(|r| r * r).sum()
    }

    /// E[s · p] for a signature s.
    #[inline(always)]
    pub(super) fn explained(&self, signature: &[f64]) -> f64 {
        linear::dot(signature, &self.mean)
    }

    /// Var[s · p] for a signature s.
    #[inline(always)]
    pub(super) fn doubt(&self, signature: &[f64], gain: &mut [f64]) -> f64 {
        for (g, row) in gain.iter_mut().zip(self.spread.data.chunks_exact(self.stride)) {
            *g = linear::dot(row, signature);
        }
        linear::dot(gain, signature)
    }

    /// By how much the parameters widen the standard deviation of channel `i`'s innovation.
    #[inline(always)]
    pub(super) fn factor(&self, i: usize) -> f64 {
        self.variances[i].sqrt()
    }

    /// E[p] and the standard deviations of p given the readings so far.
    pub(super) fn parameters(&self) -> (Vec<f64>, Vec<f64>) {
        let std = (0..self.count).map(|i| self.spread.at(i, i).max(0.0).sqrt()).collect();
        (self.mean[..self.count].to_vec(), std)
    }
}

/// `out` ← C E[p pᵀ] Cᵀ for the first `rows` of `columns`.
#[inline(always)]
pub(super) fn spread_of(columns: &[f64], moment: &Symmetric, rows: usize, wide: &mut [f64], out: &mut [f64]) {
    let p = moment.stride;
    linear::product(&columns[..rows * p], p, &moment.data, p, wide);
    for r in 0..rows {
        for c in r..rows {
            out[r * rows + c] = linear::dot(&wide[r * p..][..p], &columns[c * p..][..p]);
            out[c * rows + r] = out[r * rows + c];
        }
    }
}
