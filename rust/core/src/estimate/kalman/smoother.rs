//! The smoother: what later readings say of earlier states.
//!
//! Bierman's (1973) form of the Rauch–Tung–Striebel smoother, on the filter's own scalar updates: an adjoint state λ
//! with covariance Λ runs backwards through the same rows and gains, and the smoothed state is x⁻ − P⁻λ with
//! covariance P⁻ − P⁻ΛP⁻. No predicted covariance is inverted, badly scaled as they are (10⁻¹² to 1).

use super::correction::Correction;
use super::filter::ExtendedKalmanFilter;
use super::gaussian::{Gaussian, Innovation, Symmetric};
use super::model::Model;
use super::output::{FilterOutput, Keep};
use super::phases::{Phases, Report};
use super::recording::KalmanRecording;
use crate::error::RunError;
use crate::linear;
use crate::simd::Kernel;

/// What the filter knew at each sample of a stretch.
#[derive(Clone, Debug)]
pub(super) struct History {
    /// Rows of the predicted covariance that are kept: those that channels depend on, or all.
    kept: usize,
    stride: usize,
    dt: Vec<f64>,
    means: Vec<f64>,
    covariances: Vec<f64>,
    jacobians: Vec<f64>,
    gains: Vec<f64>,
    innovations: Vec<Innovation>,
    /// What the model remembers.
    memories: Vec<f64>,
}

impl History {
    fn with_capacity(count: usize, model: &impl Model, stride: usize, whole: bool) -> Self {
        let (d, m, states) = (model.dense(), model.channels(), model.states());
        let kept = if whole { states } else { d };
        Self {
            kept,
            stride,
            dt: Vec::with_capacity(count),
            means: Vec::with_capacity(count * states),
            covariances: Vec::with_capacity(count * kept * stride),
            jacobians: Vec::with_capacity(count * m * d),
            gains: Vec::with_capacity(count * m * stride),
            innovations: Vec::with_capacity(count * m),
            memories: Vec::with_capacity(count * model.memory()),
        }
    }

    /// Kept rows of the predicted covariance at sample `i`.
    #[inline(always)]
    fn covariance(&self, i: usize) -> &[f64] {
        &self.covariances[i * self.kept * self.stride..][..self.kept * self.stride]
    }

    /// What the model remembered of sample `i`.
    #[inline(always)]
    fn memory(&self, i: usize) -> &[f64] {
        let size = self.memories.len() / self.dt.len();
        &self.memories[i * size..][..size]
    }

    /// Gains at sample `i`, one padded row a channel.
    #[inline(always)]
    fn gains(&self, i: usize) -> &[f64] {
        let size = self.gains.len() / self.dt.len();
        &self.gains[i * size..][..size]
    }

    pub(super) fn push_prediction(&mut self, dt: f64, belief: &Gaussian) {
        self.dt.push(dt);
        self.means.extend_from_slice(&belief.mean);
        self.covariances.extend_from_slice(&belief.covariance.data[..self.kept * self.stride]);
    }

    pub(super) fn push_update(&mut self, model: &impl Model, correction: &Correction) {
        self.jacobians.extend_from_slice(model.linearised().jacobian);
        self.gains.extend_from_slice(&correction.gains);
        self.innovations.extend_from_slice(&correction.innovations);
        model.remember(&mut self.memories);
    }
}

/// Fixed-interval smoother over whole recordings.
///
/// The filter's history is kept for one stretch of the recording at a time: a first pass leaves a belief at the start
/// of each, and each is filtered again on the way back. Memory is bounded by the stretch, whatever the recording's length.
#[derive(Clone, Debug)]
pub struct Smoother<M> {
    filter: ExtendedKalmanFilter<M>,
    /// λ and Λ.
    lambda: Vec<f64>,
    big: Symmetric,
    /// One padded row for each reading: of H, and y.
    rows: Vec<f64>,
    outer: Vec<f64>,
    /// Rows of P⁻Λ.
    product: Vec<f64>,
    mean: Vec<f64>,
    smoothed: Vec<f64>,
}

