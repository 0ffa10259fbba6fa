//! A filter that judges itself: do its innovations look as it says they must?
//!
//! Three tests, each at about one false alarm in 10⁹ samples on Gaussian noise: the normalised innovation squared of a
//! sample and of windows of samples; each channel against the prediction and all other channels (W. Baarda 1968); and a
//! step in each channel with its signature in all others ([`Bank`]). Innovations that are correlated or smaller than the
//! filter says, as those of smooth motions are, make alarms rarer.

use super::bank::Bank;
use super::consider::Consider;
use super::correction::Correction;
use super::model::Model;
use super::signal::{Fault, Signal};
use crate::estimate::Status;
use crate::estimate::measurement::Channel;

/// Quantile of the normal distribution for the tests of single channels.
const DEVIATIONS: f64 = 6.5;
/// Windows over which the normalised innovation squared is summed, in samples.
const WINDOWS: [usize; 3] = [1, 8, 64];
/// Windows of the steps' signatures, in samples.
const BANKS: [u32; 2] = [32, 256];
/// So many times fewer degrees of freedom than readings, as neighbours are correlated.
const CORRELATED: f64 = 4.0;
/// Part of a sample's contradiction that the channel must explain that is named: where many channels contradict, it is the
/// model.
const MOST_OF: f64 = 0.5;
/// Samples without an alarm after which a finding is over.
const CALM: u64 = 256;
/// Findings that are kept.
const MOST: usize = 64;

/// A channel whose readings contradict the model and all other channels.
#[derive(Clone, Copy, Debug)]
pub struct Finding {
    /// Which; none where no single channel explains it.
    pub channel: Option<usize>,
    /// The first sample that shows it, counted from the start.
    pub since: u64,
    /// The last.
    pub until: u64,
    /// How far off readings were when it was found [the channel's unit].
    pub size: f64,
    /// The same in standard deviations.
    pub deviations: f64,
    /// What the readings look like.
    pub fault: Fault,
}

/// Tests on the innovations of a filter.
///
/// A few thousand operations a sample for six joints, nearly all of them the banks'. It never changes the estimate:
/// what it finds is a flag of the row and a line in the list, for whoever has to decide.
#[derive(Clone, Debug)]
pub(super) struct Monitor {
    /// What each channel's readings look like by themselves (channels).
    signals: Vec<Signal>,
    /// Whether a channel is an encoder's, which may wrap and stands still with its joint.
    turns: Vec<bool>,
    /// Signatures of steps, over a short window and a long one.
    banks: [Bank; 2],
    /// Normalised innovations squared and readings of the last samples, in a ring.
    ring: Vec<(f64, u32)>,
    /// Innovations in their standard deviations, less what parameters explain; NaN where not used (channels).
    residuals: Vec<f64>,
    /// Standard deviations of the innovations, with what parameters may do to them (channels).
    std: Vec<f64>,
    /// Scratch of the test of single channels: Λ ν and columns of L⁻¹ (channels).
    pull: Vec<f64>,
    solution: Vec<f64>,
    /// Samples since the start, and since the last alarm.
    taken: u64,
    calm: u64,
    /// The finding that goes on.
    open: Option<usize>,
    /// All findings since the start, at most [`MOST`].
    pub(super) findings: Vec<Finding>,
}

impl Monitor {
    pub(super) fn new(model: &impl Model) -> Self {
        let m = model.channels();
        Self {
            signals: vec![Signal::NEW; m],
            turns: model.channel_kinds().iter().map(|c| matches!(c, Channel::Motor(_) | Channel::Link(_))).collect(),
            banks: BANKS.map(|length| Bank::new(model, model.tolerances().len(), length)),
            ring: vec![(0.0, 0); WINDOWS[2]],
            residuals: vec![f64::NAN; m],
            std: vec![1.0; m],
            pull: vec![0.0; m],
            solution: vec![0.0; m],
            taken: 0,
            calm: 0,
            open: None,
            findings: Vec::with_capacity(MOST),
        }
    }

    /// Forgets everything: the next sample is a recording's first.
    pub(super) fn reset(&mut self) {
        self.signals.fill(Signal::NEW);
        self.banks.iter_mut().for_each(Bank::restart);
        self.ring.fill((0.0, 0));
        (self.taken, self.calm, self.open) = (0, 0, None);
        self.findings.clear();
    }

