//! Smoothing: back along the clouds' means and covariances.
//!
//! Weighing particles by p(x₊ | x), as backward simulation does (Godsill, Doucet and West 2004), needs a density that
//! is not there: noise moves n of 3n entries of the state, and no particle leads to where another went (Lindsten, Bunch,
//! Singh and Schön 2015). The motion is linear and its noise normal though, so the pass back of Rauch, Tung and Striebel
//! (1965) takes a cloud's two moments as they are; nothing of the sensors comes into it again.

use super::filter::ParticleFilter;
use super::output::{ParticleOutput, packed};
use super::regularise::Moments;
use crate::check::expect;
use crate::error::{DesignError, RunError};
use crate::estimate::kalman::{
    FilterOutput, Gaussian, JerkModel, JerkNoise, KalmanRecording, Keep, Model, Smoother, Symmetric,
};
use crate::interrupt::Watch;
use crate::memory::room;

/// What was found at every sample: the mean, the covariance's upper triangle by rows, and how the motors were linearised.
struct CloudHistory {
    /// states a sample.
    means: Vec<f64>,
    /// states (states + 1)/2 a sample.
    products: Vec<f64>,
    /// What the model remembered of each sample.
    motors: Vec<f64>,
}

impl CloudHistory {
    /// Room for `count` samples of `d` states.
    fn with_capacity(count: usize, d: usize, motors: usize) -> Result<Self, DesignError> {
        Ok(Self { means: room(count, d)?, products: room(count, d * (d + 1) / 2)?, motors: room(count, motors)? })
    }

    /// Keeps a sample.
    fn push(&mut self, belief: &Gaussian, motors: &[f64]) {
        let d = belief.mean.len();
        self.means.extend(&belief.mean);
        self.products.extend((0..d).flat_map(|r| &belief.covariance.row(r)[r..d]));
        self.motors.extend(motors);
    }

    /// Sample `i`'s mean and covariance.
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
struct BackwardPass {
    /// The cloud's moments at this sample, at the next one by the motion alone, and by all readings.
    filtered: Gaussian,
    predicted: Gaussian,
    smoothed: Gaussian,
    /// Q: what a step adds to no uncertainty at all.
    noise: Gaussian,
    /// Factor of a covariance.
    factor: Moments,
    /// Scratch: a covariance's upper triangle by rows.
    products: Vec<f64>,
    /// G, and 1 − G F (d × d).
    gain: Vec<f64>,
    left: Vec<f64>,
    /// Factors of the two parts of the smoothed covariance (d × 2d).
    parts: Vec<f64>,
    /// Scratch: a column of Fᵀ P₋⁻¹, a row of G, a change of the mean.
    column: Vec<f64>,
    /// Scratch for the covariance of the motion's adjoint, which is not needed here.
    unused: Symmetric,
}

impl BackwardPass {
    fn new(d: usize) -> Self {
        let belief = || Gaussian::independent(&vec![0.0; d]);
        Self {
            filtered: belief(),
            predicted: belief(),
            smoothed: belief(),
            noise: belief(),
            factor: Moments::new(d),
            products: vec![0.0; d * (d + 1) / 2],
            gain: vec![0.0; d * d],
            left: vec![0.0; d * d],
            parts: vec![0.0; d * 2 * d],
            column: vec![0.0; d],
            unused: Symmetric::zeros(d),
        }
    }

    /// From the sample after, which is in `smoothed`, to that which is in `filtered`: with G = P Fᵀ P₋⁻¹,
    ///
    /// m̂ = m + G (m̂₊ − m₋) and P̂ = (1 − G F) P (1 − G F)ᵀ + G (Q + P̂₊) Gᵀ,
    ///
    /// each part the square of a factor. The usual P − G (P₋ − P̂₊) Gᵀ is the same number, but where P₋ is large it is the
    /// difference of two that hardly differ, and may turn out negative.
    fn step(&mut self, model: &JerkModel, noise: &JerkNoise, dt: f64, jerk: &[f64]) {
        // m₋ and P₋ = F P Fᵀ + Q from the cloud's moments, and Q by predicting from no uncertainty.
        self.predicted.copy_from(&self.filtered);
        model.predict(&mut self.predicted, noise, dt, jerk);
        self.noise.covariance.data.fill(0.0);
        model.predict(&mut self.noise, noise, dt, jerk);
        self.look_back(model, noise, dt);
        self.set_parts();
        let Self { filtered, predicted, smoothed, gain, parts, column, .. } = self;
        let d = column.len();
        for (change, (after, before)) in column.iter_mut().zip(smoothed.mean.iter().zip(&predicted.mean)) {
            *change = after - before;
        }
        for (r, row) in gain.chunks_exact(d).enumerate() {
            smoothed.mean[r] = filtered.mean[r] + sum(row, column);
        }
        for (r, row) in parts.chunks_exact(2 * d).enumerate() {
            for (c, other) in parts.chunks_exact(2 * d).enumerate().skip(r) {
                smoothed.covariance.put(r, c, sum(row, other));
            }
        }
    }

