//! How a motor position corrects its joint, and whether the two go together.

use super::joint_error::Used;
use super::late::{JointCovariance, READING, VaryingGain};
use super::sampled::{JointState, ORDER, Sampled};
use super::settings::Start;

/// An observer bridges a motor position that is missing for up to this long [s].
pub const LONGEST: f64 = 0.05;

/// Time over which innovations are judged [s].
pub(super) const WINDOW: f64 = 0.05;
/// An innovation that noise alone does not make, in multiples of what a position reading may be off by.
const NOISE: f64 = 5.0;

/// Standard deviations of what is not known exactly within which innovations are no contradiction.
const REACH: f64 = 3.0;

/// A jump of the encoder is one from so many times on what innovations change by at most from one sample to the next.
const JUMP: f64 = 3.0;
/// The same in standard deviations of what they lately changed by.
const SCATTER: f64 = 8.0;
/// Part of a jump that counts below which what it did is over.
const OVER: f64 = 1e-3;

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
    /// What the variance of an innovation is to be [rad²]; and where that is known, the means of these variances and of innovations.
    surprise: Option<f64>,
    allowed: f64,
    mean: f64,
    /// By how much the encoder reads too much since it jumped, what that has done to the joint's state, and whether that lasts.
    slip: f64,
    error: JointState,
    slipped: bool,
    /// The last innovation less what that adds to it, mean square of its changes, and from which size on a jump counts.
    last: f64,
    scatter: f64,
    jump: f64,
    /// Which state is the link's position.
    link: usize,
}

impl JointCorrection {
    /// For a joint whose innovations are at most about `most` [rad] where the model is about right, and `change` by so much in
    /// a period, beside noise; `link` is the state that is its link's position.
    pub(super) fn new(late: VaryingGain, period: f64, [most, change]: [f64; 2], link: usize) -> Self {
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
            surprise: None,
            allowed: 0.0,
            mean: 0.0,
            slip: 0.0,
            error: JointState::default(),
            slipped: false,
            last: f64::NAN,
            scatter: 0.0,
            jump: NOISE * READING + JUMP * change,
            link,
        }
    }

    /// At the first sample, whose position is taken as it is.
    pub(super) fn begin(&mut self, start: Start) {
        (self.since, self.square) = (0, 0.0);
        (self.allowed, self.mean) = (0.0, 0.0);
        (self.slip, self.error, self.slipped) = (0.0, JointState::default(), false);
        (self.last, self.scatter) = (f64::NAN, 0.0);
        self.begun = (start == Start::Auto).then_some((0, 0));
        self.spread = self.late.first();
    }

    /// Whether a position must come now.
    pub(super) fn is_at_limit(&self) -> bool {
        self.since >= self.gains.len()
    }

    /// What the variance of the next innovation is to be [rad²].
    #[inline(always)]
    pub(super) fn expect(&mut self, surprise: f64) {
        self.surprise = Some(surprise);
    }

    /// Mean square of the innovations, and the mean of what was expected of it [rad²].
    #[inline(always)]
    pub(super) fn means(&self) -> [f64; 2] {
        [self.square, self.allowed]
    }

    /// Takes an innovation into a predicted state; NaN where there is no position. Says how.
    #[inline(always)]
    pub(super) fn apply(&mut self, joint: &Sampled, x: &mut JointState, innovation: f64) -> Used {
        if self.begun.is_some() {
            return self.apply_at_start(joint, x, innovation);
        }
        self.since += 1;
        if self.slipped {
            self.error = joint.transition().map(|row| row.iter().zip(&self.error).map(|(a, b)| a * b).sum());
        }
        if innovation.is_nan() {
            return Used::Nothing;
        }
        let (gain, used) = if self.since == 1 {
            (*joint.gain(), Used::Poles)
        } else {
            let gain = *self.gain_after_gap(joint);
            (gain, Used::Gain(gain))
        };
        for (x, gain) in x.iter_mut().zip(&gain) {
            *x += gain * innovation;
        }
        self.follow_slip(&gain, innovation);
        // An error of acceleration grows with the square of the time that it has.
        let (time, share) = ((self.since * self.since) as f64, (self.share * self.since as f64).min(1.0));
        let grown = self.last / time;
        self.square += share * (grown * grown - self.square);
        if let Some(surprise) = self.surprise {
            self.mean += share * (grown - self.mean);
            self.allowed += share * (surprise / (time * time) - self.allowed);
        }
        self.since = 0;
        used
    }

    /// What a jump of the encoder does, the observer following it: that is off for as long as the encoder is, though
    /// innovations soon are as small as before. Leaves the innovation less that.
    #[inline(always)]
    fn follow_slip(&mut self, gain: &JointState, innovation: f64) {
        let news = innovation - (self.slip - self.error[0]);
        let change = news - self.last;
        self.last = news;
        if self.since == 1 && change * change > self.jump * self.jump + SCATTER * SCATTER * self.scatter {
            let after = self.slip + change;
            // One that takes back what was there before is the end of it.
            self.last -= change;
            self.slip = if after.abs() > self.jump { after } else { 0.0 };
            self.slipped = true;
        } else if change.is_finite() {
            self.scatter += self.share * (change * change - self.scatter);
        }
        if self.slipped {
            let pull = self.slip - self.error[0];
            self.error.iter_mut().zip(gain).for_each(|(error, gain)| *error += gain * pull);
            self.slipped = self.slip != 0.0 || self.error[self.link].abs() > OVER * self.jump;
        }
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
    fn apply_at_start(&mut self, joint: &Sampled, x: &mut JointState, innovation: f64) -> Used {
        let (samples, readings) = self.begun.unwrap_or_default();
        let reads = !innovation.is_nan();
        let mut used = Used::Nothing;
        // The first innovation is zero, and the spread that of after it.
        if samples > 0 {
            let gain = self.late.start(joint.transition(), &mut self.spread, reads);
            if reads {
                for (x, gain) in x.iter_mut().zip(gain) {
                    *x += gain * innovation;
                }
                used = Used::Gain(gain);
            }
        }
        let (samples, readings) = (samples + 1, readings + u32::from(reads));
        self.since = if reads { 0 } else { self.since + 1 };
        self.begun = (!self.late.is_settled(samples, readings)).then_some((samples, readings));
        used
    }

    /// Covariance of the joint's state at a first sample whose velocity is not known.
    pub(super) fn first_covariance(&self) -> JointCovariance {
        self.late.first_covariance()
    }

    /// Whether innovations have been larger than any of a model that is about right, or what a jump did to the link still is.
    ///
    /// Where it is known what the model may be off by, they may be larger by that; and as noise has no mean, a mean shows more
    /// than a mean square.
    pub(super) fn is_contradicted(&self) -> bool {
        let allowed = REACH * REACH * self.allowed;
        let leans = self.surprise.is_some() && self.mean * self.mean > READING * READING + allowed;
        leans || self.square > self.limit + allowed || (self.slipped && self.error[self.link].abs() > self.jump)
    }
}