    /// Judges a sample that `correction` has used; gives the flags of its row.
    #[inline(always)]
    pub(super) fn judge(
        &mut self,
        model: &mut impl Model,
        dt: f64,
        correction: &Correction,
        readings: &[f64],
        consider: Option<&Consider>,
    ) -> u8 {
        let (nis, used) = self.load(correction, consider);
        let mut stuck = None;
        for (i, reading) in readings.iter().enumerate().filter(|(_, r)| !r.is_nan()) {
            // 1. Each channel by itself: stuck, saturated or dead readings need no model but that the prediction moves.
            let predicted = reading - self.whole_innovation(correction, i);
            self.signals[i].take(*reading, predicted);
            if !self.turns[i] && self.signals[i].is_stuck(model.variance(i)) {
                stuck = stuck.or(Some(i));
            }
        }
        // 2. A step in some channel since the window began, by its signature in all of them.
        for bank in &mut self.banks {
            bank.update(model, dt, correction, consider);
        }
        // 3. All channels together, over one sample and over windows; then the one to name.
        let row = self.windows(nis, used);
        let alarm = self.alarm(correction, consider, nis, stuck);
        self.taken += 1;
        self.record(row, alarm)
    }

    /// Residuals in standard deviations with what the parameters explain; their sum of squares and number.
    #[inline(always)]
    fn load(&mut self, correction: &Correction, consider: Option<&Consider>) -> (f64, u32) {
        let (mut nis, mut used) = (0.0, 0);
        for (i, innovation) in correction.innovations.iter().enumerate() {
            let (residual, factor) = match consider {
                Some(c) => (c.residuals[i], c.factor(i)),
                None => (innovation.value / innovation.variance.sqrt(), 1.0),
            };
            if innovation.variance.is_infinite() {
                self.residuals[i] = f64::NAN;
                continue;
            }
            self.residuals[i] = residual;
            self.std[i] = innovation.variance.sqrt() * factor;
            nis += residual * residual;
            used += 1;
        }
        (nis, used)
    }

    /// Channel `i`'s reading less its prediction before any channel was used.
    #[inline(always)]
    fn whole_innovation(&self, correction: &Correction, i: usize) -> f64 {
        let m = self.signals.len();
        let earlier = (0..i).filter(|&j| correction.innovations[j].variance.is_finite());
        let shared: f64 = earlier.map(|j| correction.factors[i * m + j] * correction.innovations[j].value).sum();
        correction.innovations[i].value + shared
    }

    /// Whether a window's sum is beyond its bound.
    #[inline(always)]
    fn windows(&mut self, nis: f64, used: u32) -> bool {
        let size = self.ring.len();
        let at = (self.taken % size as u64) as usize;
        self.ring[at] = (nis, used);
        WINDOWS.iter().any(|&length| {
            let (mut sum, mut count) = (0.0, 0);
            for k in 0..length.min(self.taken as usize + 1) {
                let (nis, used) = self.ring[(at + size - k) % size];
                sum += nis;
                count += used;
            }
            sum > bound(f64::from(count), if length == 1 { 1.0 } else { CORRELATED })
        })
    }

    /// The channel that contradicts the others most, if one does: which, size and deviations, since how many samples.
    #[inline(always)]
    fn alarm(
        &mut self,
        correction: &Correction,
        consider: Option<&Consider>,
        nis: f64,
        stuck: Option<usize>,
    ) -> Option<(usize, f64, f64, u32)> {
        if let Some(channel) = stuck {
            let run = self.signals[channel].run;
            return Some((channel, 0.0, f64::from(run), run - 2));
        }
        // Below that no single channel can be beyond its own bound.
        if nis > DEVIATIONS * DEVIATIONS {
            let (channel, size, deviations) = self.isolate(correction);
            if deviations > DEVIATIONS && deviations * deviations > MOST_OF * nis {
                return Some((channel, size, deviations, 0));
            }
        }
        let all = self.banks.iter_mut().map(|bank| (bank.worst(consider, DEVIATIONS * DEVIATIONS), bank.age));
        let ((channel, ratio, size), age) = all.max_by(|a, b| a.0.1.total_cmp(&b.0.1))?;
        (ratio > DEVIATIONS * DEVIATIONS).then(|| (channel, size, ratio.sqrt(), age))
    }