/// Past sample `i`'s readings, and the smoothed estimate there.
pub(super) struct Back<'a, M> {
    smoother: &'a mut Smoother<M>,
    history: &'a History,
    i: usize,
    whole: bool,
}

impl<M: Phases> Kernel for Back<'_, M> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { smoother, history, i, whole } = self;
        smoother.back(history, i);
        smoother.smooth(history, i, whole);
    }
}

/// From sample `i` to the one before.
pub(super) struct Retreat<'a, M> {
    smoother: &'a mut Smoother<M>,
    history: &'a History,
    i: usize,
}

impl<M: Phases> Kernel for Retreat<'_, M> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { smoother: Smoother { filter, lambda, big, .. }, history, i } = self;
        filter.model.retreat(history.memory(i), history.dt[i], lambda, big);
    }
}

/// Bytes of history that a stretch may take.
const STRETCH: usize = 256 << 20;

impl<M: Phases> Smoother<M> {
    /// A smoother on `filter`'s model, noise and settings; it starts from rest at a recording's first sample.
    pub fn new(filter: &ExtendedKalmanFilter<M>) -> Self {
        let mut filter = filter.clone();
        filter.reset();
        let states = filter.model.states();
        let big = Symmetric::zeros(states);
        let (m, stride) = (filter.model.channels(), big.stride);
        Self {
            lambda: vec![0.0; stride],
            rows: vec![0.0; m * stride],
            outer: vec![0.0; m * stride],
            product: vec![0.0; states * stride],
            mean: vec![0.0; states],
            smoothed: vec![0.0; states * stride],
            big,
            filter,
        }
    }

    /// Smooths a recording: the estimate at each sample by all samples.
    ///
    /// # Errors
    /// As [`ExtendedKalmanFilter::run`].
    pub fn run(&mut self, recording: KalmanRecording<'_>, keep: Keep) -> Result<FilterOutput, RunError> {
        let count = recording.dt.len();
        let stretch = self.stretch();
        let mut filter = self.filter.clone();
        let mut starts = Vec::with_capacity(count / stretch + 1);
        for from in (0..count).step_by(stretch) {
            let to = (from + stretch).min(count);
            starts.push(filter.clone());
            if to < count {
                filter.run(recording.rows(from..to, &self.filter.model), Keep::default())?;
            }
        }
        self.finish();
        let mut parts = Vec::with_capacity(starts.len());
        for (i, start) in starts.iter().enumerate().rev() {
            let rows = i * stretch..((i + 1) * stretch).min(count);
            parts.push(self.stretch_back(start, recording.rows(rows, &self.filter.model), keep)?);
        }
        Ok(parts.into_iter().rev().reduce(FilterOutput::followed_by).unwrap_or_default())
    }

    /// Samples whose history fits into the memory set aside.
    pub fn stretch(&self) -> usize {
        let (states, stride) = (self.big.n, self.big.stride);
        let model = &self.filter.model;
        let numbers = states * (stride + 1) + model.channels() * (model.dense() + stride + 2) + model.memory() + 1;
        (STRETCH / (8 * numbers)).max(1)
    }

    /// Forgets what later stretches said: the next one is a recording's last.
    pub fn finish(&mut self) {
        self.lambda.fill(0.0);
        self.big.data.fill(0.0);
    }

    /// Smooths a stretch of a recording, the last stretch first; `start` is the filter as it was before the stretch.
    ///
    /// # Errors
    /// As [`ExtendedKalmanFilter::run`].
    pub fn stretch_back(
        &mut self,
        start: &ExtendedKalmanFilter<M>,
        recording: KalmanRecording<'_>,
        keep: Keep,
    ) -> Result<FilterOutput, RunError> {
        let mut filter = start.clone();
        let count = recording.dt.len();
        filter.model.check(&recording)?;
        let mut history = History::with_capacity(count, &filter.model, self.big.stride, keep.covariance);
        let mut out = filter.run_with(recording, keep, Some(&mut history))?;
        let history = &history;
        for i in (0..count).rev() {
            M::back_phase(Back { smoother: &mut *self, history, i, whole: keep.covariance });
            self.report(history, i, &mut out, keep.covariance);
            M::retreat_phase(Retreat { smoother: &mut *self, history, i });
        }
        Ok(out)
    }

