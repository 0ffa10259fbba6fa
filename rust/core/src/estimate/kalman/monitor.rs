//! A filter that judges itself: do its innovations look as it says they must?
//!
//! Three tests, each at about one false alarm in 10⁹ samples on Gaussian noise: the normalised innovation squared of a
//! sample and of windows of samples; each channel against the prediction and all other channels (W. Baarda 1968); and a
//! step in each channel with its signature in all others ([`Bank`]). Innovations that are correlated or smaller than the
//! filter says, as those of smooth motions are, make alarms rarer.

use super::bank::{Bank, News, StepEvidence};
use super::consider::Consider;
use super::correction::Correction;
use super::effect::{Effect, Step};
use super::findings::{Alarm, Findings, Judgement, LEAD};
use super::gaussian::Gaussian;
use super::isolation::{Isolation, Squares};
use super::model::Model;
use super::recording::KalmanSample;
use super::signal::{Fault, Signal, Turned};
use super::single::SingleUpdate;
use super::window_sum::WindowSum;
use crate::estimate::Status;
use crate::estimate::measurement::Channel;
use crate::estimate::slip::{Slip, SlipCheck};

/// Quantile of the normal distribution for the tests of single channels.
const DEVIATIONS: f64 = 6.5;
/// The same, squared.
const BOUND: f64 = DEVIATIONS * DEVIATIONS;
/// Windows over which the normalised innovation squared is summed, in samples.
const WINDOWS: [usize; 2] = [8, 64];
/// Windows of the steps' signatures that follow each other all the time, in samples.
const STEADY: [u32; 2] = [32, 256];
/// One that begins when a sample contradicts what was predicted.
const ONSET: u32 = 64;
/// Samples of it after which a channel may be named: lasting faults then differ from short ones and from a wrong model.
const LASTS: u32 = 4;
/// A fault below this many standard deviations of a reading cannot be distinguished from a wrong model or an encoder's steps.
const SMALL: f64 = 3.5;
/// A jump by this many standard deviations is named at once, because its effect on the filter is no longer linear.
const GROSS: f64 = 20.0;
/// Readings for each degree of freedom, because neighbours are correlated.
const CORRELATED: f64 = 4.0;
/// Part of a sample's contradiction that the channel must explain that is named: where many channels contradict, it is the
/// model.
const MOST_OF: f64 = 0.5;
/// The same of a window's.
const NEARLY_ALL: f64 = 0.8;
/// Samples that a filter remembers: what contradicts it longer is the same error again.
const MEMORY: f64 = 16.0;
/// Mean square of all residuals of the longest window from which on the knowledge of the parameters is not trusted.
const LASTING: f64 = 4.0;
/// A sample counts there by no more than such a mean square.
const SHOCK: f64 = 16.0;

/// Part of its last slip within which an encoder is back where it was.
const BACK: f64 = 0.1;

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
    /// How often each channel's reading came in a row, of encoders: their errors are that correlated (channels).
    runs: Vec<f64>,
    /// How far motors have turned meanwhile, by the velocities that the filter is given (n).
    turned: Vec<Turned>,
    /// The same of motors that go on, and how far each has slipped in all (n).
    slips: Vec<SlipCheck>,
    slipped: Vec<f64>,
    /// A sample's update as the banks go by it.
    update: SingleUpdate,
    /// Signatures of steps in the windows that are on all the time.
    steady: Bank,
    /// The same since a contradiction, and whether that window is on.
    onset: Bank,
    begun: bool,
    /// Σ r² less its mean over the longest window, and since readings contradict the model without a name.
    recent: f64,
    wrong: f64,
    /// Normalised innovations squared of the last samples: of what is noise, and of all, shocks cut off.
    sums: [WindowSum; 2],
    /// One sample's residuals.
    isolation: Isolation,
    /// Samples since the start.
    taken: u64,
    /// What faults do to the state; and the steps to go by in place of alarms, once all are known.
    pub(super) effect: Effect,
    script: Option<Vec<Step>>,
    /// What was found since the start.
    pub(super) findings: Findings,
}

