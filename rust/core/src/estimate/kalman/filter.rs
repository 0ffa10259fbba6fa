//! The extended Kalman filter: one step, and whole recordings.

use super::channels::Evaluation;
use super::gaussian::{Gaussian, Innovation, Row, Symmetric};
use super::model::{JerkModel, Noise};
use super::output::{FilterOutput, Keep, Linearised};
use super::slope::Slope;
use super::smoother::{History, Smoother};
use crate::error::{DesignError, RunError};
use crate::estimate::Status;
use crate::estimate::observer::link_position_at_rest;
use crate::linear;
use crate::simd::{self, Kernel};
use rayon::prelude::*;

/// What a filter does beyond the textbook.
#[derive(Clone, Copy, Debug)]
pub struct FilterSettings {
    /// A channel whose innovation exceeds this many standard deviations is left out at that sample.
    pub gate: Option<f64>,
    /// How often the measurement is linearised, each time at the estimate of the time before; 1 is the plain update.
    pub iterations: usize,
    /// Whether the damping torque D(θ̇ − q̇) is predicted.
    pub damping: bool,
}

/// One sample; NaN where a reading is missing.
#[derive(Clone, Copy, Debug)]
pub struct KalmanSample<'a> {
    /// Time since the sample before [s]; not looked at on the first.
    pub dt: f64,
    /// One reading a channel.
    pub readings: &'a [f64],
    /// Motor velocities for the damping torque (n) [rad/s]; where missing, the slope of the latest motor positions.
    pub dtheta: &'a [f64],
    /// Jerk of the links since the sample before, as commanded (n) [rad/s³].
    pub jerk: &'a [f64],
}

/// Kalman filter with exact derivatives; a step allocates nothing.
///
/// Readings with independent noise are used one after the other, which equals using them at once, needs no matrix
/// inverse, and makes a missing one a loop that runs once less.
#[derive(Clone, Debug)]
pub struct ExtendedKalmanFilter {
    pub(super) model: JerkModel,
    pub(super) noise: Noise,
    settings: FilterSettings,
    pub(super) belief: Gaussian,
    prior: Gaussian,
    pub(super) evaluation: Evaluation,
    /// Where the channels are linearised.
    pub(super) reference: Vec<f64>,
    /// H P, each row after the channels before it (channels × states, padded).
    projections: Vec<f64>,
    pub(super) gains: Vec<f64>,
    halves: Vec<f64>,
    pub(super) innovations: Vec<Innovation>,
    /// Channels left out at this sample by the gate.
    gated: Vec<bool>,
    /// Motor velocities for the damping torque.
    dtheta: Vec<f64>,
    slope: Slope,
    pub(super) jerk: Vec<f64>,
    pub(super) tool_jacobian: Vec<f64>,
    status: u8,
    nis: f64,
    used: u32,
    log_likelihood: f64,
    /// Samples taken, for messages.
    taken: usize,
    started: bool,
}

impl ExtendedKalmanFilter {
    /// A filter that starts from rest at its first sample.
    ///
    /// # Errors
    /// Noise that does not fit the model, a gate or a number of iterations out of range.
    pub fn new(model: JerkModel, noise: Noise, settings: FilterSettings) -> Result<Self, DesignError> {
        model.check(&noise)?;
        if let Some(value) = settings.gate.filter(|g| g.is_nan() || *g <= 0.0) {
            return Err(DesignError::Range {
                what: "gate",
                value,
                expected: "a positive number of standard deviations",
            });
        }
        if settings.iterations == 0 {
            return Err(DesignError::Range { what: "iterations", value: 0.0, expected: "at least 1" });
        }
        let (n, m) = (model.joints(), model.channels());
        let belief = model.initial(&vec![0.0; n], &noise);
        let stride = belief.covariance.stride;
        Ok(Self {
            prior: belief.clone(),
            evaluation: Evaluation::new(&model.robot, m),
            reference: vec![0.0; 3 * n],
            projections: vec![0.0; m * stride],
            gains: vec![0.0; m * stride],
            halves: vec![0.0; m * stride],
            innovations: vec![Innovation::NONE; m],
            gated: vec![false; m],
            dtheta: vec![f64::NAN; n],
            slope: Slope::new(n),
            jerk: vec![0.0; n],
            tool_jacobian: vec![0.0; 3 * n],
            status: 0,
            nis: 0.0,
            used: 0,
            log_likelihood: 0.0,
            taken: 0,
            started: false,
            belief,
            model,
            noise,
            settings,
        })
    }

