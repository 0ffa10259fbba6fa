//! The measurement update: the channels of a sample one after the other, in padded rows that fill a processor's registers.
//!
//! Each channel's row of W, after those before it, is kept for the smoother. Where errors of channels depend on each other, as
//! after a regression on sigma points, all are used by one factor of [S, e]. The likelihood has an update of its own,
//! for sensors whose delay is a parameter; a test holds them equal.

use super::gaussian::{Gaussian, Innovation, Row, SHARP};
use super::loss::{LEFT_OUT, SensorLosses};
use super::model::Model;
use crate::estimate::Status;
use crate::linear;
use crate::scalar::log;
use core::ops::Range;

mod one_by_one;

/// A sensor that was left out so many samples in a row is no longer: either it or the estimate is wrong for good, and outliers
/// are not that many.
const LONGEST: u32 = 8;

/// Scratch and outcome of a measurement update.
///
/// Everything of a channel is what the channels before it leave, in its standard deviations: W = U⁻ᵀ H P and U⁻ᵀ e with
/// S = Uᵀ U. That needs no inverse of S, and a channel that is missing or shut out is a row of zeros.
#[derive(Clone, Debug)]
pub(super) struct Correction {
    /// Where the channels are linearised.
    pub(super) reference: Vec<f64>,
    /// H P, and then W (channels × states, padded).
    rows: Vec<f64>,
    /// One channel's row of H, padded; scratch.
    row: Vec<f64>,
    /// By how much the readings move the mean, padded.
    change: Vec<f64>,
    /// Innovations before any channel is used; NaN of those that are not read.
    pub(super) raw: Vec<f64>,
    /// Hᵀ (dense × channels, padded), and H P Hᵀ (channels × channels, padded).
    turned: Vec<f64>,
    shares: Vec<f64>,
    /// [S, e], and then U and U⁻ᵀ e (channels × channels and one more, padded).
    factor: Vec<f64>,
    /// Each after the channels before it.
    pub(super) innovations: Vec<Innovation>,
    /// The same in standard deviations, zero where not used (channels).
    values: Vec<f64>,
    /// How much each channel counts: the variance of its noise is divided by it (channels).
    pub(super) weights: Vec<f64>,
    /// How many samples in a row each channel was left out by its weight (channels).
    runs: Vec<u32>,
    /// Variance of each channel's noise as it was used (channels).
    pub(super) variances: Vec<f64>,
    /// Whether channels were used one by one although errors depend on each other, each with all of what a regression leaves in its
    /// own variance.
    pub(super) sharp: bool,
    /// Channels left out at this sample by the gate.
    pub(super) gated: Vec<bool>,
    /// Flags, normalised innovation squared, readings used and log-likelihood of the sample.
    pub(super) status: u8,
    pub(super) nis: f64,
    pub(super) used: u32,
    pub(super) log_likelihood: f64,
}

/// A sample's readings, and whether the belief has them in it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Readings<'a> {
    pub(super) values: &'a [f64],
    pub(super) used: bool,
}

impl Correction {
    pub(super) fn new(model: &impl Model, stride: usize) -> Self {
        let m = model.channels();
        let own = m.next_multiple_of(linear::LANES);
        Self {
            reference: vec![0.0; model.dense()],
            rows: vec![0.0; own * stride],
            row: vec![0.0; stride],
            change: vec![0.0; stride],
            raw: vec![0.0; m],
            turned: vec![0.0; model.dense() * own],
            shares: vec![0.0; own * own],
            factor: vec![0.0; own * (own + linear::LANES)],
            innovations: vec![Innovation::NONE; m],
            values: vec![0.0; m],
            weights: vec![1.0; m],
            runs: vec![0; m],
            variances: vec![0.0; m],
            sharp: false,
            gated: vec![false; m],
            status: 0,
            nis: 0.0,
            used: 0,
            log_likelihood: 0.0,
        }
    }

    /// Uses `readings`, all channels linearised at the reference.
    #[inline(always)]
    pub(super) fn update(&mut self, model: &impl Model, belief: &mut Gaussian, readings: &[f64], gate: Option<f64>) {
        (self.status, self.nis, self.used, self.log_likelihood) = (0, 0.0, 0, 0.0);
        for (i, (variance, weight)) in self.variances.iter_mut().zip(&self.weights).enumerate() {
            *variance = model.variance(i) / weight;
        }
        self.read(model, belief, readings);
        self.sharp = false;
        if let Some(left) = model.residual() {
            self.project(model, belief);
            self.sharp = self.is_sharp(model);
            if self.sharp {
                // One by one, each must have its own: no less than that in any combination of channels.
                for (i, variance) in self.variances.iter_mut().enumerate() {
                    *variance += left.row(i).iter().map(|x| x.abs()).sum::<f64>();
                }
            }
        }
        if model.residual().is_none() || self.sharp {
            self.use_each(model, belief, gate);
        } else {
            self.add_residual(model);
            while !self.use_all(gate) {}
            linear::forward(&self.factor, self.width(), &mut self.rows, belief.covariance.stride);
            belief.covariance.add_squares(-1.0, self.rows());
            self.sum_up();
        }
        self.finish(belief);
    }