impl Monitor {
    pub(super) fn new(model: &impl Model) -> Self {
        let m = model.channels();
        Self {
            signals: vec![Signal::NEW; m],
            turns: model.channel_kinds().iter().map(|c| matches!(c, Channel::Motor(_) | Channel::Link(_))).collect(),
            runs: vec![1.0; m],
            turned: vec![Turned::default(); model.robot().len()],
            slips: vec![SlipCheck::new(); model.robot().len()],
            slipped: vec![0.0; model.robot().len()],
            begun: false,
            recent: 0.0,
            wrong: 0.0,
            update: SingleUpdate::new(model),
            steady: Bank::new(model, model.tolerances().len(), &STEADY),
            onset: Bank::new(model, model.tolerances().len(), &[ONSET]),
            sums: WINDOWS.map(WindowSum::new),
            isolation: Isolation::new(m),
            taken: 0,
            effect: Effect::new(model),
            script: None,
            findings: Findings::new(),
        }
    }

    /// From now on goes by these steps, and looks for no others.
    pub(super) fn follow(&mut self, steps: &[Step]) {
        self.script = Some(steps.to_vec());
    }

    /// Forgets everything: the next sample is a recording's first.
    pub(super) fn reset(&mut self) {
        self.signals.fill(Signal::NEW);
        self.turned.fill(Turned::default());
        self.slips.fill(SlipCheck::new());
        self.slipped.fill(0.0);
        self.steady.restart();
        self.onset.restart();
        self.sums.iter_mut().for_each(WindowSum::clear);
        self.effect.reset();
        (self.begun, self.wrong) = (false, 0.0);
        (self.taken, self.script) = (0, None);
        self.findings.reset();
    }

    /// Judges a sample that `correction` has used, and that left `belief`; gives the flags of its row.
    #[inline(always)]
    pub(super) fn judge<M: Model>(
        &mut self,
        model: &mut M,
        belief: &Gaussian,
        sample: &KalmanSample<'_>,
        correction: &Correction,
        mut consider: Option<&mut Consider>,
    ) -> u8 {
        // What is known to be wrong goes on, and is no news.
        if self.effect.is_active() {
            self.effect.take(model, sample.dt, correction);
        }
        self.taken += 1;
        if self.script.is_some() {
            self.go_by_script(model, correction);
            return 0;
        }
        let [all, white] = self.isolation.load(correction, consider.as_deref(), &self.effect.signatures);
        // 1. Each channel by itself: stuck, saturated or dead readings need no model but that the prediction, or the motor, moves.
        let stuck = self.look(model, sample, correction);
        let slip = self.slip(model, sample);
        // 2. A step in some channel since a window began, by its signature in all of them.
        let jump = self.jump(correction);
        let (known, residuals, runs) = (&self.effect.signatures[..], &self.isolation.residuals[..], &self.runs[..]);
        let news = News { known, residuals, runs };
        self.update.take(model, correction);
        let update = (correction, &self.update);
        self.steady.update(model, sample.dt, update, news, consider.as_deref());
        if self.begun {
            self.onset.update(model, sample.dt, update, news, consider.as_deref());
        }
        // 3. All channels together, over one sample and over windows; then the one to name.
        let beyond = self.windows(all, white).max(jump.map_or(0.0, |jump| jump.deviations * jump.deviations));
        if self.findings.is_open() {
            self.wrong += self.isolation.excess();
        } else {
            self.wrong = self.recent;
        }
        let verdict = match self.repetition(stuck).or(slip) {
            Some(alarm) => Judgement::Channel(alarm),
            None => match self.alarm(model, consider.as_deref(), jump) {
                Judgement::Channel(alarm) => Judgement::Channel(alarm),
                _ if beyond > 0.0 => Judgement::Contradicted { fault: Fault::Unknown, squares: beyond },
                verdict => verdict,
            },
        };
        // 4. A contradiction without a name counts where it may have moved some link by more than is said of it.
        let matters = match verdict {
            Judgement::Contradicted { squares, .. } => {
                self.any_link(belief, consider.as_deref_mut(), |_, own, whole| squares * own > whole)
            }
            _ => false,
        };
        let now = self.taken - 1;
        let mut flags = self.findings.record(verdict, now, (&self.signals, &self.turns), matters);
        if let Some(channel) = self.findings.look_again(now, (&self.signals, &self.turns)) {
            self.effect.release(channel, now); // no step, and over when the channel has a new reading
        }
        if let Judgement::Channel(alarm) = verdict
            && self.findings.is_step(&alarm)
        {
            self.take_step(model, correction, alarm);
        }
        // 5. A row is faulty as long as the effect of faults on some link is not small. A link follows its motor's slips.
        if (self.effect.is_active() || self.slipped.iter().any(|slipped| *slipped != 0.0))
            && self.any_link(belief, consider, |j, _, whole| {
                self.effect.error[j].abs().max(self.slipped[j].abs()).powi(2) > whole
            })
        {
            self.findings.prolong(now);
            flags |= Status::CONTRADICTED | Status::FAULTY;
        }
        flags
    }

