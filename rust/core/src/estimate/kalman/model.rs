//! What a Kalman filter asks of a model.

use super::gaussian::{Gaussian, Symmetric};
use super::output::FilterOutput;
use super::recording::{KalmanRecording, KalmanSample};
use crate::error::DesignError;
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

    /// Takes over a first sample at which the belief is known.
    fn resume(&mut self, sample: &KalmanSample<'_>, belief: &Gaussian);

    /// Time update from the sample before: x ← f(x), P ← F P Fᵀ + Q.
    fn predict(&mut self, sample: &KalmanSample<'_>, belief: &mut Gaussian);

    /// Predicts the channels of the sample last predicted to, and their derivatives, at a state's first
    /// [`dense`](Self::dense) entries.
    fn linearise(&mut self, reference: &[f64]);

    /// What [`linearise`](Self::linearise) found.
    fn linearised(&self) -> Linearised<'_>;

    /// Variance of a channel's noise, where the model was linearised.
    fn variance(&self, channel: usize) -> f64;

    /// Whether what drives the model was missing at the sample last predicted to, and was bridged.
    fn bridged(&self) -> bool {
        false
    }

    /// How many numbers [`remember`](Self::remember) writes.
    fn memory(&self) -> usize;

    /// What [`report`](Self::report) and [`retreat`](Self::retreat) need of this sample.
    fn remember(&self, memory: &mut Vec<f64>);

    /// Writes rows Gᵀ with G Gᵀ = Q of [`predict`](Self::predict), one a state, `stride` apart, into `rows`, which are zero.
    fn noise_rows(&mut self, memory: &[f64], dt: f64, rows: &mut [f64], stride: usize);

    /// The adjoint of [`predict`](Self::predict) without its noise: λ ← Fᵀ λ, Λ ← Fᵀ Λ F.
    fn retreat(&mut self, memory: &[f64], dt: f64, lambda: &mut [f64], big: &mut Symmetric);

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