    /// Largest t = [Λν]ᵢ/√Λᵢᵢ: each channel against the prediction and all others, with ν = L e, Cov e diagonal.
    #[inline(always)]
    fn isolate(&mut self, correction: &Correction) -> (usize, f64, f64) {
        let (m, factors) = (self.signals.len(), &correction.factors);
        // Λ ν = L⁻ᵀ D⁻¹ e by back substitution: the factors that the sequential update left are those of S = L D Lᵀ.
        for i in (0..m).rev() {
            self.pull[i] = if self.residuals[i].is_finite() { self.residuals[i] / self.std[i] } else { 0.0 };
            for k in (i + 1..m).filter(|&k| self.residuals[k].is_finite()) {
                self.pull[i] -= factors[k * m + i] * self.pull[k];
            }
        }
        let mut worst = (0, 0.0, 0.0);
        for c in (0..m).filter(|&c| self.residuals[c].is_finite()) {
            let mut precision = 0.0;
            // Λ_cc = ‖D^(−1/2) L⁻¹ e_c‖², column c of L⁻¹ by forward substitution.
            for k in (c..m).filter(|&k| self.residuals[k].is_finite()) {
                self.solution[k] = if k == c { 1.0 } else { 0.0 };
                for j in (c..k).filter(|&j| self.residuals[j].is_finite()) {
                    self.solution[k] -= factors[k * m + j] * self.solution[j];
                }
                precision += (self.solution[k] / self.std[k]).powi(2);
            }
            let deviations = self.pull[c].abs() / precision.sqrt();
            if deviations > worst.2 {
                worst = (c, self.pull[c] / precision, deviations);
            }
        }
        worst
    }

    /// Opens, goes on with or ends a finding. While one goes on, what it does to the state is not another's fault.
    #[inline(always)]
    fn record(&mut self, row: bool, alarm: Option<(usize, f64, f64, u32)>) -> u8 {
        self.calm = if row || alarm.is_some() { 0 } else { self.calm + 1 };
        if self.calm > CALM {
            self.open = None;
        }
        let now = self.taken - 1;
        if let (Some((channel, size, deviations, age)), true) = (alarm, self.open_channel().is_none()) {
            let since = now.saturating_sub(u64::from(age));
            let fault = self.signals[channel].fault(size, self.turns[channel], now - since);
            self.push(Finding { channel: Some(channel), since, until: now, size, deviations, fault });
        } else if row && self.open.is_none() {
            let fault = Fault::Unknown;
            self.push(Finding { channel: None, since: now, until: now, size: 0.0, deviations: 0.0, fault });
        }
        let Some(open) = self.open else {
            return if self.calm == 0 { Status::CONTRADICTED } else { 0 };
        };
        let finding = &mut self.findings[open];
        finding.until = now;
        let Some(channel) = finding.channel else { return Status::CONTRADICTED };
        // A step may turn out as another kind while it goes on: a turned sign shows only when the robot moves.
        if finding.fault == Fault::Step && now < finding.since + 2 * CALM {
            finding.fault = self.signals[channel].fault(f64::INFINITY, self.turns[channel], now - finding.since);
        }
        Status::CONTRADICTED | Status::FAULTY
    }

    /// The channel of the finding that goes on.
    fn open_channel(&self) -> Option<usize> {
        self.open.and_then(|open| self.findings[open].channel)
    }

    /// Opens a finding, or again the one of the same channel and kind: a fault that comes and goes is one line.
    fn push(&mut self, finding: Finding) {
        let known = self.findings.iter().position(|f| f.channel == finding.channel && f.fault == finding.fault);
        self.open = known.or_else(|| {
            (self.findings.len() < MOST).then(|| {
                self.findings.push(finding);
                self.findings.len() - 1
            })
        });
    }
}

/// Bound of the sum of `used` normalised innovations squared, neighbours being correlated: of any number of samples it is
/// exceeded by chance once in 10¹⁰ times.
#[must_use]
pub fn largest_nis(used: f64) -> f64 {
    bound(used, CORRELATED)
}

/// Bound of a sum of squares of `count` normal numbers, of which `correlated` ones move together, at [`DEVIATIONS`]
/// (E. B. Wilson and M. M. Hilferty 1931).
fn bound(count: f64, correlated: f64) -> f64 {
    // (χ²/f)^(1/3) is nearly normal, with mean 1 − 2/(9 f) and variance 2/(9 f): no table, no iteration.
    let f = (count / correlated).max(1.0);
    let cube = 1.0 - 2.0 / (9.0 * f) + DEVIATIONS * (2.0 / (9.0 * f)).sqrt();
    f * correlated * cube * cube * cube
}
