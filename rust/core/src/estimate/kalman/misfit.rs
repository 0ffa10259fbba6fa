//! What a trajectory costs: minus the logarithm of its posterior density, but for a constant.

use super::filter::ExtendedKalmanFilter;
use super::gaussian::{Gaussian, Symmetric};
use super::loss::SensorLosses;
use super::path::StatePath;
use super::phases::{Linearise, Phases, Predict};
use super::recording::KalmanRecording;
use crate::error::RunError;
use crate::interrupt::Watch;
use crate::linear;
use crate::memory::filled;

/// A direction without this part of its variance given those before it has none: what it may be is rounding.
const LOST: f64 = 1e-12;

/// The sum that an iterated smoother minimises, of one recording.
pub(super) struct Misfit<'a, M> {
    /// Before the recording; a copy goes along with the samples.
    filter: &'a ExtendedKalmanFilter<M>,
    sensors: &'a SensorLosses,
    recording: KalmanRecording<'a>,
    /// Variances of the readings at the path that was last weighed (samples × channels).
    variances: Vec<f64>,
    /// Scratch: errors of readings squared, and what they count (channels).
    squares: Vec<f64>,
    weights: Vec<f64>,
}

impl<'a, M: Phases> Misfit<'a, M> {
    pub(super) fn new(
        filter: &'a ExtendedKalmanFilter<M>,
        sensors: &'a SensorLosses,
        recording: KalmanRecording<'a>,
    ) -> Result<Self, RunError> {
        let m = filter.model.channels();
        let variances = filled(0.0, recording.dt.len(), m)?;
        Ok(Self { filter, sensors, recording, variances, squares: vec![0.0; m], weights: vec![0.0; m] })
    }

    /// The sum at `path`; the weights there are its from now on, and the variances hold for the sums that follow.
    pub(super) fn weigh(&mut self, path: &mut StatePath) -> Result<f64, RunError> {
        let StatePath { means, weights, .. } = path;
        self.go(means, Some(weights))
    }

    /// The sum at these states (samples × states), by the variances of the path that was last weighed.
    pub(super) fn sum(&mut self, means: &[f64]) -> Result<f64, RunError> {
        self.go(means, None)
    }

    fn go(&mut self, means: &[f64], mut weights: Option<&mut Vec<f64>>) -> Result<f64, RunError> {
        let mut filter = self.filter.clone();
        let (states, m, watch) = (filter.model.states(), filter.model.channels(), Watch::current());
        let room = vec![0.0; states];
        let mut step = StepCost { belief: Gaussian::independent(&room), error: room.clone(), diagonal: room };
        let mut total = 0.0;
        for (i, state) in means.chunks_exact(states).enumerate() {
            if watch.stops() {
                return Err(RunError::Interrupted { sample: i });
            }
            let sample = self.recording.sample(i, &filter.model);
            if i == 0 {
                filter.advance(&sample)?;
                step.belief.copy_from(&filter.belief);
            } else {
                // From a state that is known, the covariance after a step is Q.
                step.belief.mean.copy_from_slice(&means[(i - 1) * states..][..states]);
                step.belief.covariance.data.fill(0.0);
                M::predict_phase(Predict { model: &mut filter.model, sample: &sample, belief: &mut step.belief });
            }
            total += step.cost(state);
            M::linearise_phase(Linearise {
                model: &mut filter.model,
                reference: &state[..filter.correction.reference.len()],
            });
            let variances = &mut self.variances[i * m..][..m];
            if weights.is_some() {
                variances.iter_mut().enumerate().for_each(|(c, variance)| *variance = filter.model.variance(c));
            }
            let (prediction, biases) = (filter.model.linearised().prediction, filter.model.biases());
            for (c, square) in self.squares.iter_mut().enumerate() {
                let error = sample.readings[c] - prediction[c] - biases[c].map_or(0.0, |b| state[b]);
                *square = error * error / variances[c];
            }
            total += self.sensors.weigh(&self.squares, &mut self.weights);
            if let Some(weights) = &mut weights {
                weights[i * m..][..m].copy_from_slice(&self.weights);
            }
        }
        Ok(total)
    }
}

/// One step of time: where it was to lead, and how sure that is.
struct StepCost {
    belief: Gaussian,
    /// Scratch (states).
    error: Vec<f64>,
    diagonal: Vec<f64>,
}

impl StepCost {
    /// ½ ‖x − x̄‖² in the measure of the inverse covariance, which is factored in its place; in directions without variance
    /// there is nothing to pay.
    fn cost(&mut self, state: &[f64]) -> f64 {
        let Self { belief: Gaussian { mean, covariance }, error, diagonal } = self;
        let Symmetric { n, stride, ref mut data } = *covariance;
        for ((error, x), mean) in error.iter_mut().zip(state).zip(mean) {
            *error = x - *mean;
        }
        let mut sum = 0.0;
        // z = U⁻ᵀ e, row by row of U, whose diagonal tells what was left of each variance.
        diagonal.iter_mut().enumerate().for_each(|(i, own)| *own = data[i * stride + i]);
        linear::upper_factor(data, n, stride);
        for i in 0..n {
            let pivot = data[i * stride + i];
            if pivot * pivot <= LOST * diagonal[i] {
                continue;
            }
            let z = error[i] / pivot;
            sum += 0.5 * z * z;
            linear::add_scaled(&mut error[i + 1..n], -z, &data[i * stride + i + 1..i * stride + n]);
        }
        sum
    }
}