    /// G and 1 − G F, by the adjoint of the motion alone.
    fn look_back(&mut self, model: &JerkModel, noise: &JerkNoise, dt: f64) {
        let Self { filtered, predicted, factor, products, gain, left, column, unused, .. } = self;
        let d = column.len();
        pack(&[&predicted.covariance], products);
        factor.factorise(products);
        for k in 0..d {
            column.fill(0.0);
            column[k] = 1.0;
            factor.solve(column);
            model.retreat(column, unused, noise, dt); // a column of Fᵀ P₋⁻¹
            for r in 0..d {
                gain[r * d + k] = sum(&filtered.covariance.row(r)[..d], column);
            }
        }
        for r in 0..d {
            column.copy_from_slice(&gain[r * d..][..d]);
            model.retreat(column, unused, noise, dt);
            for (c, (left, moved)) in left[r * d..][..d].iter_mut().zip(column.iter()).enumerate() {
                *left = f64::from(u8::from(r == c)) - moved;
            }
        }
    }

    /// (1 − G F) √P beside G √(Q + P̂₊).
    fn set_parts(&mut self) {
        let Self { filtered, smoothed, noise, factor, products, gain, left, parts, column, .. } = self;
        let d = column.len();
        let mut multiply = |matrix: &[f64], factor: &[f64], from: usize| {
            for r in 0..d {
                for c in 0..d {
                    parts[r * 2 * d + from + c] = (c..d).map(|k| matrix[r * d + k] * factor[k * d + c]).sum();
                }
            }
        };
        pack(&[&filtered.covariance], products);
        factor.factorise(products);
        multiply(left, &factor.factor, 0);
        pack(&[&noise.covariance, &smoothed.covariance], products);
        factor.factorise(products);
        multiply(gain, &factor.factor, d);
    }
}

/// The sum's upper triangle by rows.
fn pack(matrices: &[&Symmetric], out: &mut [f64]) {
    let d = matrices[0].n;
    let mut out = out.iter_mut();
    for r in 0..d {
        for (c, out) in (r..d).zip(&mut out) {
            *out = matrices.iter().map(|matrix| matrix.at(r, c)).sum();
        }
    }
}

/// Σ aᵢ bᵢ in the order of the entries.
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
    /// As [`run`](Self::run); late sensors, of which later readings tell what is no part of the cloud.
    pub fn smooth(&mut self, recording: KalmanRecording<'_>, keep: Keep) -> Result<ParticleOutput, RunError> {
        let late = self.guard.kalman.model().late_channels().count();
        expect(late == 0, "late", late as f64, "0 sensors with a filter or a delay where a cloud is smoothed")?;
        self.reset();
        let (count, d) = (recording.dt.len(), self.belief.mean.len());
        let mut history = CloudHistory::with_capacity(count, d, self.model.memory())?;
        let mut out = self.run_with(recording, keep, |filter| {
            filter.take_covariance();
            history.push(&filter.belief, &filter.memory);
        })?;
        (out.best, out.quantiles) = (Vec::new(), Vec::new());
        let mut back = BackwardPass::new(d);
        let watch = Watch::current();
        for i in (0..count).rev() {
            if watch.stops() {
                return Err(RunError::Interrupted { sample: i });
            }
            history.read(i, &mut back.filtered);
            if i + 1 == count {
                back.smoothed.copy_from(&back.filtered);
            } else {
                // Time and commanded jerk belong to the sample at which a step ends.
                let next = recording.sample(i + 1, &self.model);
                back.step(self.model.jerk_model(), self.model.noise(), next.dt, next.inputs.jerk);
            }
            let motors = &history.motors[i * self.memory.len()..][..self.memory.len()];
            out.report_belief(i, self, motors, &back.smoothed, keep);
        }
        self.add_tolerances(recording, keep, &mut out.links)?;
        Ok(out)
    }

    /// Adds to smoothed covariances what tolerances add to those of the Kalman filter's smoother.
    fn add_tolerances(
        &self,
        recording: KalmanRecording<'_>,
        keep: Keep,
        out: &mut FilterOutput,
    ) -> Result<(), RunError> {
        let mut kalman = self.guard.kalman.clone();
        kalman.reset();
        if kalman.model().tolerances().is_empty() {
            return Ok(());
        }
        let with = Smoother::new(&kalman).run(recording, keep)?;
        let without = Smoother::new(&kalman.without_tolerances()).run(recording, keep)?;
        let stds = [(&mut out.q_std, with.q_std, without.q_std), (&mut out.tool_std, with.tool_std, without.tool_std)];
        for (own, with, without) in stds {
            for (own, (with, without)) in own.iter_mut().zip(with.iter().zip(&without)) {
                *own = (*own * *own + (with * with - without * without).max(0.0)).sqrt();
            }
        }
        for (own, (with, without)) in out.covariance.iter_mut().zip(with.covariance.iter().zip(&without.covariance)) {
            *own += with - without;
        }
        Ok(())
    }

    /// As [`run_each`](Self::run_each), each recording [smoothed](Self::smooth).
    pub fn smooth_each(jobs: &[(&Self, KalmanRecording<'_>)], keep: Keep) -> Vec<Result<ParticleOutput, RunError>> {
        Self::each(jobs, |filter, recording| filter.smooth(recording, keep))
    }
}
