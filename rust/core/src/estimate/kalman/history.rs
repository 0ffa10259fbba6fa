//! What a smoother keeps of the filter's way forward.

use super::consider::Consider;
use super::consider_back::ConsiderHistory;
use super::correction::Correction;
use super::dependence::DependenceHistory;
use super::effect::EffectHistory;
use super::gaussian::{Gaussian, Innovation};
use super::model::Model;
use crate::error::DesignError;
use crate::memory::room;

/// What the filter knew at each sample of a stretch.
#[derive(Clone, Debug)]
pub(super) struct History {
    /// Number of states, and of numbers from one padded row to the next.
    states: usize,
    stride: usize,
    /// Time before each sample [s].
    pub(super) dt: Vec<f64>,
    /// x⁻, states a sample.
    pub(super) means: Vec<f64>,
    /// P⁻, states × stride a sample: the lion's share of the memory.
    covariances: Vec<f64>,
    /// H, channels × dense a sample.
    pub(super) jacobians: Vec<f64>,
    /// W of each reading, channels × stride a sample.
    corrections: Vec<f64>,
    /// Value and variance of each reading's innovation, after the readings before it.
    pub(super) innovations: Vec<Innovation>,
    /// Variance of each reading's own noise.
    pub(super) variances: Vec<f64>,
    /// How the errors of readings depend on each other; empty without sigma points.
    pub(super) dependence: DependenceHistory,
    /// What the model remembers.
    memories: Vec<f64>,
    /// Sensitivities to parameters; empty where nothing is uncertain.
    pub(super) consider: ConsiderHistory,
    /// What faults do; empty without.
    pub(super) effect: EffectHistory,
}

impl History {
    /// Room for `count` samples, all of it at once: a recording that is too long says so before it starts.
    pub(super) fn with_capacity(count: usize, model: &impl Model, stride: usize) -> Result<Self, DesignError> {
        let (d, m, states) = (model.dense(), model.channels(), model.states());
        Ok(Self {
            states,
            stride,
            dt: room(count, 1)?,
            means: room(count, states)?,
            covariances: room(count, states * stride)?,
            jacobians: room(count, m * d)?,
            corrections: room(count, m * stride)?,
            innovations: room(count, m)?,
            variances: room(count, m)?,
            dependence: DependenceHistory::with_capacity(count, model)?,
            memories: room(count, model.memory())?,
            consider: ConsiderHistory::default(),
            effect: EffectHistory::default(),
        })
    }

    /// The predicted covariance at sample `i`.
    #[inline(always)]
    pub(super) fn covariance(&self, i: usize) -> &[f64] {
        &self.covariances[i * self.states * self.stride..][..self.states * self.stride]
    }

    /// What the model remembered of sample `i`.
    #[inline(always)]
    pub(super) fn memory(&self, i: usize) -> &[f64] {
        let size = self.memories.len() / self.dt.len();
        &self.memories[i * size..][..size]
    }

    /// W at sample `i`, one padded row a channel: its gain is that over its innovation's standard deviation.
    #[inline(always)]
    pub(super) fn corrections(&self, i: usize) -> &[f64] {
        let size = self.corrections.len() / self.dt.len();
        &self.corrections[i * size..][..size]
    }

    /// Keeps x⁻ and P⁻, after a sample's time update.
    pub(super) fn push_prediction(&mut self, dt: f64, belief: &Gaussian, consider: Option<&Consider>) {
        if let Some(consider) = consider {
            self.consider.push_prediction(consider);
        }
        self.dt.push(dt);
        self.means.extend_from_slice(&belief.mean);
        self.covariances.extend_from_slice(&belief.covariance.data[..self.states * self.stride]);
    }

    /// Keeps rows of H, of W and innovations, after a sample's measurement update.
    pub(super) fn push_update(&mut self, model: &impl Model, correction: &Correction, consider: Option<&Consider>) {
        if let Some(consider) = consider {
            self.consider.push_update(consider);
        }
        self.jacobians.extend_from_slice(model.linearised().jacobian);
        self.corrections.extend_from_slice(correction.rows());
        self.innovations.extend_from_slice(&correction.innovations);
        self.variances.extend_from_slice(&correction.variances);
        self.dependence.push(model, correction, &mut self.variances);
        model.remember(&mut self.memories);
    }
}