    /// λ and Λ from after sample `i`'s readings to before them, the last reading first.
    ///
    /// For a row h with gain k and innovation ν of variance s: λ ← (1 − k h)ᵀ λ − hᵀν/s and
    /// Λ ← (1 − k h)ᵀ Λ (1 − k h) + hᵀh/s, which is Λ − hᵀy − yᵀh for y = Λk − (kᵀΛk + 1/s) hᵀ/2. As in the filter, Λ is
    /// touched once, and until then each Λk is corrected by the readings after it.
    #[inline(always)]
    fn back(&mut self, history: &History, i: usize) {
        let m = self.load_rows(history, i);
        let (stride, gains) = (self.big.stride, history.gains(i));
        linear::product(gains, stride, &self.big.data, stride, &mut self.outer);
        for a in (0..m).rev() {
            let Innovation { value, variance } = history.innovations[i * m + a];
            let (early, later) = self.outer.split_at_mut((a + 1) * stride);
            let own = &mut early[a * stride..];
            if variance.is_infinite() {
                own.fill(0.0);
                continue;
            }
            let gain = &gains[a * stride..][..stride];
            let rows = self.rows[(a + 1) * stride..].chunks_exact(stride);
            for (row, y) in rows.zip(later.chunks_exact(stride)) {
                linear::subtract_pair(own, linear::dot(y, gain), row, linear::dot(row, gain), y);
            }
            let row = &self.rows[a * stride..][..stride];
            linear::add_scaled(own, -0.5 * (linear::dot(gain, own) + 1.0 / variance), row);
            let pull = linear::dot(gain, &self.lambda) + value / variance;
            linear::add_scaled(&mut self.lambda, -pull, row);
        }
        self.big.subtract_outer(&self.rows, &self.outer);
    }

    /// Whole rows of H at sample `i`, zero where a reading was not used; returns how many.
    #[inline(always)]
    fn load_rows(&mut self, history: &History, i: usize) -> usize {
        let model = &self.filter.model;
        let (m, d) = (model.channels(), model.dense());
        for (c, row) in self.rows.chunks_exact_mut(self.big.stride).enumerate() {
            row.fill(0.0);
            if history.innovations[i * m + c].variance.is_finite() {
                row[..d].copy_from_slice(&history.jacobians[(i * m + c) * d..][..d]);
                if let Some(b) = model.biases()[c] {
                    row[b] = 1.0;
                }
            }
        }
        m
    }

    /// The smoothed mean and covariance: of q, q̇, q̈ and of q, or of the whole state.
    #[inline(always)]
    fn smooth(&mut self, history: &History, i: usize, whole: bool) {
        let Symmetric { n: states, stride, ref data } = self.big;
        let predicted = history.covariance(i);
        for (r, row) in predicted.chunks_exact(stride).enumerate() {
            self.mean[r] = history.means[i * states + r] - linear::dot(row, &self.lambda);
        }
        let rows = if whole { states } else { self.filter.model.robot().len() };
        linear::product(&predicted[..rows * stride], stride, data, stride, &mut self.product);
        for r in 0..rows {
            for c in r..rows {
                let taken = linear::dot(&predicted[c * stride..][..stride], &self.product[r * stride..][..stride]);
                self.smoothed[r * stride + c] = predicted[r * stride + c] - taken;
                self.smoothed[c * stride + r] = self.smoothed[r * stride + c];
            }
        }
    }

    fn report(&mut self, history: &History, i: usize, out: &mut FilterOutput, whole: bool) {
        let Self { filter, mean, smoothed: covariance, big: Symmetric { stride, .. }, .. } = self;
        let ExtendedKalmanFilter { model, tool, .. } = filter;
        let (memory, stride) = (history.memory(i), *stride);
        M::report_phase(Report { model, memory, mean, covariance, stride, tool, i, out, whole });
    }
}
