//! The smoother of a stream: the state some samples ago by all samples since.

use super::consider::{Consider, Held, spread_of};
use super::filter::ExtendedKalmanFilter;
use super::lag_window::LagWindow;
use super::output::{FilterOutput, Keep, Tool};
use super::phases::{Phases, WriteReport};
use super::recording::KalmanSample;
use super::regression::Belief;
use crate::check::expect;
use crate::error::{DesignError, RunError};
use crate::estimate::Status;
use crate::linear::LANES;
use crate::memory::room;

/// Smoother with a fixed lag; a step allocates nothing, and costs the same whatever the lag.
///
/// It is the smoother on all samples so far, of which it gives one row: that of `lag` samples ago. What faults did that are
/// found only then is not known by row: all rows that were waiting are flagged.
///
/// ```
/// use linkside_core::estimate::kalman::{
///     ExtendedKalmanFilter, FilterSettings, FixedLagSmoother, Inputs, JerkDriven, JerkModel, JerkNoise, KalmanSample,
/// };
/// use linkside_core::estimate::measurement::Kind;
///
/// let robot = std::sync::Arc::new(linkside_core::demo::arm()?);
/// let model = JerkModel::new(robot, &[Kind::Motor], &[false])?;
/// # let noise = JerkNoise {
/// #     jerk: vec![100.0], link_walk: vec![0.0; 2], reading: vec![1e-5], torsion: 1e-3, bias_walk: vec![0.0],
/// #     bias_time: vec![f64::INFINITY], initial: vec![1e-4, 1e-3, 0.1], initial_bias: vec![0.0],
/// # };
/// let settings = FilterSettings { gate: None, iterations: 1 };
/// let filter = ExtendedKalmanFilter::new(JerkDriven::new(model, noise, false)?, settings)?;
/// let mut smoother = FixedLagSmoother::new(&filter, 20)?;
/// let inputs = Inputs { jerk: &[0.0], dtheta: &[f64::NAN], ..Inputs::default() };
/// for i in 0..100 {
///     let theta = [0.1 * (0.01 * f64::from(i)).sin()];
///     let earlier = smoother.step(KalmanSample { dt: 1e-3, readings: &theta, inputs })?;
///     assert_eq!(earlier.is_some(), i >= 20);
/// }
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct FixedLagSmoother<M> {
    filter: ExtendedKalmanFilter<M>,
    window: LagWindow,
    /// After the last sample, and before its readings.
    now: Belief,
    predicted: Belief,
    /// The last samples, a lag and one more; sample i is at i modulo their number.
    waiting: Vec<Waiting>,
    /// Whether some row since the start contradicts the model.
    contradicted: bool,
    report: RowWriter<M>,
}

/// What a row needs beside its state.
#[derive(Clone, Debug)]
struct Waiting {
    /// Time since the first sample, and since the sample before [s].
    t: f64,
    dt: f64,
    status: u8,
    nis: f64,
    used: u32,
    log_likelihood: f64,
    /// What the model remembers.
    memory: Vec<f64>,
    /// See [`swings`](super::model::Measurement::swings).
    swings: Vec<f64>,
}

/// How a smoothed state becomes a row.
#[derive(Clone, Debug)]
struct RowWriter<M> {
    /// A model of its own: the filter's is at another sample.
    model: M,
    tool: Tool,
    mean: Vec<f64>,
    /// Σ, Σ E[p pᵀ], and Σ E[p pᵀ] Σᵀ.
    sensitivities: Vec<f64>,
    wide: Vec<f64>,
    total: Vec<f64>,
    held: Held,
    out: FilterOutput,
}

impl<M: Phases> FixedLagSmoother<M> {
    /// On `filter`'s model, noise and settings; it starts where that starts.
    ///
    /// # Errors
    /// A lag of no sample, or [`DesignError::Memory`].
    pub fn new(filter: &ExtendedKalmanFilter<M>, lag: usize) -> Result<Self, DesignError> {
        expect(lag > 0, "lag", lag as f64, "at least 1")?;
        let mut filter = filter.clone();
        filter.reset();
        // A clone has no room for what comes: so it is made anew.
        filter.memory.reserve(filter.model.memory());
        filter.watch(filter.monitor.is_some());
        let (model, states) = (&filter.model, filter.model.states());
        let parameters = filter.consider.as_ref().map_or(0, |consider| consider.sensitivity.stride);
        // Asked for before anything is made: a lag that does not fit says so.
        let width = 2 * states * (states + parameters + 2 * LANES);
        drop(room::<f64>(lag.saturating_mul(2), width + model.memory())?);
        let waiting = Waiting {
            t: 0.0,
            dt: 0.0,
            status: 0,
            nis: 0.0,
            used: 0,
            log_likelihood: 0.0,
            memory: vec![0.0; model.memory()],
            swings: vec![0.0; model.robot().len()],
        };
        Ok(Self {
            window: LagWindow::new(lag, states, parameters),
            now: Belief::new(states, parameters),
            predicted: Belief::new(states, parameters),
            waiting: vec![waiting; lag + 1],
            contradicted: false,
            report: RowWriter::new(&filter, parameters)?,
            filter,
        })
    }

    /// The model.
    pub fn model(&self) -> &M {
        &self.filter.model
    }

    /// Resets the smoother: the next sample starts from the beginning.
    pub fn reset(&mut self) {
        self.filter.reset();
        self.window.clear();
        self.contradicted = false;
        self.report.held.reset();
    }

