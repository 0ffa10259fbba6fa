//! What faults that were found have done to the state, and go on doing.
//!
//! A filter takes a fault up: an encoder that slipped agrees with it again after a few samples, and the estimate is off by
//! the slip from then on. Known faults are carried along as B. Friedland's separate bias (IEEE Trans. Automatic Control 14,
//! 1969): each a step in its channel, whose effect goes through the filter's own F and 1 − K H.

use super::correction::Correction;
use super::gaussian::Innovation;
use super::model::Model;
use crate::linear;

/// A fault below this many of its own standard deviations is over: the channel has recovered.
const RETURNED: f64 = 3.0;
/// Steps that are remembered.
const MOST: usize = 256;

/// A step in a channel's readings.
#[derive(Clone, Copy, Debug)]
pub(super) struct Step {
    pub(super) channel: usize,
    /// First sample that has it, and the sample at which it was found.
    pub(super) since: u64,
    pub(super) found: u64,
    /// By how much [the channel's unit].
    pub(super) size: f64,
}

/// The error of the state by all steps so far.
#[derive(Clone, Debug)]
pub(super) struct Effect {
    /// Steps so far, the first [`MOST`] of them; none without an effect.
    pub(super) steps: Vec<Step>,
    /// x − x̂ by these before and after a sample's readings (states).
    pub(super) before: Vec<f64>,
    pub(super) error: Vec<f64>,
    /// What it adds to each innovation, after the channels before it, in standard deviations (channels).
    pub(super) signatures: Vec<f64>,
    /// By how much each channel reads too much, and the variance of that (channels).
    faults: Vec<f64>,
    variances: Vec<f64>,
    /// Links, which the state begins with.
    pub(super) joints: usize,
}

impl Effect {
    pub(super) fn new(model: &impl Model) -> Self {
        let (m, states) = (model.channels(), model.states());
        Self {
            steps: Vec::with_capacity(MOST),
            before: vec![0.0; states],
            error: vec![0.0; states],
            signatures: vec![0.0; m],
            faults: vec![0.0; m],
            variances: vec![0.0; m],
            joints: model.robot().len(),
        }
    }

    /// Forgets all steps.
    pub(super) fn reset(&mut self) {
        self.steps.clear();
        for values in [&mut self.before, &mut self.error, &mut self.signatures, &mut self.faults, &mut self.variances] {
            values.fill(0.0);
        }
    }

    /// Whether there were steps.
    #[inline(always)]
    pub(super) fn is_active(&self) -> bool {
        !self.steps.is_empty()
    }

    /// Through the step of time and the update that `correction` has done.
    #[inline(always)]
    pub(super) fn take(&mut self, model: &mut impl Model, dt: f64, correction: &Correction) {
        model.carry_noise_free(&mut self.error, 1, dt);
        self.before.copy_from_slice(&self.error);
        self.update(model, correction);
    }

    /// From before the readings to after them: s = f + h (x − x̂), x − x̂ ← x − x̂ − k s, reading by reading; with W/√S for k.
    #[inline(always)]
    fn update(&mut self, model: &impl Model, correction: &Correction) {
        let (d, width) = (model.dense(), correction.rows().len() / self.faults.len());
        self.error.copy_from_slice(&self.before);
        for (i, innovation) in correction.innovations.iter().enumerate() {
            self.signatures[i] = 0.0;
            if !innovation.is_used() {
                continue;
            }
            let row = &model.linearised().jacobian[i * d..][..d];
            let bias = model.biases()[i].map_or(0.0, |b| self.error[b]);
            let signature = (self.faults[i] + linear::dot(row, &self.error[..d]) + bias) / innovation.std;
            linear::add_scaled(&mut self.error, -signature, &correction.rows()[i * width..][..width]);
            self.signatures[i] = signature;
        }
    }

    /// A step that began at the sample last taken.
    #[inline(always)]
    pub(super) fn begin(&mut self, model: &impl Model, correction: &Correction, step: Step, variance: f64) {
        self.add(step, variance);
        self.update(model, correction);
    }

    /// A step that began earlier, by what one of size 1 has done to each state since.
    #[inline(always)]
    pub(super) fn join(&mut self, since: impl Iterator<Item = f64>, step: Step, variance: f64) {
        self.add(step, variance);
        for (error, of_one) in self.error.iter_mut().zip(since) {
            *error += step.size * of_one;
        }
    }

    /// Takes note of a step; one that takes back what was there before ends the fault.
    #[inline(always)]
    fn add(&mut self, mut step: Step, variance: f64) {
        let (fault, doubt) = (&mut self.faults[step.channel], &mut self.variances[step.channel]);
        let (after, sum) = (*fault + step.size, *doubt + variance);
        (*fault, *doubt) = if after * after < RETURNED * RETURNED * sum {
            step.size = -*fault;
            (0.0, 0.0)
        } else {
            (after, sum)
        };
        if self.steps.len() < MOST {
            self.steps.push(step);
        }
    }

