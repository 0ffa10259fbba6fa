//! How a motor position corrects its joint, and whether the two go together.

use super::late::{JointCovariance, READING, VaryingGain};
use super::sampled::{JointState, ORDER, Sampled};
use super::settings::Start;

/// An observer bridges a motor position that is missing for up to this long [s].
pub const LONGEST: f64 = 0.05;

/// Time over which innovations are judged [s].
const WINDOW: f64 = 0.05;
/// An innovation that noise alone does not make, in multiples of what a position reading may be off by.
const NOISE: f64 = 5.0;

/// The gain of one joint as it depends on when its position was last read.
#[derive(Clone, Debug)]
pub(super) struct JointCorrection {
    /// Where the gains for gaps and for the start come from.
    late: VaryingGain,
    /// Gains for positions 2, 3, … samples apart; NaN where not yet asked for.
    gains: Vec<JointState>,
    /// Samples since the last position.
    since: usize,
    /// Samples and positions of a start that is under way.
    begun: Option<(u32, u32)>,
    /// Covariance of the joint's state during a start, in the units of [`VaryingGain`].
    spread: JointCovariance,
    /// Share of a new innovation in the mean of their squares, that mean, and what it is at most.
    share: f64,
    square: f64,
    limit: f64,
}

impl JointCorrection {
    /// For a joint whose innovations are at most about `most` [rad] where the model is about right, beside noise.
    pub(super) fn new(late: VaryingGain, period: f64, most: f64) -> Self {
        let longest = ((LONGEST / period).round() as usize).clamp(1, 1 << 16);
        Self {
            late,
            gains: vec![[f64::NAN; ORDER]; longest],
            since: 0,
            begun: None,
            spread: JointCovariance::default(),
            share: (period / WINDOW).min(1.0),
            square: 0.0,
            limit: (NOISE * READING).powi(2) + most.powi(2),
        }
    }

    /// At the first sample, whose position is taken as it is.
    pub(super) fn begin(&mut self, start: Start) {
        (self.since, self.square) = (0, 0.0);
        self.begun = (start == Start::Auto).then_some((0, 0));
        self.spread = self.late.first();
    }

    /// Whether a position must come now.
    pub(super) fn is_at_limit(&self) -> bool {
        self.since >= self.gains.len()
    }

    /// Takes an innovation into a predicted state; NaN where there is no position.
    #[inline(always)]
    pub(super) fn apply(&mut self, joint: &Sampled, x: &mut JointState, innovation: f64) {
        if self.begun.is_some() {
            return self.apply_at_start(joint, x, innovation);
        }
        self.since += 1;
        if innovation.is_nan() {
            return;
        }
        let gain = if self.since == 1 { joint.gain() } else { self.gain_after_gap(joint) };
        for (x, gain) in x.iter_mut().zip(gain) {
            *x += gain * innovation;
        }
        // An error of acceleration grows with the square of the time that it has.
        let grown = innovation / (self.since * self.since) as f64;
        self.square += (self.share * self.since as f64).min(1.0) * (grown * grown - self.square);
        self.since = 0;
    }

    /// The gain for a position after a gap; computed once for each length.
    #[cold]
    fn gain_after_gap(&mut self, joint: &Sampled) -> &JointState {
        let gap = self.since.min(self.gains.len() + 1);
        let kept = &mut self.gains[gap - 2];
        if kept[0].is_nan() {
            *kept = self.late.gain(joint.transition(), gap);
        }
        kept
    }

    /// As [`apply`](Self::apply), by the gains of a start.
    #[cold]
    fn apply_at_start(&mut self, joint: &Sampled, x: &mut JointState, innovation: f64) {
        let (samples, readings) = self.begun.unwrap_or_default();
        let reads = !innovation.is_nan();
        // The first innovation is zero, and the spread that of after it.
        if samples > 0 {
            let gain = self.late.start(joint.transition(), &mut self.spread, reads);
            if reads {
                for (x, gain) in x.iter_mut().zip(gain) {
                    *x += gain * innovation;
                }
            }
        }
        let (samples, readings) = (samples + 1, readings + u32::from(reads));
        self.since = if reads { 0 } else { self.since + 1 };
        self.begun = (!self.late.is_settled(samples, readings)).then_some((samples, readings));
    }

    /// Whether innovations have been larger than any of a model that is about right.
    pub(super) fn is_contradicted(&self) -> bool {
        self.square > self.limit
    }
}