    /// Innovations before any channel is used; NaN of those that are not read.
    #[inline(always)]
    fn read(&mut self, model: &impl Model, belief: &Gaussian, readings: &[f64]) {
        // The channels stay linearised at the reference while the mean moves: h(x₀) + H (x̂ − x₀).
        for ((moved, x), x0) in self.row.iter_mut().zip(&belief.mean).zip(&self.reference) {
            *moved = x - x0;
        }
        for (i, (raw, reading)) in self.raw.iter_mut().zip(readings).enumerate() {
            let row = row(model, i);
            let bias = row.bias.map_or(0.0, |b| belief.mean[b]);
            *raw = reading - model.linearised().prediction[i] - bias - linear::dot(row.dense, &self.row);
            if raw.is_nan() {
                self.status |= Status::BRIDGED;
            }
        }
    }

    /// H P, and H P Hᵀ.
    #[inline(always)]
    fn project(&mut self, model: &impl Model, belief: &Gaussian) {
        let (m, stride) = (self.raw.len(), belief.covariance.stride);
        observe(model, &belief.covariance.data, stride, &mut self.rows[..m * stride]);
        self.share(model);
    }

    /// What the rows share with those of H, on and above the diagonal: rows · Hᵀ.
    #[inline(always)]
    fn share(&mut self, model: &impl Model) {
        let (m, own, stride) = (self.raw.len(), self.own(), self.row.len());
        for (i, row) in model.linearised().jacobian.chunks_exact(model.dense()).enumerate() {
            for (k, h) in row.iter().enumerate() {
                self.turned[k * own + i] = *h;
            }
        }
        linear::product_upper(&self.rows[..m * stride], stride, &self.turned, own, &mut self.shares[..m * own]);
        for (channels, first) in bias_runs(model.biases()) {
            for (shares, projection) in self.shares.chunks_exact_mut(own).zip(self.rows.chunks_exact(stride)).take(m) {
                linear::add_scaled(&mut shares[channels.clone()], 1.0, &projection[first..]);
            }
        }
    }

    /// W, one padded row for each channel.
    #[inline(always)]
    pub(super) fn rows(&self) -> &[f64] {
        &self.rows[..self.raw.len() * self.row.len()]
    }

    /// U and U⁻ᵀ e, in rows of [`width`](Self::width) numbers.
    #[inline(always)]
    pub(super) fn factor(&self) -> &[f64] {
        &self.factor
    }

    /// Numbers between rows of what has a column for each channel.
    #[inline(always)]
    fn own(&self) -> usize {
        self.raw.len().next_multiple_of(linear::LANES)
    }

    /// The same of the [`factor`](Self::factor), which has one more.
    #[inline(always)]
    pub(super) fn width(&self) -> usize {
        self.own() + linear::LANES
    }

    /// Whether some reading's noise is lost beside the variance of its prediction.
    #[inline(always)]
    fn is_sharp(&self, model: &impl Model) -> bool {
        let own = self.own();
        let mut read = self.raw.iter().enumerate().filter(|(_, raw)| !raw.is_nan());
        let left = |i: usize| model.residual().map_or(0.0, |left| left.at(i, i));
        read.any(|(i, _)| self.shares[i * own + i] > SHARP * (self.variances[i] + left(i)))
    }

    /// H P Hᵀ with what a regression leaves.
    #[inline(always)]
    fn add_residual(&mut self, model: &impl Model) {
        if let Some(left) = model.residual() {
            linear::add_scaled(&mut self.shares, 1.0, &left.data);
        }
    }

    /// All channels at once, by one factor; false if the gate has just rejected one, so that all must be repeated.
    #[inline(always)]
    fn use_all(&mut self, gate: Option<f64>) -> bool {
        let (m, own, width, stride) = (self.raw.len(), self.own(), self.width(), self.row.len());
        for (i, (row, shares)) in self.factor.chunks_exact_mut(width).zip(self.shares.chunks_exact(own)).enumerate() {
            row[..own].copy_from_slice(shares);
            if i < m {
                row[i] += self.variances[i];
                row[own] = self.raw[i];
            }
        }
        for i in (0..m).filter(|&i| self.raw[i].is_nan() || self.gated[i]) {
            (0..m).for_each(|j| self.factor[j.min(i) * width + j.max(i)] = 0.0);
            (self.factor[i * width + i], self.factor[i * width + own]) = (1.0, 0.0);
            self.rows[i * stride..][..stride].fill(0.0);
        }
        linear::upper_factor(&mut self.factor, m, width);
        let beyond = |row: &[f64]| gate.is_some_and(|gate| row[own].abs() > gate);
        if let Some(i) = self.factor.chunks_exact(width).position(beyond) {
            self.gated[i] = true;
            return false;
        }
        for (i, innovation) in self.innovations.iter_mut().enumerate() {
            let row = &self.factor[i * width..][..width];
            let open = !(self.raw[i].is_nan() || self.gated[i]);
            *innovation = if open { Innovation { value: row[own], std: row[i] } } else { Innovation::NONE };
        }
        true
    }

