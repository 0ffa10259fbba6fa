//! A model put together of a process and a measurement, with the states of late sensors behind theirs.

use super::gaussian::{Gaussian, Symmetric};
use super::late::{Late, LateChannel, Lateness};
use super::model::{Linearised, Measurement, Model, Process, Report};
use super::output::FilterOutput;
use super::recording::{KalmanRecording, KalmanSample};
use super::sigma_points::{SigmaPoints, SigmaRule};
use super::tolerances::Tolerances;
use crate::check::{expect, expect_length};
use crate::error::DesignError;
use crate::estimate::measurement::Channel;
use crate::linear;
use crate::robot::Robot;

/// A model put together of its two parts, whose states are the same.
#[derive(Clone, Debug)]
pub struct Paired<P, M> {
    /// f and Q.
    pub(crate) process: P,
    /// h and R.
    pub(crate) measurement: M,
    /// Channels whose sensors have a filter or a delay inside.
    late: Option<Box<Late>>,
    /// Scratch: ∂h/∂p of the late channels.
    driven: Vec<f64>,
    /// Sigma points of the channels; none: derivatives.
    points: Option<Box<SigmaPoints>>,
}

impl<P: Process, M: Measurement> Paired<P, M> {
    /// A process and the measurement of its state.
    pub fn of(process: P, measurement: M) -> Self {
        Self { process, measurement, late: None, driven: Vec::new(), points: None }
    }

    /// With what is `inside` the sensor of each channel, as states behind the model's own; an empty list is nothing.
    ///
    /// # Errors
    /// Not one a channel, a time that is negative or not finite.
    pub fn with_late(mut self, inside: &[Option<Lateness>]) -> Result<Self, DesignError> {
        let own = self.measurement.biases();
        expect_length("late", inside.len(), if inside.is_empty() { 0 } else { own.len() })?;
        for Lateness { time_constant, delay, .. } in inside.iter().flatten() {
            for (what, value) in [("the time constant of a sensor", *time_constant), ("the delay of a sensor", *delay)]
            {
                expect(value.is_finite() && value >= 0.0, what, value, "a finite number of at least 0")?;
            }
        }
        self.late = inside
            .iter()
            .any(Option::is_some)
            .then(|| Box::new(Late::new(inside, own, self.process.states(), self.measurement.dense())));
        if let Some(late) = &self.late {
            self.process.widen(late.states());
            let parameters = self.measurement.tolerances().len().next_multiple_of(linear::LANES);
            self.driven = vec![0.0; self.measurement.channels().len() * parameters];
        }
        Ok(self)
    }

    /// The same without what is inside sensors.
    pub(crate) fn without_late(mut self) -> Self {
        self.late = None;
        self
    }

    /// Channels whose sensors are late, where the last step of time linearised them.
    pub(crate) fn late_channels(&self) -> impl Iterator<Item = LateChannel<'_>> {
        self.late.iter().flat_map(|late| late.channels())
    }

    /// Takes over a first sample, and what the late sensors' states are at `belief`.
    fn begin(&mut self, sample: &KalmanSample<'_>, belief: &mut Gaussian) {
        self.measurement.take(sample, true);
        self.measurement.follow(&belief.mean[..self.measurement.dense()], true);
        self.settle(belief);
    }

    /// Adds to `belief` what late sensors hold that have settled.
    pub(crate) fn settle(&mut self, belief: &mut Gaussian) {
        if let Some(late) = &mut self.late {
            self.measurement.linearise(&belief.mean[..self.measurement.dense()]);
            late.start(belief, self.measurement.linearised());
        }
    }

    /// Columns (states × `stride`) through the step last predicted, but for what late sensors do at its end.
    #[inline(always)]
    pub(super) fn carry_process(&mut self, columns: &mut [f64], stride: usize, dt: f64) {
        self.process.carry(columns, stride, dt);
    }

    /// The rest of it.
    #[inline(always)]
    pub(super) fn carry_sensors(&self, columns: &mut [f64], stride: usize) {
        if let Some(late) = &self.late {
            late.carry(columns, stride, None);
        }
    }

    /// The channels.
    pub fn measurement_mut(&mut self) -> &mut M {
        &mut self.measurement
    }
}

