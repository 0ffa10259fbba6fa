//! What was found wrong since the start: contradictions that begin, go on and end.

use super::signal::{Fault, RUN, Signal};
use crate::estimate::Status;

/// A contradiction without a name that began at most this many samples before a fault is the fault itself, as it begins.
pub(super) const LEAD: u64 = 32;
/// Samples without an alarm after which a finding is over.
pub(super) const CALM: u64 = 256;
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
pub(super) struct Alarm {
    pub(super) channel: usize,
    pub(super) size: f64,
    pub(super) deviations: f64,
    pub(super) age: u32,
    pub(super) variance: f64,
    /// The window that tells; none: this sample alone.
    pub(super) bank: Option<usize>,
    /// What the readings look like, where the test itself says so.
    pub(super) fault: Option<Fault>,
}

/// What a sample comes to.
#[derive(Clone, Copy, Debug)]
pub(super) enum Judgement {
    Good,
    /// Innovations contradict the model, and no channel explains it: they are too large, or lean to one side for long; by
    /// that much in the squares of their standard deviations.
    Contradicted {
        fault: Fault,
        squares: f64,
    },
    Channel(Alarm),
}

/// All findings since the start, and what goes on.
#[derive(Clone, Debug)]
pub(super) struct Findings {
    /// At most [`MOST`].
    pub(super) list: Vec<Finding>,
    /// The one that goes on.
    open: Option<usize>,
    /// The last with a channel.
    last_named: Option<usize>,
    /// Since when readings contradict the model without a name, whether that is a finding or not.
    doubt: Option<u64>,
    /// Samples since the last alarm.
    calm: u64,
}

impl Findings {
    pub(super) fn new() -> Self {
        Self { list: Vec::with_capacity(MOST), open: None, last_named: None, doubt: None, calm: 0 }
    }

    /// Forgets all.
    pub(super) fn reset(&mut self) {
        self.list.clear();
        (self.open, self.last_named, self.doubt, self.calm) = (None, None, None, 0);
    }

    /// Whether something goes on.
    pub(super) fn is_open(&self) -> bool {
        self.open.is_some() || self.doubt.is_some()
    }

    /// Since when something goes on that has no name.
    pub(super) fn unnamed(&self) -> Option<u64> {
        self.doubt
    }

    /// The channel of the finding that goes on.
    pub(super) fn channel(&self) -> Option<usize> {
        self.open.and_then(|open| self.list[open].channel)
    }

    /// Whether an alarm is a step in the channel of the finding that goes on, and that does not repeat itself.
    pub(super) fn is_step(&self, alarm: &Alarm) -> bool {
        let finding = self.open.map(|open| &self.list[open]);
        alarm.size != 0.0
            && alarm.fault.is_none()
            && finding.is_some_and(|f| f.channel == Some(alarm.channel) && !f.fault.repeats())
    }

    /// The last fault with a name still shows at sample `now`.
    pub(super) fn prolong(&mut self, now: u64) {
        if let Some(last) = self.last_named {
            self.list[last].until = now;
        }
    }

    /// Whether the finding that goes on is of a channel that still repeats itself.
    fn is_repeating(&self, signals: &[Signal]) -> bool {
        self.open.map(|open| &self.list[open]).is_some_and(|finding| {
            finding.fault.repeats() && finding.channel.is_some_and(|channel| signals[channel].run >= RUN)
        })
    }

    /// Opens, goes on with or ends a finding by the verdict on sample `now`; gives the flags of its row. While one goes on,
    /// what it does to the state is not another's fault. A contradiction without a name is a finding from when on it
    /// `matters`.
    #[inline(always)]
    pub(super) fn record(
        &mut self,
        verdict: Judgement,
        now: u64,
        (signals, turns): (&[Signal], &[bool]),
        matters: bool,
    ) -> u8 {
        let calm = matches!(verdict, Judgement::Good) && !self.is_repeating(signals);
        self.calm = if calm { self.calm + 1 } else { 0 };
        if self.calm > CALM {
            (self.open, self.doubt) = (None, None);
        }
        match verdict {
            Judgement::Channel(Alarm { channel, size, deviations, age, fault, .. }) if self.channel().is_none() => {
                let since = now.saturating_sub(u64::from(age));
                let fault = fault.unwrap_or_else(|| signals[channel].fault(size, turns[channel], now - since));
                // What was first seen without a name is this.
                if self.open.is_some_and(|open| open + 1 == self.list.len() && self.list[open].since + LEAD >= since) {
                    self.list.pop();
                }
                self.push(Finding { channel: Some(channel), since, until: now, size, deviations, fault });
                (self.last_named, self.doubt) = (self.open, None);
            }
            Judgement::Contradicted { fault, .. } if self.open.is_none() => {
                let since = *self.doubt.get_or_insert(now);
                if matters {
                    self.push(Finding { channel: None, since, until: now, size: 0.0, deviations: 0.0, fault });
                }
            }
            _ => (),
        }
        let Some(open) = self.open else {
            return if matters { Status::CONTRADICTED } else { 0 };
        };
        let finding = &mut self.list[open];
        finding.until = now;
        if finding.channel.is_some() { Status::CONTRADICTED | Status::FAULTY } else { Status::CONTRADICTED }
    }

    /// Looks again at a step that goes on, which may turn out as another kind: a turned sign shows only when the robot moves.
    /// Gives the channel of one that turns out to repeat itself.
    #[inline(always)]
    pub(super) fn look_again(&mut self, now: u64, (signals, turns): (&[Signal], &[bool])) -> Option<usize> {
        let finding = &mut self.list[self.open?];
        let channel = finding.channel?;
        if finding.fault != Fault::Step || now >= finding.since + 2 * CALM {
            return None;
        }
        finding.fault = signals[channel].fault(f64::INFINITY, turns[channel], now - finding.since);
        finding.fault.repeats().then_some(channel)
    }

    /// Opens a finding, or again the one of the same channel and kind: a fault that comes and goes is one line.
    fn push(&mut self, finding: Finding) {
        let known = self.list.iter().position(|f| f.channel == finding.channel && f.fault == finding.fault);
        self.open = known.or_else(|| {
            (self.list.len() < MOST).then(|| {
                self.list.push(finding);
                self.list.len() - 1
            })
        });
    }
}
