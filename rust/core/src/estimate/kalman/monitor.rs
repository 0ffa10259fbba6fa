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
use super::gaussian::Gaussian;
use super::model::Model;
use super::recording::KalmanSample;
use super::signal::{Fault, RUN, Signal};
use crate::estimate::Status;
use crate::estimate::measurement::Channel;

/// Quantile of the normal distribution for the tests of single channels.
const DEVIATIONS: f64 = 6.5;
/// The same, squared.
const BOUND: f64 = DEVIATIONS * DEVIATIONS;
/// Windows over which the normalised innovation squared is summed, in samples.
const WINDOWS: [usize; 3] = [1, 8, 64];
/// Windows of the steps' signatures, in samples: two that follow each other all the time, and one that begins when a sample
/// contradicts what was predicted.
const BANKS: [u32; 3] = [32, 256, 64];
/// Which that is.
const ONSET: usize = 2;
/// Samples of it after which a channel may be named: what lasts is told from what does not, and from a wrong model.
const LASTS: u32 = 4;
/// A fault below so many standard deviations of a reading is not told from a wrong model, nor from an encoder's steps.
const SMALL: f64 = 3.5;
/// A jump by so many standard deviations is named at once: what it does to a filter is not linear any more.
const GROSS: f64 = 20.0;
/// So many times fewer degrees of freedom than readings, as neighbours are correlated.
const CORRELATED: f64 = 4.0;
/// A contradiction without a name that began at most so many samples before a fault is the fault itself, as it begins.
const LEAD: u64 = 32;
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

/// A channel that is beyond its bound: by how much, since how many samples before this one, and the variance of that size.
#[derive(Clone, Copy, Debug)]
struct Alarm {
    channel: usize,
    size: f64,
    deviations: f64,
    age: u32,
    variance: f64,
    /// The window that tells; none: this sample alone.
    bank: Option<usize>,
}

/// What a sample comes to.
#[derive(Clone, Copy, Debug)]
enum Judgement {
    Good,
    /// Innovations lean to one side for long, and no channel explains it.
    Correlated,
    /// They are too large, and no channel explains it.
    Contradicted,
    Channel(Alarm),
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
    /// How often each channel's reading came in a row, of encoders: their errors are that correlated (channels).
    runs: Vec<f64>,
    /// Signatures of steps.
    banks: [Bank; 3],
    /// Whether the window that begins with a contradiction is on.
    onset: bool,
    /// Σ r² less its mean over the longest window, and since a finding without a channel began.
    recent: f64,
    wrong: f64,
    /// Normalised innovations squared and readings of the last samples, in a ring.
    ring: Vec<(f64, f64)>,
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
    /// The last finding with a channel.
    last_named: Option<usize>,
    /// What faults do to the state; and the steps to go by in place of alarms, once all are known.
    pub(super) effect: Effect,
    script: Option<Vec<Step>>,
    /// All findings since the start, at most [`MOST`].
    pub(super) findings: Vec<Finding>,
}

impl Monitor {
    pub(super) fn new(model: &impl Model) -> Self {
        let m = model.channels();
        Self {
            signals: vec![Signal::NEW; m],
            turns: model.channel_kinds().iter().map(|c| matches!(c, Channel::Motor(_) | Channel::Link(_))).collect(),
            runs: vec![1.0; m],
            onset: false,
            recent: 0.0,
            wrong: 0.0,
            banks: BANKS.map(|length| Bank::new(model, model.tolerances().len(), length)),
            ring: vec![(0.0, 0.0); WINDOWS[2]],
            residuals: vec![f64::NAN; m],
            std: vec![1.0; m],
            pull: vec![0.0; m],
            solution: vec![0.0; m],
            taken: 0,
            calm: 0,
            open: None,
            last_named: None,
            effect: Effect::new(model),
            script: None,
            findings: Vec::with_capacity(MOST),
        }
    }

    /// From now on goes by these steps, and looks for no others.
    pub(super) fn follow(&mut self, steps: &[Step]) {
        self.script = Some(steps.to_vec());
    }