    /// A channel turns out to repeat itself: that is no step, and its effect is not known.
    pub(super) fn release(&mut self, channel: usize, now: u64) {
        self.add(Step { channel, since: now, found: now, size: -self.faults[channel] }, f64::MIN_POSITIVE);
    }
}

/// x⁻'s error and s at each sample of a stretch, from the first with an effect on.
#[derive(Clone, Debug, Default)]
pub(super) struct EffectHistory {
    first: usize,
    errors: Vec<f64>,
    signatures: Vec<f64>,
}

impl EffectHistory {
    /// After sample `i`'s measurement update.
    pub(super) fn push(&mut self, i: usize, effect: &Effect) {
        if self.errors.is_empty() {
            self.first = i;
        }
        self.errors.extend_from_slice(&effect.before);
        self.signatures.extend_from_slice(&effect.signatures);
    }

    /// Those of sample `i`, if there are any.
    fn at(&self, i: usize, states: usize, channels: usize) -> Option<(&[f64], &[f64])> {
        let at = i.checked_sub(self.first)?;
        let errors = self.errors.get(at * states..(at + 1) * states)?;
        Some((errors, &self.signatures[at * channels..][..channels]))
    }
}

/// Faults on a smoother's way back: its own recursion for λ, driven by s in place of innovations.
///
/// The smoothed state x⁻ − P⁻ λ is off by the error of x⁻ and P⁻ ∂λ, of rows before the fault as well.
#[derive(Clone, Debug)]
pub(super) struct EffectBack {
    /// What faults do to λ (states).
    lambda: Vec<f64>,
    joints: usize,
    /// All steps of a recording, as its last stretch knows them.
    pub(super) steps: Vec<Step>,
}

impl EffectBack {
    pub(super) fn new(states: usize, joints: usize) -> Self {
        Self { lambda: vec![0.0; states], joints, steps: Vec::new() }
    }

    /// The next stretch is a recording's last.
    pub(super) fn finish(&mut self) {
        self.lambda.fill(0.0);
        self.steps.clear();
    }

    /// Takes what was found by the end of a stretch that began at sample `first`, unless a later stretch has said it; gives
    /// whether some of it was found in this stretch.
    pub(super) fn learn(&mut self, steps: &[Step], first: u64) -> bool {
        if self.steps.is_empty() {
            self.steps.extend_from_slice(steps);
        }
        let last = steps.last().is_some_and(|step| step.found >= first);
        // What began before the stretch and was found in it counts from its first sample on.
        for step in self.steps.iter_mut().filter(|step| step.found >= first) {
            step.since = step.since.max(first);
        }
        last
    }

    /// Whether there were faults.
    #[inline(always)]
    pub(super) fn is_active(&self) -> bool {
        !self.steps.is_empty()
    }

    /// ∂λ from after sample `i`'s readings to before them, the last reading first.
    #[inline(always)]
    pub(super) fn back(
        &mut self,
        history: &EffectHistory,
        i: usize,
        innovations: &[Innovation],
        rows: &[f64],
        corrections: &[f64],
    ) {
        let (m, states) = (innovations.len(), self.lambda.len());
        let width = rows.len() / m;
        let driven = history.at(i, states, m);
        for a in (0..m).rev().filter(|&a| innovations[a].is_used()) {
            let signature = driven.map_or(0.0, |(_, signatures)| signatures[a]);
            let pull = signature + linear::dot(&corrections[a * width..][..states], &self.lambda);
            linear::add_scaled(&mut self.lambda, -pull / innovations[a].std, &rows[a * width..][..states]);
        }
    }

    /// Whether faults move some smoothed link of sample `i` by more than its standard deviation; `predicted` is P⁻ in rows of
    /// `stride`, `smoothed` holds the links' smoothed variances on its diagonal.
    #[inline(always)]
    pub(super) fn counts(
        &self,
        history: &EffectHistory,
        i: usize,
        channels: usize,
        predicted: &[f64],
        smoothed: &[f64],
        stride: usize,
    ) -> bool {
        let states = self.lambda.len();
        let before = history.at(i, states, channels);
        (0..self.joints).any(|j| {
            let error = before.map_or(0.0, |(errors, _)| errors[j])
                + linear::dot(&predicted[j * stride..][..states], &self.lambda);
            error * error > smoothed[j * stride + j]
        })
    }

    /// The adjoint of a step of time.
    #[inline(always)]
    pub(super) fn retreat(&mut self, model: &mut impl Model, memory: &[f64], dt: f64) {
        model.carry_back(memory, &mut self.lambda, 1, dt);
    }
}
