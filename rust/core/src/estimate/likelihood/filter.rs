//! The filter: what is kept is each reading's innovation.
//!
//! Its update differs from that of [`kalman`](crate::estimate::kalman), which leaves part of the covariance to the end
//! of a sample: here each reading changes all of it, so that a filter inside a sensor can take its next value between two
//! readings. A test holds both equal.

use super::evaluation::{ParametricMeasurement, ParametricReading};
use super::instants::Instant;
use super::recording::LikelihoodRecording;
use crate::estimate::bias::bias_step;
use crate::estimate::jerk_noise;
use crate::estimate::kalman::{JerkModel, JerkNoise};
use crate::estimate::measurement::Channel;
use crate::interrupt::Watch;
use crate::simd::{self, Kernel};

/// A reading less its prediction by all readings before it.
#[derive(Clone, Copy, Debug)]
pub(super) struct SequentialInnovation {
    pub(super) value: f64,
    pub(super) variance: f64,
    /// The sample of the reading.
    pub(super) row: usize,
}

/// A filter on its way through a recording.
#[derive(Clone, Debug)]
pub(super) struct Filter {
    /// Predictions of readings and their derivatives.
    evaluation: ParametricMeasurement,
    /// The state that is each channel's bias.
    biases: Vec<Option<usize>>,
    /// The state that is each channel's filter, and α.
    memories: Vec<Option<(usize, f64)>>,
    /// Densities, walks and initial uncertainties.
    noise: JerkNoise,
    /// All instants at which something was read, in time, and the next one.
    instants: Vec<Instant>,
    next: usize,
    /// (q, q̇, q̈, biases, filters inside sensors).
    mean: Vec<f64>,
    /// n × n, symmetric.
    covariance: Vec<f64>,
    /// Where the instant's readings are linearised (3n).
    reference: Vec<f64>,
    /// P hᵀ of the reading at hand.
    gain: Vec<f64>,
    /// Those since [`advance`](Self::advance) was last called.
    pub(super) innovations: Vec<SequentialInnovation>,
}

impl Filter {
    pub(super) fn new(
        model: &JerkModel,
        noise: JerkNoise,
        evaluation: ParametricMeasurement,
        instants: Vec<Instant>,
    ) -> Self {
        let n = model.joints();
        let mut states = model.states();
        let mut memory = |channel: &Channel| match *channel {
            Channel::Acceleration { sensor, .. } => evaluation.lateness[sensor].memory.map(|alpha| {
                states += 1;
                (states - 1, alpha)
            }),
            _ => None,
        };
        Self {
            memories: model.channels.iter().map(&mut memory).collect(),
            evaluation,
            biases: model.biases.clone(),
            noise,
            instants,
            next: 0,
            mean: vec![0.0; states],
            covariance: vec![0.0; states * states],
            reference: vec![0.0; 3 * n],
            gain: vec![0.0; states],
            innovations: Vec::new(),
        }
    }

    /// In how many calls of [`advance`](Self::advance) with `count` instants each the recording is done.
    pub(super) fn stretches(&self, count: usize) -> usize {
        self.instants.len().div_ceil(count)
    }

    /// Innovations of the next `count` instants.
    pub(super) fn advance(&mut self, recording: &LikelihoodRecording, count: usize) {
        self.innovations.clear();
        let watch = Watch::current();
        for i in self.next..(self.next + count).min(self.instants.len()) {
            if watch.stops() {
                return;
            }
            let instant = self.instants[i];
            if i == 0 {
                self.start(recording);
            } else {
                // Sensors that are late have instants of their own between samples: the filter stops there too.
                let from = self.instants[i - 1];
                simd::phase(PredictSequential { filter: self, recording, from, to: instant });
            }
            self.correct(recording, instant);
        }
        self.next += count;
    }

    /// At rest at the first sample: links where the first motor positions let them hang, by the parameters' springs.
    fn start(&mut self, recording: &LikelihoodRecording) {
        let (n, states) = (self.reference.len() / 3, self.mean.len());
        let q = self.evaluation.rest(&recording.theta[..n]);
        self.mean[..n].copy_from_slice(&q);
        for (i, std) in self.noise.initial.iter().enumerate() {
            self.covariance[i * states + i] = std * std;
        }
        for (bias, std) in self.biases.iter().zip(&self.noise.initial_bias) {
            if let Some(b) = *bias {
                self.covariance[b * states + b] = std * std;
            }
        }
    }