    /// Forgets everything: the next sample is a recording's first.
    pub(super) fn reset(&mut self) {
        self.signals.fill(Signal::NEW);
        self.banks.iter_mut().for_each(Bank::restart);
        self.ring.fill((0.0, 0.0));
        self.effect.reset();
        (self.onset, self.wrong) = (false, 0.0);
        (self.taken, self.calm, self.open, self.last_named, self.script) = (0, 0, None, None, None);
        self.findings.clear();
    }

    /// Judges a sample that `correction` has used, and that left `belief`; gives the flags of its row.
    #[inline(always)]
    pub(super) fn judge<M: Model>(
        &mut self,
        model: &mut M,
        belief: &Gaussian,
        sample: &KalmanSample<'_>,
        correction: &Correction,
        consider: Option<&mut Consider>,
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
        let (nis, used) = self.load(correction, consider.as_deref());
        let mut stuck = None;
        for (i, reading) in sample.readings.iter().enumerate().filter(|(_, r)| !r.is_nan()) {
            // 1. Each channel by itself: stuck, saturated or dead readings need no model but that the prediction moves.
            let predicted = reading - self.whole_innovation(correction, i);
            self.signals[i].take(*reading, predicted);
            if self.turns[i] {
                self.runs[i] = f64::from(self.signals[i].run);
            }
            if !self.turns[i] && self.signals[i].is_stuck(model.variance(i)) {
                stuck = stuck.or(Some(i));
            }
        }
        // 2. A step in some channel since a window began, by its signature in all of them.
        let jump = self.jump(correction);
        for bank in &mut self.banks[..if self.onset { 3 } else { ONSET }] {
            let (known, residuals, runs) = (&self.effect.signatures[..], &self.residuals[..], &self.runs[..]);
            bank.update(model, sample.dt, correction, News { known, residuals, runs }, consider.as_deref());
        }
        // 3. All channels together, over one sample and over windows; then the one to name.
        let beyond = self.windows(nis, used) || jump.is_some();
        if self.open.is_some() {
            self.wrong += self.residuals.iter().filter(|r| r.is_finite()).map(|r| r * r - 1.0).sum::<f64>();
        }
        let verdict = match (self.repetition(stuck), beyond) {
            (Some(alarm), _) => Judgement::Channel(alarm),
            (None, beyond) => match self.alarm(model, consider.as_deref(), jump) {
                Judgement::Good | Judgement::Correlated if beyond => Judgement::Contradicted,
                verdict => verdict,
            },
        };
        let mut flags = self.record(verdict);
        if let Judgement::Channel(alarm) = verdict
            && self.is_step(&alarm)
        {
            self.take_step(model, correction, alarm);
        }
        // 4. A row is not to be believed as long as what faults did to some link is not small.
        if self.effect.is_active() && self.counts(belief, consider) {
            flags |= Status::CONTRADICTED | Status::FAULTY;
        }
        flags
    }

    /// Lets those steps begin that began at the sample last taken.
    fn go_by_script(&mut self, model: &impl Model, correction: &Correction) {
        let now = self.taken - 1;
        for step in self.script.iter().flatten().filter(|step| step.since == now) {
            self.effect.begin(model, correction, *step, 0.0);
        }
    }

    /// Whether an alarm is of the channel of the finding that goes on, and of one that does not repeat itself.
    fn is_step(&self, alarm: &Alarm) -> bool {
        let finding = self.open.map(|open| &self.findings[open]);
        alarm.size != 0.0 && finding.is_some_and(|f| f.channel == Some(alarm.channel) && !f.fault.repeats())
    }

    /// Carries a fault along from now on; the search for others begins anew.
    fn take_step(&mut self, model: &impl Model, correction: &Correction, alarm: Alarm) {
        let Alarm { channel, size, age, variance, bank, .. } = alarm;
        let now = self.taken - 1;
        let step = Step { channel, since: now.saturating_sub(u64::from(age)), found: now, size };
        match bank {
            Some(bank) => self.effect.join(&self.banks[bank].sensitivity, step, variance),
            None => self.effect.begin(model, correction, step, variance),
        }
        self.banks.iter_mut().for_each(Bank::restart);
        self.onset = false;
    }

