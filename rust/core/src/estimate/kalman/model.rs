//! What a Kalman filter asks of a model.

use super::gaussian::{Gaussian, Symmetric};
use super::output::FilterOutput;
use super::recording::{KalmanRecording, KalmanSample};
use super::uncertain::Tolerance;
use crate::error::DesignError;
use crate::estimate::measurement::Channel;
use crate::robot::Robot;

/// A process and the channels that measure it.
///
/// The state begins with the link positions (n). Channels depend on its first [`dense`](Self::dense) entries, and each
/// may have one further state that is its bias. Filter and smoother see nothing else of a model.
pub trait Model: Clone + Send + Sync {
    /// The robot.
    fn robot(&self) -> &Robot;

    /// Number of states.
    fn states(&self) -> usize;

    /// Number of leading states on which channels may depend by more than a bias.
    fn dense(&self) -> usize;

    /// The state that is each channel's bias (channels).
    fn biases(&self) -> &[Option<usize>];

    /// Number of channels.
    fn channels(&self) -> usize {
        self.biases().len()
    }

    /// What the channels are.
    fn channel_kinds(&self) -> &[Channel];

    /// Whether a recording has all that the model needs, in arrays that fit.
    ///
    /// # Errors
    /// Wrong lengths.
    fn check(&self, recording: &KalmanRecording<'_>) -> Result<(), DesignError>;

    /// The belief at a recording's first sample, at rest.
    ///
    /// # Errors
    /// A first sample without a motor position that it needs, or no static equilibrium.
    fn start(&mut self, sample: &KalmanSample<'_>, belief: &mut Gaussian) -> Result<(), DesignError>;

    /// Time update from the sample before: x ← f(x), P ← F P Fᵀ + Q.
    fn predict(&mut self, sample: &KalmanSample<'_>, belief: &mut Gaussian);

    /// Predicts the channels of the sample last predicted to, and their derivatives, at a state's first
    /// [`dense`](Self::dense) entries.
    fn linearise(&mut self, reference: &[f64]);

    /// What [`linearise`](Self::linearise) found.
    fn linearised(&self) -> Linearised<'_>;

    /// Variance of a channel's noise, where the model was linearised.
    fn variance(&self, channel: usize) -> f64;

    /// How many numbers [`remember`](Self::remember) writes.
    fn memory(&self) -> usize;

    /// What [`report`](Self::report) and [`retreat`](Self::retreat) need of this sample.
    fn remember(&self, memory: &mut Vec<f64>);

    /// The adjoint of [`predict`](Self::predict): λ ← Fᵀ λ, Λ ← Fᵀ Λ F.
    fn retreat(&mut self, memory: &[f64], dt: f64, lambda: &mut [f64], big: &mut Symmetric);

    /// Numbers of the robot that are known to a tolerance only, and count in covariances; none unless asked for.
    fn tolerances(&self) -> &[Tolerance] {
        &[]
    }

    /// Whether a channel may say something of the parameters. A motor's reading says it only by way of how smoothly
    /// links are taken to move, which is a guess.
    fn teaches(&self, _channel: usize) -> bool {
        true
    }

    /// Columns (states × `stride`, one a tolerance) through the step last predicted: Σ ← F Σ + ∂f/∂p.
    fn carry(&mut self, _columns: &mut [f64], _stride: usize, _dt: f64) {}

    /// The same without what parameters do: Σ ← F Σ.
    fn carry_noise_free(&mut self, columns: &mut [f64], stride: usize, dt: f64);

    /// The adjoint of what F does in [`carry`](Self::carry): Λ ← Fᵀ Λ.
    fn carry_back(&mut self, _memory: &[f64], _columns: &mut [f64], _stride: usize, _dt: f64) {}

    /// ∂h/∂p where the model was linearised (channels × `stride`).
    fn signatures(&mut self, _stride: usize, _out: &mut [f64]) {}

    /// Writes links and motors at `state` into row `i`.
    fn report(&mut self, memory: &[f64], state: &[f64], i: usize, out: &mut FilterOutput);
}

/// Channels at one state.
#[derive(Clone, Copy, Debug)]
pub struct Linearised<'a> {
    /// Predictions, without bias (channels).
    pub prediction: &'a [f64],
    /// Their derivatives, channels × dense, row-major.
    pub jacobian: &'a [f64],
}
