//! Smoothing: back along the clouds' means and covariances.
//!
//! Weighing particles by p(x₊ | x), as backward simulation does (Godsill, Doucet and West 2004), needs a density that
//! is not there: noise moves n of 3n entries of the state, and no particle leads to where another went (Lindsten, Bunch,
//! Singh and Schön 2015). The motion is linear and its noise normal though, so the pass back of Rauch, Tung and Striebel
//! (1965) takes a cloud's two moments as they are; nothing of the sensors comes into it again. It is written in the
//! adjoints λ and Λ, so that the motion is only ever applied, never inverted.

use super::filter::ParticleFilter;
use super::moves::Moments;
use super::output::{ParticleOutput, packed};
use crate::error::{DesignError, RunError};
use crate::estimate::kalman::{Gaussian, KalmanRecording, Keep, Model, Symmetric};
use crate::interrupt::Watch;
use crate::memory::room;

/// What was found at every sample: the mean, the covariance's upper triangle by rows, and how the motors were linearised.
struct History {
    means: Vec<f64>,
    products: Vec<f64>,
    motors: Vec<f64>,
}

impl History {
    fn with_capacity(count: usize, d: usize, motors: usize) -> Result<Self, DesignError> {
        Ok(Self { means: room(count, d)?, products: room(count, d * (d + 1) / 2)?, motors: room(count, motors)? })
    }

    fn push(&mut self, belief: &Gaussian, motors: &[f64]) {
        let d = belief.mean.len();
        self.means.extend(&belief.mean);
        self.products.extend((0..d).flat_map(|r| &belief.covariance.row(r)[r..d]));
        self.motors.extend(motors);
    }

    fn read(&self, i: usize, into: &mut Gaussian) {
        let d = into.mean.len();
        let size = d * (d + 1) / 2;
        into.mean.copy_from_slice(&self.means[i * d..][..d]);
        let products = &self.products[i * size..][..size];
        for r in 0..d {
            for c in r..d {
                into.covariance.put(r, c, products[packed(r, c, d)]);
            }
        }
    }
}

/// One sample on the way back.
struct Back {
    filtered: Gaussian,
    predicted: Gaussian,
    smoothed: Gaussian,
    factor: Moments,
    products: Vec<f64>,
    lambda: Vec<f64>,
    big: Symmetric,
    column: Vec<f64>,
}

impl Back {
    fn new(d: usize) -> Self {
        let belief = || Gaussian::independent(&vec![0.0; d]);
        Self {
            filtered: belief(),
            predicted: belief(),
            smoothed: belief(),
            factor: Moments::new(d),
            products: vec![0.0; d * (d + 1) / 2],
            lambda: vec![0.0; d],
            big: Symmetric::zeros(d),
            column: vec![0.0; d],
        }
    }

    /// λ = P₋⁻¹ (m̂₊ − m₋) and Λ = P₋⁻¹ (P₋ − P̂₊) P₋⁻¹, of what was smoothed and predicted at the sample after.
    fn look_back(&mut self) {
        let Self { predicted, smoothed, factor, products, lambda, big, column, .. } = self;
        let d = lambda.len();
        for r in 0..d {
            for c in r..d {
                products[packed(r, c, d)] = predicted.covariance.at(r, c);
            }
            lambda[r] = smoothed.mean[r] - predicted.mean[r];
        }
        factor.factorise(products, 1.0);
        factor.solve(lambda);
        for r in 0..d {
            for c in 0..d {
                column[c] = predicted.covariance.at(r, c) - smoothed.covariance.at(r, c);
            }
            factor.solve(column);
            big.data[r * big.stride..][..d].copy_from_slice(column);
        }
        for c in 0..d {
            for r in 0..d {
                column[r] = big.at(r, c);
            }
            factor.solve(column);
            for r in 0..d {
                big.data[r * big.stride + c] = column[r];
            }
        }
        big.mirror();
    }

    /// m̂ = m + P λ and P̂ = P − P Λ P, once λ and Λ are those of this sample.
    fn smooth(&mut self) {
        let Self { filtered, smoothed, lambda, big, column, .. } = self;
        let (d, p) = (lambda.len(), &filtered.covariance);
        for r in 0..d {
            let row = &p.row(r)[..d];
            smoothed.mean[r] = filtered.mean[r] + sum(row, lambda);
            for (k, entry) in column.iter_mut().enumerate() {
                *entry = sum(row, &big.row(k)[..d]);
            }
            for c in r..d {
                smoothed.covariance.put(r, c, p.at(r, c) - sum(column, &p.row(c)[..d]));
            }
        }
    }
}

fn sum(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

impl ParticleFilter {
    /// Estimates at each of `count` samples by all of them: filters from a fresh start, then goes back.
    ///
    /// Links and their standard deviations are smoothed, and the state and its covariance where `keep` says so;
    /// effective numbers, likelihoods and statuses are the filter's. There are no quantiles and no best particle. Exact
    /// as N grows where beliefs are normal. Memory is little more than a mean and half a covariance a sample.
    ///
    /// # Errors
    /// As [`run`](Self::run).
    pub fn smooth(&mut self, recording: KalmanRecording<'_>, keep: Keep) -> Result<ParticleOutput, RunError> {
        self.reset();
        let (count, d) = (recording.dt.len(), self.belief.mean.len());
        let mut history = History::with_capacity(count, d, self.model.memory())?;
        let mut out = self.run_with(recording, keep, |filter| {
            filter.take_covariance();
            history.push(&filter.belief, &filter.memory);
        })?;
        (out.best, out.quantiles) = (Vec::new(), Vec::new());
        let mut back = Back::new(d);
        let watch = Watch::current();
        for i in (0..count).rev() {
            if watch.stops() {
                return Err(RunError::Interrupted { sample: i });
            }
            history.read(i, &mut back.filtered);
            if i + 1 == count {
                back.smoothed.copy_from(&back.filtered);
                continue;
            }
            let next = recording.sample(i + 1, &self.model);
            back.predicted.copy_from(&back.filtered);
            let model = self.model.jerk_model();
            model.predict(&mut back.predicted, self.model.noise(), next.dt, next.inputs.jerk);
            back.look_back();
            model.retreat(&mut back.lambda, &mut back.big, self.model.noise(), next.dt);
            back.smooth();
            let motors = &history.motors[i * self.memory.len()..][..self.memory.len()];
            out.report_belief(i, self, motors, &back.smoothed, keep);
        }
        Ok(out)
    }

    /// As [`run_each`](Self::run_each), each recording [smoothed](Self::smooth).
    pub fn smooth_each(jobs: &[(&Self, KalmanRecording<'_>)], keep: Keep) -> Vec<Result<ParticleOutput, RunError>> {
        Self::each(jobs, |filter, recording| filter.smooth(recording, keep))
    }
}