    /// Takes one sample; gives time since the first sample [s] and the estimate of a lag ago, in the only row of the output,
    /// once there are as many.
    ///
    /// # Errors
    /// As [`ExtendedKalmanFilter::step`].
    pub fn step(&mut self, sample: KalmanSample<'_>) -> Result<Option<(f64, &FilterOutput)>, RunError> {
        sample.check(&self.filter.model)?;
        let started = self.filter.is_started();
        self.filter.advance(&sample)?;
        if started {
            self.step_back(sample.dt);
        }
        self.filter.correct(&sample);
        if !self.filter.is_finite(&sample) {
            let sample = self.filter.taken;
            self.reset();
            return Err(RunError::NotFinite { sample });
        }
        self.now.take(&self.filter.belief, self.filter.consider.as_ref());
        self.wait(sample.dt);
        self.filter.taken += 1;
        let Self { window, now, waiting, filter, report, .. } = self;
        let Some(earlier) = window.earlier(now) else { return Ok(None) };
        // The row after the last one is the oldest that waits.
        let own = &waiting[filter.taken % waiting.len()];
        report.write(own, earlier, filter.consider.as_ref(), 0, None);
        Ok(Some((own.t, &report.out)))
    }

    /// Takes note of the step of time last predicted.
    fn step_back(&mut self, dt: f64) {
        let Self { window, now, predicted, filter, .. } = self;
        let ExtendedKalmanFilter { model, belief, consider, memory, .. } = filter;
        predicted.take(belief, consider.as_ref());
        memory.clear();
        model.remember(memory);
        window.push(model, (memory, dt), now, predicted);
    }

    /// The estimates that no step has given yet, with their times [s], and resets: the end of a stream.
    ///
    /// # Errors
    /// [`DesignError::Memory`].
    pub fn flush(&mut self) -> Result<(Vec<f64>, FilterOutput), DesignError> {
        let Self { window, now, waiting, filter, report, .. } = self;
        let states = if filter.taken == 0 { Vec::new() } else { window.rest(now) };
        let keep = Keep { covariance: true, innovations: false };
        let mut out = FilterOutput::zeros(states.len(), &filter.model, keep)?;
        let first = filter.taken - states.len();
        let mut times = Vec::with_capacity(states.len());
        for (i, state) in states.iter().enumerate() {
            let own = &waiting[(first + i) % waiting.len()];
            report.write(own, state, filter.consider.as_ref(), i, Some(&mut out));
            times.push(own.t);
        }
        out.findings.extend_from_slice(filter.findings());
        self.reset();
        Ok((times, out))
    }

    /// Takes note of the last sample's row.
    fn wait(&mut self, dt: f64) {
        let Self { filter, waiting, contradicted, .. } = self;
        let (now, rows) = (filter.taken, waiting.len());
        let before = if now == 0 { None } else { Some(waiting[(now - 1) % rows].t) };
        let ExtendedKalmanFilter { correction, model, monitor, consider, .. } = &*filter;
        let steps = monitor.as_ref().map_or(&[][..], |monitor| &monitor.effect.steps);
        let fault = steps.last().is_some_and(|step| step.found == now as u64);
        // A start is fitted to readings that contradict the model, or a fault began before it was found.
        let doubted = correction.status & Status::CONTRADICTED != 0 && !*contradicted && now < Status::START;
        let so = |there: bool, flags: u8| if there { flags } else { 0 };
        let flags = so(doubted, Status::CONTRADICTED) | so(fault, Status::CONTRADICTED | Status::FAULTY);
        waiting.iter_mut().for_each(|row| row.status |= flags);
        *contradicted |= correction.status & Status::CONTRADICTED != 0;
        let own = &mut waiting[now % rows];
        own.t = before.map_or(0.0, |t| t + dt);
        own.dt = dt;
        (own.status, own.nis, own.used) = (correction.status, correction.nis, correction.used);
        own.log_likelihood = correction.log_likelihood;
        own.memory.clear();
        model.remember(&mut own.memory);
        if let Some(consider) = consider {
            own.swings.copy_from_slice(&consider.swings);
        }
    }
}

impl<M: Phases> RowWriter<M> {
    fn new(filter: &ExtendedKalmanFilter<M>, parameters: usize) -> Result<Self, DesignError> {
        let (model, states) = (filter.model.clone(), filter.model.states());
        Ok(Self {
            tool: filter.tool.clone(),
            mean: vec![0.0; states],
            sensitivities: vec![0.0; states * parameters],
            wide: vec![0.0; states * parameters],
            total: vec![0.0; states * states],
            held: Held::new(model.robot().len()),
            out: FilterOutput::zeros(1, &model, Keep { covariance: true, innovations: false })?,
            model,
        })
    }

    /// Row `i` of `all`, or of its own output.
    fn write(
        &mut self,
        own: &Waiting,
        state: &Belief,
        consider: Option<&Consider>,
        i: usize,
        all: Option<&mut FilterOutput>,
    ) {
        let Self { model, tool, mean, sensitivities, wide, total, held, out } = self;
        let (out, states) = (all.unwrap_or(out), mean.len());
        state.write(mean, sensitivities);
        let more = consider.map(|consider| {
            spread_of(sensitivities, &own.swings, consider.moment(), states, wide, total);
            held.raise(&own.swings, own.dt, total, states);
            (&total[..], states)
        });
        let (covariance, stride) = (&state.covariance.data, state.covariance.stride);
        let memory = &own.memory;
        M::report_phase(WriteReport { model, memory, mean, covariance, stride, more, tool, i, out, whole: true });
        (out.status[i], out.nis[i], out.used[i]) = (own.status, own.nis, own.used);
        out.log_likelihood[i] = own.log_likelihood;
    }
}