impl<P: Process, M: Measurement + Report> Model for Paired<P, M> {
    fn robot(&self) -> &Robot {
        self.process.robot()
    }

    #[inline(always)]
    fn states(&self) -> usize {
        self.late.as_ref().map_or(self.process.states(), |late| late.states())
    }

    fn own_states(&self) -> usize {
        self.process.states()
    }

    #[inline(always)]
    fn dense(&self) -> usize {
        self.measurement.dense()
    }

    #[inline(always)]
    fn biases(&self) -> &[Option<usize>] {
        self.late.as_ref().map_or(self.measurement.biases(), |late| late.biases())
    }

    fn check(&self, recording: &KalmanRecording<'_>) -> Result<(), DesignError> {
        self.measurement.check(recording)?;
        self.process.check(recording)
    }

    fn start(&mut self, sample: &KalmanSample<'_>, belief: &mut Gaussian) -> Result<(), DesignError> {
        self.process.start(sample, belief)?;
        self.begin(sample, belief);
        Ok(())
    }

    fn resume(&mut self, sample: &KalmanSample<'_>, belief: &mut Gaussian) {
        self.process.resume(sample, belief);
        self.begin(sample, belief);
    }

    fn bridged(&self) -> bool {
        self.process.bridged()
    }

    #[inline(always)]
    fn link_disturbance(&self) -> Option<usize> {
        self.process.link_disturbance()
    }

    #[inline(always)]
    fn wrench(&self) -> Option<usize> {
        self.process.wrench()
    }

    #[inline(always)]
    fn predict(&mut self, sample: &KalmanSample<'_>, belief: &mut Gaussian) {
        self.measurement.follow(&belief.mean[..self.measurement.dense()], false);
        self.process.predict(sample, belief);
        self.measurement.take(sample, false);
        if let Some(late) = &mut self.late {
            self.measurement.linearise(&belief.mean[..self.measurement.dense()]);
            late.advance(belief, self.measurement.linearised(), sample.dt);
        }
    }

    #[inline(always)]
    fn linearise(&mut self, reference: &[f64]) {
        self.measurement.linearise(reference);
        if let Some(late) = &mut self.late {
            late.mask(self.measurement.linearised());
        }
    }

    fn set_points(&mut self, rule: Option<SigmaRule>) {
        self.process.set_points(rule);
        let (dense, channels) = (self.measurement.dense(), self.measurement.channels().len());
        self.points = rule.map(|rule| Box::new(SigmaPoints::new(rule, dense, channels)));
    }

    fn has_points(&self) -> bool {
        self.points.is_some()
    }

    #[inline(always)]
    fn regress(&mut self, reference: &[f64], covariance: &Symmetric) {
        let Self { measurement, late, points, .. } = self;
        let Some(points) = points else { return self.linearise(reference) };
        points.evaluate(reference, covariance, |state, values| values.copy_from_slice(measurement.evaluate(state)));
        measurement.linearise(reference);
        let (prediction, jacobian) = measurement.linearised_mut();
        prediction.copy_from_slice(&points.mean);
        points.correct(jacobian, reference.len());
        if let Some(late) = late {
            late.mask(measurement.linearised());
            // Of a late channel a state is read, and that is no function.
            for channel in late.channels().map(|late| late.channel) {
                (0..points.mean.len()).for_each(|other| points.residual.put(channel, other, 0.0));
            }
        }
    }

    #[inline(always)]
    fn residual(&self) -> Option<&Symmetric> {
        self.points.as_ref().map(|points| &points.residual)
    }

