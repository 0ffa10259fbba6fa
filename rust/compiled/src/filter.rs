//! A Kalman filter, fed with signals.

use crate::fields::Fields;
use crate::sample::{Sample, Signal};
use linkside_core::error::{DesignError, RunError};
use linkside_core::estimate::kalman::{
    ElasticModel, ExtendedKalmanFilter, FilterOutput, Inputs, JerkDriven, KalmanSample, Keep, Phases,
};
use linkside_core::estimate::measurement::Kind;

/// A filter on either model, and a sample's readings in the order of its channels.
#[derive(Clone, Debug)]
pub(crate) struct Filter<M: Driven> {
    pub(crate) core: ExtendedKalmanFilter<M>,
    kept: M::Kept,
    /// The signal of each kind of channel, and how many entries it has.
    readings: Vec<(Signal, usize)>,
    /// Readings of all channels, NaN where they are missing.
    values: Vec<f64>,
    row: FilterOutput,
    /// Time since the first sample [s].
    t: f64,
}

/// What drives a model, beside readings.
pub(crate) trait Driven: Phases {
    /// What is kept from sample to sample.
    type Kept: Clone + std::fmt::Debug;

    /// Signals that it is driven by, whether or not channels read them too.
    const SIGNALS: &'static [Signal];

    /// Nothing kept yet, of `joints`.
    fn nothing(joints: usize) -> Self::Kept;

    /// A sample whose lengths are right.
    ///
    /// # Errors
    /// One that cannot drive the model.
    fn inputs<'a>(kept: &'a mut Self::Kept, sample: &Sample<'a>) -> Result<Inputs<'a>, DesignError>;

    /// Keeps what the next sample needs of one that was taken; of none, to start anew.
    fn keep(kept: &mut Self::Kept, sample: &Sample<'_>);
}

/// Signals that drive the jerk-driven model (n each), NaN where there are none.
#[derive(Clone, Debug)]
pub(crate) struct Commands {
    dtheta: Vec<f64>,
    jerk: Vec<f64>,
    /// Commanded accelerations of the sample before.
    before: Vec<f64>,
}

impl Driven for JerkDriven {
    type Kept = Commands;

    const SIGNALS: &'static [Signal] = &[Signal::Dtheta, Signal::Ddqref];

    fn nothing(joints: usize) -> Commands {
        let missing = vec![f64::NAN; joints];
        Commands { dtheta: missing.clone(), jerk: missing.clone(), before: missing }
    }

    fn inputs<'a>(kept: &'a mut Commands, sample: &Sample<'a>) -> Result<Inputs<'a>, DesignError> {
        let Commands { dtheta, jerk, before } = kept;
        copy(dtheta, sample.dtheta);
        jerk.fill(0.0);
        for ((jerk, now), before) in jerk.iter_mut().zip(sample.ddqref).zip(before) {
            let change = (now - *before) / sample.dt;
            *jerk = if change.is_finite() { change } else { 0.0 };
        }
        Ok(Inputs { dtheta, jerk, tau: &[] })
    }

    fn keep(kept: &mut Commands, sample: &Sample<'_>) {
        copy(&mut kept.before, sample.ddqref);
    }
}

impl Driven for ElasticModel {
    type Kept = ();

    const SIGNALS: &'static [Signal] = &[Signal::Tau];

    fn nothing(_: usize) {}

    fn inputs<'a>((): &'a mut (), sample: &Sample<'a>) -> Result<Inputs<'a>, DesignError> {
        match sample.tau.iter().find(|tau| !tau.is_finite()) {
            Some(&value) => Err(DesignError::Range { what: "tau", value, expected: "a number of each joint" }),
            None => Ok(Inputs { tau: sample.tau, ..Inputs::default() }),
        }
    }