    /// Takes note of each channel's readings; gives one that repeats itself, and since how many samples.
    #[inline(always)]
    fn look(&mut self, model: &impl Model, sample: &KalmanSample<'_>, correction: &Correction) -> Option<(usize, u32)> {
        let mut stuck = None;
        for (i, reading) in sample.readings.iter().enumerate().filter(|(_, r)| !r.is_nan()) {
            // Of what is shut out there is nothing to compare with.
            let used = correction.innovations[i].is_used();
            let predicted = if used { reading - correction.raw[i] } else { *reading };
            self.signals[i].take(*reading, predicted);
            if self.turns[i] {
                let run = self.signals[i].run;
                self.runs[i] = f64::from(run);
                if let (Channel::Motor(j), false) = (model.channel_kinds()[i], sample.inputs.dtheta.is_empty()) {
                    self.turned[j].take(run, sample.inputs.dtheta[j], sample.dt);
                    let turned = self.turned[j];
                    stuck = stuck.or(turned.is_stuck(model.variance(i)).then(|| (i, turned.samples - 1)));
                }
            } else if self.signals[i].is_stuck(model.variance(i)) {
                stuck = stuck.or(Some((i, self.signals[i].run - 2)));
            }
        }
        stuck
    }

    /// A motor position that goes off from where its velocity brings it, unless a finding of another channel goes on.
    #[inline(always)]
    fn slip(&mut self, model: &impl Model, sample: &KalmanSample<'_>) -> Option<Alarm> {
        let mut found = None;
        for (i, kind) in model.channel_kinds().iter().enumerate() {
            let Channel::Motor(j) = *kind else { continue };
            let Some(&velocity) = sample.inputs.dtheta.get(j) else { continue };
            let variance = model.variance(i);
            if let Some(slip) = self.slips[j].take(sample.dt, sample.readings[i], variance, velocity) {
                let Slip { size, deviations, samples: age } = slip;
                let whole = self.slipped[j] + size;
                self.slipped[j] = if whole.abs() < BACK * size.abs() { 0.0 } else { whole };
                found =
                    Some(Alarm { channel: i, size, deviations, age, variance, bank: None, fault: Some(Fault::Drift) });
            }
        }
        found.filter(|alarm| self.findings.channel().is_none_or(|open| open == alarm.channel))
    }

    /// Lets those steps begin that began at the sample last taken.
    fn go_by_script(&mut self, model: &impl Model, correction: &Correction) {
        let now = self.taken - 1;
        for step in self.script.iter().flatten().filter(|step| step.since == now) {
            self.effect.begin(model, correction, *step, 0.0);
        }
    }

    /// Propagates the effect of a fault from now on; the search for others starts again.
    fn take_step(&mut self, model: &impl Model, correction: &Correction, alarm: Alarm) {
        let Alarm { channel, size, age, variance, bank, .. } = alarm;
        let now = self.taken - 1;
        let step = Step { channel, since: now.saturating_sub(u64::from(age)), found: now, size };
        match bank {
            Some(w) if w < STEADY.len() => self.effect.join(self.steady.effect(w, channel), step, variance),
            Some(_) => self.effect.join(self.onset.effect(0, channel), step, variance),
            None => self.effect.begin(model, correction, step, variance),
        }
        self.steady.restart();
        self.onset.restart();
        self.begun = false;
    }

    /// Whether some link is `beyond` by its number, the filter's own variance of it, and that with what parameters add.
    #[inline(always)]
    fn any_link(
        &self,
        belief: &Gaussian,
        mut consider: Option<&mut Consider>,
        beyond: impl Fn(usize, f64, f64) -> bool,
    ) -> bool {
        let joints = self.effect.joints;
        if let Some(consider) = &mut consider {
            consider.sum_up(joints);
        }
        let total = |j: usize| consider.as_ref().map_or(0.0, |consider| consider.total[j * joints + j]);
        (0..joints).any(|j| {
            let own = belief.covariance.at(j, j);
            beyond(j, own, own + total(j))
        })
    }