    /// What all innovations do to the mean: Wᵀ U⁻ᵀ e.
    #[inline(always)]
    fn sum_up(&mut self) {
        for (own, innovation) in self.values.iter_mut().zip(&self.innovations) {
            *own = innovation.value;
        }
        let stride = self.row.len();
        let rows = &self.rows[..self.values.len() * stride];
        linear::product(&self.values, self.values.len(), rows, stride, &mut self.change);
    }

    /// Moves the mean, and counts the readings that were used.
    #[inline(always)]
    fn finish(&mut self, belief: &mut Gaussian) {
        let mut spread = LogProduct::ONE;
        for (innovation, raw) in self.innovations.iter().zip(&self.raw) {
            if !innovation.is_used() {
                self.status |= if raw.is_nan() { 0 } else { Status::GATED };
                continue;
            }
            self.nis += innovation.value * innovation.value;
            self.used += 1;
            spread.times(innovation.std);
        }
        self.log_likelihood = -0.5 * (self.nis + f64::from(self.used) * LOG_TAU) - spread.log();
        linear::add_scaled(&mut belief.mean, 1.0, &self.change);
        if self.used == 0 {
            self.status |= Status::PREDICTED;
        }
    }

    /// How much each sensor counts, by the expected square of its errors; where nothing of the sample was used yet, by that of
    /// its innovations over what is expected of them.
    ///
    /// `raw` is then these squares: what is known of the readings themselves is read anew by the next update.
    #[inline(always)]
    pub(super) fn weigh(&mut self, model: &impl Model, belief: &Gaussian, read: Readings<'_>, sensors: &SensorLosses) {
        self.project(model, belief);
        self.add_residual(model);
        self.read(model, belief, read.values);
        let own = self.own();
        for (i, error) in self.raw.iter_mut().enumerate() {
            let (noise, known) = (model.variance(i), self.shares[i * own + i]);
            let square = *error * *error;
            *error = if read.used { (square + known) / noise } else { square / (noise + known) };
        }
        sensors.weigh(&self.raw, &mut self.weights);
        for (weight, _) in self.weights.iter_mut().zip(&self.runs).filter(|(_, run)| **run >= LONGEST) {
            *weight = 1.0;
        }
    }

    /// Takes note of who was left out of the sample, once it is done.
    #[inline(always)]
    pub(super) fn settle_weights(&mut self) {
        for ((run, weight), innovation) in self.runs.iter_mut().zip(&self.weights).zip(&self.raw) {
            if *weight < LEFT_OUT {
                self.status |= Status::GATED;
                *run += 1;
            } else if !innovation.is_nan() {
                *run = 0;
            }
        }
    }

    /// Forgets who was left out, and lets all channels count fully.
    pub(super) fn reset_weights(&mut self) {
        self.weights.fill(1.0);
        self.runs.fill(0);
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
        self.add_residual(model);
        self.read(model, belief, readings);
        innovation.copy_from_slice(&self.raw);
        let own = self.own();
        for (i, std) in std.iter_mut().enumerate() {
            *std = (self.shares[i * own + i] + model.variance(i)).sqrt();
        }
    }
}

/// H X, for X with a row of `stride` for each state.
#[inline(always)]
pub(super) fn observe(model: &impl Model, x: &[f64], stride: usize, out: &mut [f64]) {
    linear::product(model.linearised().jacobian, model.dense(), x, stride, out);
    for (channels, first) in bias_runs(model.biases()) {
        linear::add_scaled(&mut out[channels.start * stride..channels.end * stride], 1.0, &x[first * stride..]);
    }
}

/// Channels in a row whose biases are states in a row, and the first of these.
#[inline(always)]
fn bias_runs(biases: &[Option<usize>]) -> impl Iterator<Item = (Range<usize>, usize)> {
    let mut next = 0;
    core::iter::from_fn(move || {
        let start = next + biases[next..].iter().position(Option::is_some)?;
        let first = biases[start]?;
        let run = biases[start..].iter().zip(first..).take_while(|(bias, state)| **bias == Some(*state)).count();
        next = start + run;
        Some((start..next, first))
    })
}

/// ln 2π.
const LOG_TAU: f64 = 1.837_877_066_409_345_5;

/// The logarithm of a product, taken once and not for each factor.
struct LogProduct {
    product: f64,
    /// Logarithm of what was taken out of it, so that it stays a number.
    taken: f64,
}

impl LogProduct {
    const ONE: Self = Self { product: 1.0, taken: 0.0 };

    #[inline(always)]
    fn times(&mut self, factor: f64) {
        self.product *= factor;
        if !(1e-150..1e150).contains(&self.product) {
            self.taken += log(self.product);
            self.product = 1.0;
        }
    }

    #[inline(always)]
    fn log(self) -> f64 {
        self.taken + log(self.product)
    }
}

/// Channel `i`'s row of H.
#[inline(always)]
fn row(model: &impl Model, i: usize) -> Row<'_> {
    let d = model.dense();
    Row { dense: &model.linearised().jacobian[i * d..][..d], bias: model.biases()[i] }
}