    fn keep((): &mut (), _: &Sample<'_>) {}
}

impl<M: Driven> Filter<M> {
    /// # Errors
    /// [`DesignError::Memory`].
    pub(crate) fn new(core: ExtendedKalmanFilter<M>, kinds: &[Kind]) -> Result<Self, DesignError> {
        let (row, model) = (FilterOutput::zeros(1, core.model(), Keep::default())?, core.model());
        // The core's order of channels, whatever that of `kinds`.
        let kinds = Kind::ALL.into_iter().filter(|kind| kinds.contains(kind));
        let readings = kinds.map(|kind| (Signal::of(kind), kind.channels(model.robot()).len())).collect();
        let (values, kept) = (vec![f64::NAN; model.channels()], M::nothing(model.robot().len()));
        Ok(Self { core, kept, readings, values, row, t: 0.0 })
    }

    /// Entries of a signal that it reads.
    pub(crate) fn width(&self, signal: Signal) -> usize {
        let read = self.readings.iter().find(|(own, _)| *own == signal).map(|(_, width)| *width);
        let drives = M::SIGNALS.contains(&signal).then(|| self.core.model().robot().len());
        read.or(drives).unwrap_or(0)
    }

    pub(crate) fn fields(&self, fields: &mut Fields) {
        let (row, states) = (&self.row, self.core.model().states());
        fields.add("t", 1);
        for (name, part) in signals(row) {
            fields.add(name, part.len());
        }
        fields.add("used", 1);
        fields.add("state", states);
    }

    /// Forgets all samples.
    pub(crate) fn reset(&mut self) {
        self.core.reset();
        M::keep(&mut self.kept, &Sample::default());
    }

    /// Takes a sample.
    ///
    /// # Errors
    /// As [`ExtendedKalmanFilter::step`].
    pub(crate) fn step(&mut self, sample: &Sample<'_>) -> Result<(), RunError> {
        for &signal in M::SIGNALS {
            signal.checked(sample, self.width(signal))?;
        }
        let Self { core, kept, readings, values, row, t } = self;
        let mut rest = &mut values[..];
        for &(signal, width) in &*readings {
            let (own, others) = rest.split_at_mut(width);
            copy(own, signal.checked(sample, width)?);
            rest = others;
        }
        let now = if core.is_started() { *t + sample.dt } else { 0.0 };
        let inputs = M::inputs(kept, sample)?;
        let done = core.step(KalmanSample { dt: sample.dt, readings: values, inputs });
        match &done {
            Ok(()) => {
                M::keep(kept, sample);
                *t = now;
                core.report_into(row);
            }
            Err(RunError::Design(_)) => {}
            Err(_) => M::keep(kept, &Sample::default()), // it has started anew
        }
        done
    }

    /// The last sample's estimate.
    pub(crate) fn write(&self, fields: &mut Fields) {
        let used = [f64::from(self.row.used[0])];
        let first = core::iter::once(core::slice::from_ref(&self.t));
        let last = [&used[..], &self.core.belief().mean];
        fields.fill(first.chain(signals(&self.row).map(|(_, part)| part)).chain(last));
    }

    /// See [`Status`](linkside_core::estimate::Status).
    pub(crate) fn status(&self) -> u8 {
        self.row.status[0]
    }
}

fn signals(row: &FilterOutput) -> impl Iterator<Item = (&'static str, &[f64])> {
    let all: [(_, &[f64]); 14] = [
        ("q", &row.q),
        ("dq", &row.dq),
        ("ddq", &row.ddq),
        ("theta", &row.theta),
        ("dtheta", &row.dtheta),
        ("q_std", &row.q_std),
        ("disturbance", &row.disturbance),
        ("disturbance_std", &row.disturbance_std),
        ("wrench", &row.wrench),
        ("wrench_std", &row.wrench_std),
        ("tool_position", &row.tool),
        ("tool_std", &row.tool_std),
        ("nis", &row.nis),
        ("log_likelihood", &row.log_likelihood),
    ];
    all.into_iter()
}

/// Copies readings, or NaN where there are none.
fn copy(to: &mut [f64], readings: &[f64]) {
    if readings.is_empty() {
        to.fill(f64::NAN);
    } else {
        to.copy_from_slice(readings);
    }
}