    /// When an instant was, from the recording's first sample [s].
    #[inline(always)]
    fn time(&self, recording: &LikelihoodRecording, instant: Instant) -> f64 {
        let stamp = recording.t[instant.row] - recording.t[0];
        match instant.late {
            Some(s) => stamp - self.evaluation.lateness[s].lag,
            None => stamp,
        }
    }

    /// Axelsson, Karlsson and Norrlöf 2012, eqs. (9)–(11).
    #[inline(always)]
    fn predict(&mut self, recording: &LikelihoodRecording, from: Instant, to: Instant) {
        let (n, states) = (self.reference.len() / 3, self.mean.len());
        let dt = self.time(recording, to) - self.time(recording, from);
        let half = dt * dt * 0.5;
        let sixth = half * dt * (1.0 / 3.0);
        let jerk = &recording.jerk[to.interval * n..][..n];
        for (j, &u) in jerk.iter().enumerate() {
            let (dq, ddq) = (self.mean[n + j], self.mean[2 * n + j]);
            self.mean[j] += dt * dq + half * ddq + sixth * u;
            self.mean[n + j] += dt * ddq + half * u;
            self.mean[2 * n + j] += dt * u;
        }
        // F P, then (F P) Fᵀ, by the rows and columns that F mixes: F is the identity but for dt and dt²/2.
        let p = &mut self.covariance;
        for i in 0..n * states {
            let (dq, ddq) = (p[n * states + i], p[2 * n * states + i]);
            p[i] += dt * dq + half * ddq;
            p[n * states + i] += dt * ddq;
        }
        for row in p.chunks_exact_mut(states) {
            for j in 0..n {
                let (dq, ddq) = (row[n + j], row[2 * n + j]);
                row[j] += dt * dq + half * ddq;
                row[n + j] += dt * ddq;
            }
        }
        self.add_noise(dt);
    }

    /// P ← P + Q: white jerk over the step, walks beside, and biases that forget and wander.
    #[inline(always)]
    fn add_noise(&mut self, dt: f64) {
        let (n, states) = (self.reference.len() / 3, self.mean.len());
        let white_jerk = jerk_noise::covariance(dt);
        for j in 0..n {
            let variance = self.noise.jerk[j] * self.noise.jerk[j];
            for a in 0..3 {
                for b in 0..3 {
                    self.covariance[(a * n + j) * states + b * n + j] += white_jerk[a][b] * variance;
                }
            }
        }
        for (i, walk) in self.noise.link_walk.iter().enumerate() {
            self.covariance[i * states + i] += dt * (walk * walk);
        }
        for c in 0..self.biases.len() {
            let Some(b) = self.biases[c] else { continue };
            let step = bias_step(self.noise.bias_walk[c], self.noise.bias_time[c], dt);
            self.mean[b] *= step.decay;
            for k in 0..states {
                self.covariance[b * states + k] *= step.decay;
            }
            for k in 0..states {
                self.covariance[k * states + b] *= step.decay;
            }
            self.covariance[b * states + b] += step.variance;
        }
    }

    /// One reading after the other, all linearised where the instant was predicted.
    fn correct(&mut self, recording: &LikelihoodRecording, instant: Instant) {
        let d = self.reference.len();
        self.reference.copy_from_slice(&self.mean[..d]);
        simd::phase(EvaluateParametric {
            evaluation: &mut self.evaluation,
            recording,
            instant,
            state: &self.reference,
        });
        for i in 0..self.evaluation.readings.len() {
            simd::phase(UseReading { filter: self, i, row: instant.row });
        }
    }