    /// Forgets the state: the next sample starts anew, from rest.
    pub fn reset(&mut self) {
        self.taken = 0;
        self.started = false;
    }

    /// The model.
    pub fn model(&self) -> &JerkModel {
        &self.model
    }

    /// The belief after the last sample.
    pub fn belief(&self) -> &Gaussian {
        &self.belief
    }

    /// See [`Status`](crate::estimate::Status).
    pub fn status(&self) -> u8 {
        self.status
    }

    /// Takes one sample: predicts to its time, then uses its readings.
    ///
    /// # Errors
    /// Only on a first sample without every motor position, or without a static equilibrium.
    #[inline(always)]
    pub fn step(&mut self, sample: KalmanSample<'_>) -> Result<(), DesignError> {
        self.advance(&sample)?;
        self.correct(&sample);
        Ok(())
    }

    /// To the sample's time; afterwards the belief is what was predicted.
    #[inline(always)]
    pub(super) fn advance(&mut self, sample: &KalmanSample<'_>) -> Result<(), DesignError> {
        if self.started {
            self.model.predict(&mut self.belief, &self.noise, sample.dt, sample.jerk);
        } else {
            self.start(sample.readings)?;
        }
        self.jerk.copy_from_slice(sample.jerk);
        if self.settings.damping {
            self.dtheta.copy_from_slice(sample.dtheta);
            self.slope.push(sample.dt, &sample.readings[..self.jerk.len()]);
            self.slope.fill(&mut self.dtheta);
        }
        Ok(())
    }

    fn start(&mut self, readings: &[f64]) -> Result<(), DesignError> {
        let theta = &readings[..self.model.joints()];
        if let Some(joint) = theta.iter().position(|x| x.is_nan()) {
            return Err(DesignError::NoStart { joint });
        }
        let q = link_position_at_rest(&self.model.robot, theta)?;
        self.belief = self.model.initial(&q, &self.noise);
        self.slope.reset();
        self.started = true;
        Ok(())
    }

    /// Uses the sample's readings.
    #[inline(always)]
    pub(super) fn correct(&mut self, sample: &KalmanSample<'_>) {
        let n = self.reference.len();
        self.gated.fill(false);
        self.reference.copy_from_slice(&self.belief.mean[..n]);
        self.linearise();
        if self.settings.iterations > 1 {
            self.prior.copy_from(&self.belief);
        }
        self.update(sample.readings, self.settings.gate);
        for _ in 1..self.settings.iterations {
            self.reference.copy_from_slice(&self.belief.mean[..n]);
            self.linearise();
            self.belief.copy_from(&self.prior);
            self.update(sample.readings, None);
        }
    }

    #[inline(always)]
    fn linearise(&mut self) {
        let Self { evaluation, model, reference, dtheta, .. } = self;
        evaluation.evaluate(&model.robot, &model.channels, reference, dtheta);
    }

    /// One channel after the other, all linearised at the reference.
    ///
    /// For one row h, with g = P hᵀ, s = h g + r and any gain k, Joseph's form (1 − k h) P (1 − k h)ᵀ + k r kᵀ is
    /// P − k mᵀ − m kᵀ with m = g − s k/2: symmetric by construction, an error of k entering squared, nothing inverted.
    /// P itself is touched once, when all channels are through; until then each g is corrected by those before it.
    #[inline(always)]
    fn update(&mut self, readings: &[f64], gate: Option<f64>) {
        (self.status, self.nis, self.used, self.log_likelihood) = (0, 0.0, 0, 0.0);
        self.project();
        for (i, &reading) in readings.iter().enumerate() {
            self.innovations[i] = if reading.is_nan() {
                self.status |= Status::BRIDGED;
                Innovation::NONE
            } else {
                self.innovate(i, reading, gate)
            };
            self.use_channel(i);
        }
        self.belief.covariance.subtract_outer(&self.gains, &self.halves);
        if self.used == 0 {
            self.status |= Status::PREDICTED;
        }
    }

    /// Rows of H P.
    #[inline(always)]
    fn project(&mut self) {
        let Symmetric { stride, ref data, .. } = self.belief.covariance;
        linear::product(&self.evaluation.jacobian, self.reference.len(), data, stride, &mut self.projections);
        for (projection, bias) in self.projections.chunks_exact_mut(stride).zip(&self.model.biases) {
            if let Some(b) = *bias {
                linear::add_scaled(projection, 1.0, &data[b * stride..][..stride]);
            }
        }
    }