    #[inline(always)]
    fn linearised(&self) -> Linearised<'_> {
        self.late.as_ref().map_or(self.measurement.linearised(), |late| late.masked())
    }

    #[inline(always)]
    fn variance(&self, channel: usize) -> f64 {
        self.measurement.variance(channel)
    }

    fn memory(&self) -> usize {
        let late = self.late.as_ref().map_or(0, |late| late.memory());
        late + self.process.memory() + self.measurement.memory()
    }

    #[inline(always)]
    fn remember(&self, memory: &mut Vec<f64>) {
        self.process.remember(memory);
        self.measurement.remember(memory);
        if let Some(late) = &self.late {
            late.remember(memory);
        }
    }

    #[inline(always)]
    fn noise_rows(&mut self, memory: &[f64], dt: f64, rows: &mut [f64], stride: usize) {
        let own = self.process.memory();
        self.process.noise_rows(&memory[..own], dt, rows, stride);
    }

    #[inline(always)]
    fn retreat_sensors(&mut self, memory: &[f64], lambda: &mut [f64], big: &mut Symmetric) {
        if let Some(late) = &self.late {
            late.retreat(&memory[self.process.memory() + self.measurement.memory()..], lambda, big);
        }
    }

    #[inline(always)]
    fn retreat(&mut self, memory: &[f64], dt: f64, lambda: &mut [f64], big: &mut Symmetric) {
        let own = self.process.memory();
        self.process.retreat(&memory[..own], dt, lambda, big);
    }

    fn channel_kinds(&self) -> &[Channel] {
        self.measurement.channels()
    }

    fn tolerances(&self) -> &Tolerances {
        self.measurement.tolerances()
    }

    #[inline(always)]
    fn teaches(&self, channel: usize) -> bool {
        self.measurement.teaches(channel)
    }

    #[inline(always)]
    fn carry(&mut self, columns: &mut [f64], stride: usize, dt: f64) {
        self.process.carry(columns, stride, dt);
        self.process.drive(columns, stride);
        if let Some(late) = &mut self.late {
            self.driven.resize(self.measurement.channels().len() * stride, 0.0);
            self.measurement.signatures(stride, &mut self.driven);
            late.carry(columns, stride, Some(&self.driven));
        }
    }

    #[inline(always)]
    fn carry_noise_free(&mut self, columns: &mut [f64], stride: usize, dt: f64) {
        self.process.carry(columns, stride, dt);
        if let Some(late) = &mut self.late {
            late.carry(columns, stride, None);
        }
    }

    #[inline(always)]
    fn carry_single(&mut self, columns: &mut [f32], stride: usize, dt: f64) {
        self.process.carry_single(columns, stride, dt);
        if let Some(late) = &mut self.late {
            late.carry(columns, stride, None);
        }
    }

    #[inline(always)]
    fn carry_back_sensors(&mut self, memory: &[f64], columns: &mut [f64], stride: usize) {
        if let Some(late) = &self.late {
            late.carry_back(&memory[self.process.memory() + self.measurement.memory()..], columns, stride);
        }
    }

    #[inline(always)]
    fn carry_back_process(&mut self, memory: &[f64], columns: &mut [f64], stride: usize, dt: f64) {
        let own = self.process.memory();
        self.process.carry_back(&memory[..own], columns, stride, dt);
    }

    #[inline(always)]
    fn signatures(&mut self, stride: usize, out: &mut [f64]) {
        self.measurement.signatures(stride, out);
        if let Some(late) = &self.late {
            late.mask_signatures(stride, out);
        }
    }

    #[inline(always)]
    fn swings(&self, out: &mut [f64]) {
        self.measurement.swings(out);
    }

    #[inline(always)]
    fn motor_velocity(&self, j: usize) -> Option<usize> {
        self.measurement.motor_velocity(j)
    }

    fn start_columns(&mut self, stride: usize, scratch: &mut [f64], columns: &mut [f64]) {
        self.measurement.start_columns(stride, scratch, columns);
    }

    #[inline(always)]
    fn report(&mut self, memory: &[f64], state: &[f64], i: usize, out: &mut FilterOutput) {
        let own = self.process.memory();
        self.measurement.report(&memory[own..own + self.measurement.memory()], state, i, out);
    }
}