    /// Whether faults move some link by more than its standard deviation.
    #[inline(always)]
    fn counts(&mut self, belief: &Gaussian, mut consider: Option<&mut Consider>) -> bool {
        let joints = self.effect.joints;
        if let Some(consider) = &mut consider {
            consider.sum_up(joints);
        }
        let total = |j: usize| consider.as_ref().map_or(0.0, |consider| consider.total[j * joints + j]);
        let counts = self.effect.counts((0..joints).map(|j| belief.covariance.at(j, j) + total(j)));
        if let (true, Some(last)) = (counts, self.last_named) {
            self.findings[last].until = self.taken - 1;
        }
        counts
    }

    /// Residuals in standard deviations, less what parameters and known faults explain; sum of squares, the latter left
    /// in, and number.
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
            self.std[i] = innovation.variance.sqrt() * factor;
            self.residuals[i] = residual - self.effect.signatures[i] / self.std[i];
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
        let shared: f64 = earlier.map(|j| correction.factors[j * m + i] * correction.innovations[j].value).sum();
        correction.innovations[i].value + shared
    }

    /// Whether a window's sum is beyond its bound.
    #[inline(always)]
    fn windows(&mut self, nis: f64, used: u32) -> bool {
        let size = self.ring.len();
        let at = ((self.taken - 1) % size as u64) as usize;
        self.ring[at] = (nis, f64::from(used));
        WINDOWS.iter().fold(false, |beyond, &length| {
            let (wrapped, last) = (length.saturating_sub(at + 1), &self.ring[(at + 1).saturating_sub(length)..=at]);
            let samples = last.iter().chain(&self.ring[size - wrapped..]);
            let (sum, count) = samples.fold((0.0, 0.0), |(sum, count), (nis, used)| (sum + nis, count + used));
            self.recent = sum - count;
            beyond | (sum > bound(count, if length == 1 { 1.0 } else { CORRELATED }))
        })
    }

    /// A channel that contradicts all others at this sample; a window begins with it, unless one is on.
    #[inline(always)]
    fn jump(&mut self, correction: &Correction) -> Option<Alarm> {
        if self.banks[ONSET].is_over() {
            self.onset = false;
        }
        let news: f64 = self.residuals.iter().filter(|r| r.is_finite()).map(|r| r * r).sum();
        // Below that no single channel can be beyond its own bound.
        let alarm = (news > BOUND).then(|| self.isolate(correction, self.open_channel()))?;
        if alarm.deviations <= DEVIATIONS || alarm.deviations.powi(2) <= MOST_OF * news {
            return None;
        }
        if !self.onset {
            self.onset = true;
            self.banks[ONSET].restart();
        }
        Some(alarm)
    }

    /// The channel that repeats itself, unless a finding of another goes on.
    fn repetition(&self, stuck: Option<usize>) -> Option<Alarm> {
        let channel = stuck.filter(|_| self.open_channel().is_none_or(|open| stuck == Some(open)))?;
        let run = self.signals[channel].run;
        let deviations = f64::from(run);
        Some(Alarm { channel, size: 0.0, deviations, age: run - 2, variance: 0.0, bank: None })
    }

    /// The channel to name, if one explains what is wrong; while a finding goes on, its channel alone.
    #[inline(always)]
    fn alarm(&mut self, model: &impl Model, consider: Option<&Consider>, jump: Option<Alarm>) -> Judgement {
        let (now, only) = (self.taken - 1, self.open_channel());
        // Where a model was wrong before a fault began, the channel must explain most of all since then.
        let unnamed = self.open.filter(|_| only.is_none()).map(|open| self.findings[open].since);
        let wrong = |age: u64| if unnamed.is_some_and(|since| since + age + LEAD < now) { self.wrong } else { 0.0 };
        if let Some(jump) = jump
            .filter(|jump| only.is_some() || (jump.deviations > GROSS && jump.deviations.powi(2) > MOST_OF * wrong(0)))
        {
            return Judgement::Channel(jump);
        }
        if self.onset && self.banks[ONSET].age < LASTS && only.is_none() {
            return Judgement::Good;
        }
        let (mut verdict, mut most) = (Judgement::Good, 0.0);
        for (index, bank) in self.banks.iter_mut().enumerate().take(if self.onset { 3 } else { ONSET }) {
            let Some(StepEvidence { channel, ratio, drop, size, variance }) = bank.worst(consider, BOUND, only) else {
                continue;
            };
            let age = bank.age - 1;
            let explains = drop > MOST_OF * bank.excess.max(wrong(u64::from(age)))
                && size * size > SMALL * SMALL * model.variance(channel);
            if only.is_none() && !explains {
                if let Judgement::Good = verdict {
                    verdict = Judgement::Correlated;
                }
            } else if drop > most {
                let alarm = Alarm { channel, size, deviations: ratio.sqrt(), age, variance, bank: Some(index) };
                (verdict, most) = (Judgement::Channel(alarm), drop);
            }
        }
        verdict
    }

    /// Largest t = [Λν]ᵢ/√Λᵢᵢ: each channel against the prediction and all others, with ν = L e, Cov e diagonal.
    #[inline(always)]
    fn isolate(&mut self, correction: &Correction, only: Option<usize>) -> Alarm {
        let (m, factors) = (self.signals.len(), &correction.factors);
        // Λ ν = L⁻ᵀ D⁻¹ e by back substitution: the factors that the sequential update left are those of S = L D Lᵀ.
        for i in (0..m).rev() {
            self.pull[i] = if self.residuals[i].is_finite() { self.residuals[i] / self.std[i] } else { 0.0 };
            for k in (i + 1..m).filter(|&k| self.residuals[k].is_finite()) {
                self.pull[i] -= factors[i * m + k] * self.pull[k];
            }
        }
        let mut worst = Alarm { channel: 0, size: 0.0, deviations: 0.0, age: 0, variance: 0.0, bank: None };
        for c in (0..m).filter(|&c| self.residuals[c].is_finite() && only.is_none_or(|only| only == c)) {
            let mut precision = 0.0;
            // Λ_cc = ‖D^(−1/2) L⁻¹ e_c‖², column c of L⁻¹ by forward substitution.
            for k in (c..m).filter(|&k| self.residuals[k].is_finite()) {
                self.solution[k] = if k == c { 1.0 } else { 0.0 };
                for j in (c..k).filter(|&j| self.residuals[j].is_finite()) {
                    self.solution[k] -= factors[j * m + k] * self.solution[j];
                }
                precision += (self.solution[k] / self.std[k]).powi(2);
            }
            let deviations = self.pull[c].abs() / precision.sqrt();
            if deviations > worst.deviations {
                let (size, variance) = (self.pull[c] / precision, 1.0 / precision);
                worst = Alarm { channel: c, size, deviations, variance, ..worst };
            }
        }
        worst
    }

    /// Opens, goes on with or ends a finding. While one goes on, what it does to the state is not another's fault.
    #[inline(always)]
    fn record(&mut self, verdict: Judgement) -> u8 {
        let calm = matches!(verdict, Judgement::Good) && !self.is_repeating();
        self.calm = if calm { self.calm + 1 } else { 0 };
        if self.calm > CALM {
            self.open = None;
        }
        let now = self.taken - 1;
        match verdict {
            Judgement::Channel(Alarm { channel, size, deviations, age, .. }) if self.open_channel().is_none() => {
                let since = now.saturating_sub(u64::from(age));
                let fault = self.signals[channel].fault(size, self.turns[channel], now - since);
                // What was first seen without a name is this.
                if self
                    .open
                    .is_some_and(|open| open + 1 == self.findings.len() && self.findings[open].since + LEAD >= since)
                {
                    self.findings.pop();
                }
                self.push(Finding { channel: Some(channel), since, until: now, size, deviations, fault });
                self.last_named = self.open;
            }
            Judgement::Contradicted | Judgement::Correlated if self.open.is_none() => {
                let fault = if let Judgement::Correlated = verdict { Fault::Correlated } else { Fault::Unknown };
                self.push(Finding { channel: None, since: now, until: now, size: 0.0, deviations: 0.0, fault });
                self.wrong = self.recent;
            }
            _ => (),
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
            if finding.fault.repeats() {
                self.effect.release(channel, now); // no step, and over when the channel reads anew
            }
        }
        Status::CONTRADICTED | Status::FAULTY
    }

    /// Whether the finding that goes on is of a channel that still repeats itself.
    fn is_repeating(&self) -> bool {
        self.open.map(|open| &self.findings[open]).is_some_and(|finding| {
            finding.fault.repeats() && finding.channel.is_some_and(|channel| self.signals[channel].run >= RUN)
        })
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
