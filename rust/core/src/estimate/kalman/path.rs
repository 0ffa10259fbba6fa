//! A trajectory for a filter to be linearised at.

use super::gaussian::Gaussian;

/// States at all samples of a recording, and how much each reading counts there.
///
/// A filter that has one is the Kalman filter of the model linearised at these states; its own estimates change nothing of
/// the linearisation.
#[derive(Clone, Debug)]
pub(super) struct StatePath {
    /// Numbers a sample: states and channels.
    pub(super) states: usize,
    pub(super) channels: usize,
    /// The states (samples × states).
    pub(super) means: Vec<f64>,
    /// Weights of the readings (samples × channels).
    pub(super) weights: Vec<f64>,
}

impl StatePath {
    /// Samples.
    pub(super) fn len(&self) -> usize {
        self.means.len() / self.states
    }

    /// The state at sample `i`.
    #[inline(always)]
    pub(super) fn state(&self, i: usize) -> &[f64] {
        &self.means[i * self.states..][..self.states]
    }

    /// Weights of the readings of sample `i`.
    #[inline(always)]
    pub(super) fn weights(&self, i: usize) -> &[f64] {
        &self.weights[i * self.channels..][..self.channels]
    }

    /// Puts the state at sample `i` in the place of the mean, and gives what that was beyond it in `beyond`.
    #[inline(always)]
    pub(super) fn replace(&self, i: usize, belief: &mut Gaussian, beyond: &mut [f64]) {
        for ((beyond, mean), x) in beyond.iter_mut().zip(&mut belief.mean).zip(self.state(i)) {
            *beyond = *mean - x;
            *mean = *x;
        }
    }
}