    /// By how much a sample's sum, or a window's, is beyond its mean where it is beyond its bound, of what a filter remembers
    /// of it, the most of all; else 0. Infinite where readings are so far off for long that parameters must be as well.
    #[inline(always)]
    fn windows(&mut self, all: Squares, white: Squares) -> f64 {
        let mut most = beyond(all, 1.0);
        let cut = Squares { sum: all.sum.min(SHOCK * all.count), ..all };
        for (sums, length) in self.sums.iter_mut().zip(WINDOWS) {
            let [noise, whole] = sums.take([white, cut]);
            self.recent = noise.excess();
            if length == WINDOWS[1] && whole.sum > LASTING * whole.count && self.taken >= length as u64 {
                return f64::INFINITY;
            }
            most = most.max(beyond(noise, CORRELATED) * remembered(length));
        }
        most
    }

    /// A channel that contradicts all others at this sample; a window begins with it, unless one is on.
    #[inline(always)]
    fn jump(&mut self, correction: &Correction) -> Option<Alarm> {
        if self.onset.is_over(0) {
            self.begun = false;
        }
        let news = self.isolation.squares();
        // Below that no single channel can be beyond its own bound.
        let alarm = (news > BOUND).then(|| self.isolation.worst(correction, self.findings.channel()))?;
        if alarm.deviations <= DEVIATIONS || alarm.deviations.powi(2) <= MOST_OF * news {
            return None;
        }
        if !self.begun {
            self.begun = true;
            self.onset.restart();
        }
        Some(alarm)
    }

    /// The channel that repeats itself, unless a finding of another goes on.
    fn repetition(&self, stuck: Option<(usize, u32)>) -> Option<Alarm> {
        let (channel, age) =
            stuck.filter(|(channel, _)| self.findings.channel().is_none_or(|open| open == *channel))?;
        let deviations = f64::from(self.signals[channel].run);
        Some(Alarm { channel, size: 0.0, deviations, age, variance: 0.0, bank: None, fault: None })
    }

    /// The channel to name, if one explains what is wrong; while a finding goes on, its channel alone.
    #[inline(always)]
    fn alarm(&mut self, model: &impl Model, consider: Option<&Consider>, jump: Option<Alarm>) -> Judgement {
        let (now, only) = (self.taken - 1, self.findings.channel());
        // Where a model was wrong before a fault began, the channel must explain most of all since then.
        let unnamed = self.findings.unnamed();
        let wrong = |age: u64| if unnamed.is_some_and(|since| since + age + LEAD < now) { self.wrong } else { 0.0 };
        if let Some(jump) = jump
            .filter(|jump| only.is_some() || (jump.deviations > GROSS && jump.deviations.powi(2) > MOST_OF * wrong(0)))
        {
            return Judgement::Channel(jump);
        }
        if self.begun && self.onset.age(0) < LASTS && only.is_none() {
            return Judgement::Good;
        }
        let (mut verdict, mut most) = (Judgement::Good, 0.0);
        for index in 0..STEADY.len() + usize::from(self.begun) {
            let (bank, w) = if index < STEADY.len() { (&mut self.steady, index) } else { (&mut self.onset, 0) };
            let Some(StepEvidence { channel, ratio, drop, size, variance }) = bank.worst(w, consider, BOUND, only)
            else {
                continue;
            };
            let age = bank.age(w) - 1;
            let explains = drop > NEARLY_ALL * bank.excess(w).max(wrong(u64::from(age)))
                && size * size > SMALL * SMALL * model.variance(channel);
            if only.is_none() && !explains {
                if let Judgement::Good = verdict {
                    let squares = drop * remembered(bank.age(w) as usize);
                    verdict = Judgement::Contradicted { fault: Fault::Correlated, squares };
                }
            } else if drop > most {
                let alarm =
                    Alarm { channel, size, deviations: ratio.sqrt(), age, variance, bank: Some(index), fault: None };
                (verdict, most) = (Judgement::Channel(alarm), drop);
            }
        }
        verdict
    }
}

/// By how much a sum is beyond its mean where it is beyond its bound, else 0.
#[inline(always)]
fn beyond(squares: Squares, correlated: f64) -> f64 {
    // A bound is more than its mean: that of most samples need not be known.
    let Squares { sum, count } = squares;
    if sum > count && sum > bound(count, correlated) { squares.excess() } else { 0.0 }
}

/// Share of a window of this many samples that a filter remembers.
fn remembered(samples: usize) -> f64 {
    (MEMORY / samples as f64).min(1.0)
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