    /// Kalman's update by one reading: innovation, its variance, and the state by both.
    #[inline(always)]
    fn use_reading(&mut self, i: usize, row: usize) {
        let reading = self.evaluation.readings[i];
        let predicted = self.project(&reading);
        let (predicted, spread) = match self.memories[reading.channel] {
            Some((state, alpha)) => self.remember(state, alpha, predicted),
            None => predicted,
        };
        // A filter inside a sensor goes on though its output was not recorded.
        let Some(value) = reading.value else { return };
        let (mut value, mut variance) = (value - predicted, spread + reading.variance);
        if let Some(b) = self.biases[reading.channel] {
            let states = self.mean.len();
            // h = (…, 1 at the bias): P hᵀ and h P hᵀ from their parts, without a row of zeros and ones.
            value -= self.mean[b];
            variance += self.gain[b];
            for (g, p) in self.gain.iter_mut().zip(&self.covariance[b * states..][..states]) {
                *g += *p;
            }
            variance += self.gain[b];
        }
        self.apply(value, variance);
        self.innovations.push(SequentialInnovation { value, variance, row });
    }

    /// A prediction h(x) without bias at the present mean, and its variance h P hᵀ; leaves P hᵀ in the gain.
    #[inline(always)]
    fn project(&mut self, reading: &ParametricReading) -> (f64, f64) {
        let (d, states) = (self.reference.len(), self.mean.len());
        let h = &self.evaluation.jacobian[reading.channel * d..][..d];
        let (mut predicted, mut spread) = (reading.prediction, 0.0);
        self.gain.fill(0.0);
        for (k, (slope, column)) in h.iter().zip(self.covariance.chunks_exact(states)).enumerate() {
            predicted += *slope * (self.mean[k] - self.reference[k]);
            for (g, p) in self.gain.iter_mut().zip(column) {
                *g += *slope * *p;
            }
        }
        for (slope, g) in h.iter().zip(&self.gain) {
            spread += *slope * *g;
        }
        (predicted, spread)
    }

    /// A filter inside a sensor takes its next value: w ← α w + (1 − α) h(x), where `project` has left h(x), h P hᵀ and
    /// P hᵀ. Gives mean and variance of w, and leaves its covariances in the gain. On its first value the filter has settled.
    #[inline(always)]
    fn remember(&mut self, state: usize, alpha: f64, (predicted, spread): (f64, f64)) -> (f64, f64) {
        let states = self.mean.len();
        let started = self.covariance[state * states + state] != 0.0;
        let alpha = if started { alpha } else { 0.0 };
        let rest = 1.0 - alpha;
        let (own, across) = (self.covariance[state * states + state], self.gain[state]);
        let mean = alpha * self.mean[state] + rest * predicted;
        let variance = alpha * (alpha * own + rest * across * 2.0) + rest * rest * spread;
        for k in 0..states {
            self.gain[k] = alpha * self.covariance[state * states + k] + rest * self.gain[k];
        }
        self.gain[state] = variance;
        for k in 0..states {
            self.covariance[state * states + k] = self.gain[k];
            self.covariance[k * states + state] = self.gain[k];
        }
        self.mean[state] = mean;
        (mean, variance)
    }

    /// x ← x + g ν/s, P ← P − g gᵀ/s.
    #[inline(always)]
    fn apply(&mut self, value: f64, variance: f64) {
        let states = self.mean.len();
        let precision = 1.0 / variance;
        let weighted = value * precision;
        for i in 0..states {
            let g = self.gain[i];
            self.mean[i] += g * weighted;
            let scaled = g * precision;
            for j in i..states {
                let change = scaled * self.gain[j];
                self.covariance[i * states + j] -= change;
                if j > i {
                    self.covariance[j * states + i] = self.covariance[i * states + j];
                }
            }
        }
    }
}

/// [`Filter::predict`], to be compiled for each instruction set.
struct PredictSequential<'a> {
    filter: &'a mut Filter,
    recording: &'a LikelihoodRecording,
    from: Instant,
    to: Instant,
}

impl Kernel for PredictSequential<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        self.filter.predict(self.recording, self.from, self.to);
    }
}

/// [`ParametricMeasurement::evaluate`], likewise.
struct EvaluateParametric<'a> {
    evaluation: &'a mut ParametricMeasurement,
    recording: &'a LikelihoodRecording,
    instant: Instant,
    state: &'a [f64],
}

impl Kernel for EvaluateParametric<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        self.evaluation.evaluate(self.recording, self.instant, self.state);
    }
}

/// [`Filter::use_reading`], likewise.
struct UseReading<'a> {
    filter: &'a mut Filter,
    i: usize,
    row: usize,
}

impl Kernel for UseReading<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        self.filter.use_reading(self.i, self.row);
    }
}