    /// Channel `i`'s innovation after the channels before it; none when the gate shuts it out.
    #[inline(always)]
    fn innovate(&mut self, i: usize, reading: f64, gate: Option<f64>) -> Innovation {
        let stride = self.belief.covariance.stride;
        let row = row(&self.evaluation, &self.model, i);
        let (before, own) = self.projections.split_at_mut(i * stride);
        let own = &mut own[..stride];
        for (j, earlier) in before.chunks_exact(stride).enumerate() {
            let variance = self.innovations[j].variance;
            if variance.is_finite() {
                linear::add_scaled(own, -row.dot(earlier) / variance, earlier);
            }
        }
        let variance = row.dot(own) + self.reading_variance(i);
        let mut value = reading - self.evaluation.prediction[i] - row.bias.map_or(0.0, |b| self.belief.mean[b]);
        for (k, h) in row.dense.iter().enumerate() {
            value -= h * (self.belief.mean[k] - self.reference[k]);
        }
        self.gated[i] |= gate.is_some_and(|g| value * value > g * g * variance);
        if self.gated[i] {
            self.status |= Status::GATED;
            return Innovation::NONE;
        }
        Innovation { value, variance }
    }

    /// Variance of channel `i`'s noise; a motor's has a part that grows with its predicted torsion.
    #[inline(always)]
    fn reading_variance(&self, i: usize) -> f64 {
        let own = self.noise.reading[i] * self.noise.reading[i];
        if i >= self.model.joints() {
            return own;
        }
        let error = self.noise.torsion * (self.evaluation.prediction[i] - self.reference[i]);
        own + error * error
    }

    /// Moves the mean by channel `i`'s innovation and readies what the covariance loses.
    #[inline(always)]
    fn use_channel(&mut self, i: usize) {
        let Innovation { value, variance } = self.innovations[i];
        let stride = self.belief.covariance.stride;
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
        linear::add_scaled(&mut self.belief.mean, value, gain);
        let squared = value * value / variance;
        self.nis += squared;
        self.used += 1;
        self.log_likelihood -= 0.5 * (squared + (core::f64::consts::TAU * variance).ln());
    }

    /// Filters a recording, `count` rows; goes on from where it was, so that it may come in pieces.
    ///
    /// # Errors
    /// As [`step`](Self::step), wrong lengths, or a sample after which the estimate is not finite.
    pub fn run(&mut self, recording: KalmanRecording<'_>, keep: Keep) -> Result<FilterOutput, RunError> {
        recording.check(&self.model)?;
        simd::dispatch(simd::level(), Run { filter: self, recording, keep, history: None })
    }

    /// Runs each of `recordings` from a fresh start, on all cores; through the smoother where `smooth`.
    pub fn run_all(
        &self,
        recordings: &[KalmanRecording<'_>],
        smooth: bool,
        keep: Keep,
    ) -> Vec<Result<FilterOutput, RunError>> {
        let one = |&recording: &KalmanRecording<'_>| {
            if smooth {
                return Smoother::new(self).run(recording, keep);
            }
            let mut filter = self.clone();
            filter.reset();
            filter.run(recording, keep)
        };
        recordings.par_iter().map(one).collect()
    }

    /// As [`run`](Self::run), remembering what a smoother needs.
    #[inline(always)]
    fn run_with(
        &mut self,
        recording: KalmanRecording<'_>,
        keep: Keep,
        mut history: Option<&mut History>,
    ) -> Result<FilterOutput, RunError> {
        let count = recording.dt.len();
        let mut out = FilterOutput::zeros(count, &self.model, keep);
        for i in 0..count {
            let sample = recording.sample(i, &self.model);
            self.advance(&sample)?;
            if let Some(history) = &mut history {
                history.push_prediction(sample.dt, &self.belief);
            }
            if keep.innovations {
                self.report_innovations(i, &sample, &mut out);
            }
            self.correct(&sample);
            if let Some(history) = &mut history {
                history.push_update(self);
            }
            if !(self.log_likelihood.is_finite() && self.belief.mean.iter().all(|x| x.is_finite())) {
                return Err(RunError::NotFinite { sample: self.taken });
            }
            self.taken += 1;
            // A smoother writes the state itself, on its way back.
            self.report(i, &mut out, keep.covariance && history.is_none());
        }
        Ok(out)
    }

    /// What was predicted against what was read, before any reading is used.
    fn report_innovations(&mut self, at: usize, sample: &KalmanSample<'_>, out: &mut FilterOutput) {
        let d = self.reference.len();
        let stride = self.belief.covariance.stride;
        self.reference.copy_from_slice(&self.belief.mean[..d]);
        self.linearise();
        self.project();
        for (i, reading) in sample.readings.iter().enumerate() {
            let row = row(&self.evaluation, &self.model, i);
            let variance = row.dot(&self.projections[i * stride..][..stride]) + self.reading_variance(i);
            let bias = row.bias.map_or(0.0, |b| self.belief.mean[b]);
            let slot = at * self.innovations.len() + i;
            out.innovation[slot] = reading - self.evaluation.prediction[i] - bias;
            out.innovation_std[slot] = variance.sqrt();
        }
    }

    #[inline(always)]
    fn report(&mut self, i: usize, out: &mut FilterOutput, whole: bool) {
        let Self { model, belief, evaluation, .. } = self;
        out.status[i] = self.status;
        out.nis[i] = self.nis;
        out.used[i] = self.used;
        out.log_likelihood[i] = self.log_likelihood;
        let Gaussian { mean, covariance } = belief;
        let at = |r: usize, c: usize| covariance.at(r, c);
        let Evaluation { jacobian, prediction, .. } = &*evaluation;
        out.write_motors(i, mean, Linearised { jacobian, prediction, reference: &self.reference, jerk: &self.jerk });
        out.write_links(i, model, mean, at, evaluation, &mut self.tool_jacobian);
        if whole {
            out.write_state(i, mean, &covariance.data, covariance.stride);
        }
    }
}

/// Channel `i`'s row of H.
#[inline(always)]
fn row<'a>(evaluation: &'a Evaluation, model: &JerkModel, i: usize) -> Row<'a> {
    let d = 3 * model.joints();
    Row { dense: &evaluation.jacobian[i * d..][..d], bias: model.biases[i] }
}

/// A filter's run, to be compiled for each instruction set.
pub(super) struct Run<'a, 'b> {
    pub(super) filter: &'a mut ExtendedKalmanFilter,
    pub(super) recording: KalmanRecording<'b>,
    pub(super) keep: Keep,
    pub(super) history: Option<&'a mut History>,
}

impl Kernel for Run<'_, '_> {
    type Output = Result<FilterOutput, RunError>;

    #[inline(always)]
    fn run(self) -> Self::Output {
        self.filter.run_with(self.recording, self.keep, self.history)
    }
}

/// A recording, row-major.
#[derive(Clone, Copy, Debug)]
pub struct KalmanRecording<'a> {
    /// Steps of time (count), the first one unused [s].
    pub dt: &'a [f64],
    /// Readings (count × channels).
    pub readings: &'a [f64],
    /// Motor velocities (count × n).
    pub dtheta: &'a [f64],
    /// Commanded jerk (count × n).
    pub jerk: &'a [f64],
}

impl<'a> KalmanRecording<'a> {
    /// Some rows.
    pub(super) fn rows(&self, rows: core::ops::Range<usize>, model: &JerkModel) -> Self {
        let cut = |values: &'a [f64], width: usize| &values[rows.start * width..rows.end * width];
        let (n, m) = (model.joints(), model.channels());
        Self {
            dt: cut(self.dt, 1),
            readings: cut(self.readings, m),
            dtheta: cut(self.dtheta, n),
            jerk: cut(self.jerk, n),
        }
    }

    pub(super) fn sample(&self, i: usize, model: &JerkModel) -> KalmanSample<'a> {
        let (n, m) = (model.joints(), model.channels());
        KalmanSample {
            dt: self.dt[i],
            readings: &self.readings[i * m..][..m],
            dtheta: &self.dtheta[i * n..][..n],
            jerk: &self.jerk[i * n..][..n],
        }
    }

    pub(super) fn check(&self, model: &JerkModel) -> Result<(), DesignError> {
        let (count, n, m) = (self.dt.len(), model.joints(), model.channels());
        for (what, found, expected) in [
            ("readings", self.readings.len(), count * m),
            ("dtheta", self.dtheta.len(), count * n),
            ("jerk", self.jerk.len(), count * n),
        ] {
            if found != expected {
                return Err(DesignError::Length { what, found, expected });
            }
        }
        Ok(())
    }
}
