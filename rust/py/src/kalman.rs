//! Kalman filter and smoother on the jerk-driven model.

use crate::array::{Signal, rows, shaped};
use crate::disturbance::LinkDisturbance;
use crate::error::{EstimatorError, IntoPyErr, outcome};
use crate::gil::Release;
use crate::robot::Robot;
use crate::state::State;
use crate::tolerance::{ToleranceTuple, of_core};
use linkside_core::error::RunError;
use linkside_core::estimate::kalman::{
    self, Fault, FilterOutput, FilterSettings, Finding, Gaussian, Inputs, JerkDriven, JerkModel, KalmanRecording,
    KalmanSample, Keep, Lateness, Model,
};
use linkside_core::estimate::measurement::Kind;
use numpy::{PyArray1, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::sync::Arc;

/// Standard deviations of everything that is random.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct NoiseFields {
    jerk: Vec<f64>,
    link_walk: Vec<f64>,
    reading: Vec<f64>,
    torsion: f64,
    bias_walk: Vec<f64>,
    bias_time: Vec<f64>,
    initial: Vec<f64>,
    initial_bias: Vec<f64>,
}

impl From<NoiseFields> for kalman::JerkNoise {
    fn from(n: NoiseFields) -> Self {
        let NoiseFields { jerk, link_walk, reading, torsion, bias_walk, bias_time, initial, initial_bias } = n;
        Self { jerk, link_walk, reading, torsion, bias_walk, bias_time, initial, initial_bias }
    }
}

/// Bound of the sum of ``used`` normalised innovations squared: exceeded by chance once in 10¹⁰ recordings.
///
/// Four neighbours are taken to move together; Wilson and Hilferty (1931).
#[pyfunction]
pub(crate) fn largest_nis(used: f64) -> f64 {
    kalman::largest_nis(used)
}

/// Extended Kalman filter of one robot.
#[pyclass(module = "linkside._core")]
#[derive(Clone)]
pub(crate) struct ExtendedKalmanFilter {
    filter: kalman::ExtendedKalmanFilter<JerkDriven>,
    tool: bool,
    live: Live,
}

/// A sample put together from its signals.
#[derive(Clone)]
pub(crate) struct Live {
    pub(crate) readings: Vec<f64>,
    dtheta: Vec<f64>,
    /// Commanded acceleration of the sample before; empty when there is none.
    pub(crate) ddqref: Vec<f64>,
    jerk: Vec<f64>,
    /// Time since the first sample [s].
    pub(crate) t: f64,
    /// The estimate at the last one.
    pub(crate) row: FilterOutput,
}

impl Live {
    pub(crate) fn new(model: &JerkDriven) -> PyResult<Self> {
        let (joints, channels) = (model.robot().len(), model.channels());
        Ok(Self {
            readings: vec![f64::NAN; channels],
            dtheta: vec![f64::NAN; joints],
            ddqref: Vec::new(),
            jerk: vec![0.0; joints],
            t: 0.0,
            row: FilterOutput::zeros(1, model, Keep::default()).map_err(IntoPyErr::into_py_err)?,
        })
    }

    pub(crate) fn inputs(&self) -> Inputs<'_> {
        Inputs { dtheta: &self.dtheta, jerk: &self.jerk, tau: &[] }
    }

    /// Takes over a sample, or leaves everything as it is where a signal cannot be used.
    pub(crate) fn set(&mut self, dt: f64, sensors: usize, signals: &Signals<'_>) -> PyResult<()> {
        let (n, m) = (self.jerk.len(), self.readings.len());
        let Signals { theta, acceleration, dtheta, ddqref, further } = signals;
        let theta = theta.readings("theta", n)?;
        let acceleration = given(acceleration.as_ref(), "acceleration", sensors)?;
        let dtheta = given(dtheta.as_ref(), "dtheta", n)?;
        let ddqref = given(ddqref.as_ref(), "ddqref", n)?;
        let further = given(further.as_ref(), "further", m - n - sensors)?;
        let (motors, rest) = self.readings.split_at_mut(n);
        let (accelerations, others) = rest.split_at_mut(sensors);
        motors.copy_from_slice(theta);
        fill(accelerations, acceleration);
        fill(others, further);
        fill(&mut self.dtheta, dtheta);
        self.jerk.fill(0.0);
        let now = ddqref.unwrap_or_default();
        for ((jerk, now), before) in self.jerk.iter_mut().zip(now).zip(&self.ddqref) {
            let change = (now - before) / dt;
            *jerk = if change.is_finite() { change } else { 0.0 };
        }
        self.ddqref.clear();
        self.ddqref.extend_from_slice(now);
        Ok(())
    }
}

/// One sample of every signal; what is not given is missing.
pub(crate) struct Signals<'py> {
    pub(crate) theta: Signal<'py>,
    pub(crate) acceleration: Option<Signal<'py>>,
    pub(crate) dtheta: Option<Signal<'py>>,
    pub(crate) ddqref: Option<Signal<'py>>,
    pub(crate) further: Option<Signal<'py>>,
}

/// The readings of a signal that may not be there.
fn given<'a>(signal: Option<&'a Signal<'_>>, name: &str, expected: usize) -> PyResult<Option<&'a [f64]>> {
    signal.map(|signal| signal.readings(name, expected)).transpose()
}

/// # Errors
/// A step of time that no clock makes.
pub(crate) fn check_step(dt: f64) -> PyResult<()> {
    if dt > 0.0 && dt.is_finite() {
        return Ok(());
    }
    Err(EstimatorError::new_err(format!("dt is {dt}, expected a positive, finite time in seconds")))
}

/// Time constant and delay inside a channel's sensor [s], and how many steps of time the delay can have.
pub(crate) type Inside = Option<(f64, f64, usize)>;

/// None inside any where there is no list.
pub(crate) fn inside(late: Option<Vec<Inside>>) -> Vec<Option<Lateness>> {
    let one = |(time_constant, delay, steps)| Lateness { time_constant, delay, steps };
    late.unwrap_or_default().into_iter().map(|inside| inside.map(one)).collect()
}

/// Kinds of channels by name.
pub(crate) fn named(kinds: &[String]) -> PyResult<Vec<Kind>> {
    let find = |name: &String| {
        Kind::named(name).ok_or_else(|| EstimatorError::new_err(format!("{name:?} is no kind of channel")))
    };
    kinds.iter().map(find).collect()
}

/// Copies readings, or NaN where there are none.
fn fill(to: &mut [f64], readings: Option<&[f64]>) {
    match readings {
        Some(readings) => to.copy_from_slice(readings),
        None => to.fill(f64::NAN),
    }
}

pub(crate) type Matrix<'py> = PyReadonlyArray2<'py, f64>;
pub(crate) type Arrays<'py> = (PyReadonlyArray1<'py, f64>, Matrix<'py>, Matrix<'py>, Matrix<'py>);

#[pymethods]
impl ExtendedKalmanFilter {
    #[new]
    #[pyo3(signature = (
        robot, *, kinds, biased, noise, gate, iterations, damping, tolerances, late=None, link_disturbance=None
    ))]
    fn new(
        robot: &Robot,
        kinds: Vec<String>,
        biased: Vec<bool>,
        noise: NoiseFields,
        gate: Option<f64>,
        iterations: usize,
        damping: bool,
        tolerances: Vec<ToleranceTuple>,
        late: Option<Vec<Inside>>,
        link_disturbance: Option<LinkDisturbance>,
    ) -> PyResult<Self> {
        let tolerances = of_core(&tolerances)?;
        let kinds = named(&kinds)?;
        let build = || {
            let mut model = JerkModel::new(Arc::clone(&robot.0), &kinds, &biased)?;
            if let Some(law) = link_disturbance {
                model = model.with_disturbances(law.into())?;
            }
            let model =
                JerkDriven::new(model, noise.into(), damping)?.with_tolerances(tolerances).with_late(&inside(late))?;
            kalman::ExtendedKalmanFilter::new(model, FilterSettings { gate, iterations })
        };
        let filter = build().map_err(IntoPyErr::into_py_err)?;
        let live = Live::new(filter.model())?;
        Ok(Self { filter, tool: robot.0.tool.is_some(), live })
    }

    /// Number of states.
    #[getter]
    fn states(&self) -> usize {
        self.filter.model().states()
    }

    /// Number of states, but for those of late sensors.
    #[getter]
    fn own_states(&self) -> usize {
        self.filter.model().own_states()
    }

    /// A copy with the same belief.
    fn copy(&self) -> Self {
        self.clone()
    }

    fn reset(&mut self) {
        self.filter.reset();
        self.live.ddqref.clear();
    }

    /// From now on a first sample finds this mean and covariance of the state; nothing: the robot at rest.
    #[pyo3(signature = (mean, covariance))]
    fn set_start(&mut self, mean: Signal<'_>, covariance: Matrix<'_>) -> PyResult<()> {
        let states = self.filter.model().own_states();
        let start = Gaussian::new(mean.sized("mean", states)?, rows("covariance", &covariance, states)?);
        start.and_then(|start| self.filter.set_start(Some(start))).map_err(IntoPyErr::into_py_err)
    }

    /// Takes one sample; what is not given is missing.
    #[pyo3(signature = (dt, theta, acceleration=None, dtheta=None, ddqref=None, further=None))]
    fn step(
        &mut self,
        dt: f64,
        theta: Signal<'_>,
        acceleration: Option<Signal<'_>>,
        dtheta: Option<Signal<'_>>,
        ddqref: Option<Signal<'_>>,
        further: Option<Signal<'_>>,
    ) -> PyResult<State> {
        check_step(dt)?;
        let sensors = self.filter.model().acceleration_channels();
        self.live.set(dt, sensors, &Signals { theta, acceleration, dtheta, ddqref, further })?;
        let sample = KalmanSample { dt, readings: &self.live.readings, inputs: self.live.inputs() };
        let t = if self.filter.is_started() { self.live.t + dt } else { 0.0 };
        self.filter.step(sample).map_err(IntoPyErr::into_py_err)?;
        self.live.t = t;
        self.filter.report_into(&mut self.live.row);
        let state = State::of_row(t, self.filter.model().robot().len(), &self.live.row, 0);
        Ok(state.with_belief(&self.filter.belief().mean, &self.filter.covariance()))
    }

    /// Covariance of the state after the last sample.
    #[getter]
    fn covariance<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, numpy::PyArrayDyn<f64>>> {
        let states = self.filter.model().states();
        shaped(py, self.filter.covariance().dense().collect(), vec![states, states])
    }

    /// Errors of the parameters by the readings so far, in the measure of their tolerances, and the standard deviations
    /// of these.
    #[getter]
    fn parameters(&self) -> (Vec<f64>, Vec<f64>) {
        self.filter.parameters()
    }

    /// Contradictions between readings and model since the start.
    #[getter]
    fn findings(&self) -> Vec<Found> {
        findings(self.filter.findings())
    }

    /// Goes on from the live state with the rows of a log, or of a piece of one.
    fn run<'py>(
        &mut self,
        py: Python<'py>,
        arrays: Arrays<'py>,
        covariance: bool,
        innovations: bool,
    ) -> PyResult<Bound<'py, PyDict>> {
        let recording = recording(self.filter.model(), &arrays)?;
        let filter = &mut self.filter;
        let out = py.release(|| filter.run(recording, Keep { covariance, innovations }))?;
        into_dict(py, out, self.filter.model(), self.tool)
    }

    /// Each log from a fresh start with the filter beside it, on all cores, through the smoother where asked: its arrays, or the
    /// exception that it came to.
    #[staticmethod]
    fn run_all<'py>(
        py: Python<'py>,
        jobs: Vec<(PyRef<'py, Self>, Arrays<'py>)>,
        smooth: bool,
        covariance: bool,
        innovations: bool,
    ) -> PyResult<Vec<Bound<'py, PyAny>>> {
        let recordings = jobs
            .iter()
            .map(|(own, arrays)| Ok((&own.filter, recording(own.filter.model(), arrays)?)))
            .collect::<PyResult<Vec<_>>>()?;
        let keep = Keep { covariance, innovations };
        let results =
            py.release(|| Ok::<_, RunError>(kalman::ExtendedKalmanFilter::run_each(&recordings, smooth, keep)))?;
        let convert = |own: &Self, out| into_dict(py, out, own.filter.model(), own.tool);
        jobs.iter().zip(results).map(|((own, _), result)| outcome(py, result, |out| convert(own, out))).collect()
    }
}

pub(crate) fn recording<'a>(model: &JerkDriven, arrays: &'a Arrays<'_>) -> PyResult<KalmanRecording<'a>> {
    let (dt, readings, dtheta, jerk) = arrays;
    let n = model.robot().len();
    Ok(KalmanRecording {
        dt: rows("dt", dt, dt.len())?,
        readings: rows("readings", readings, model.channels())?,
        inputs: Inputs { dtheta: rows("dtheta", dtheta, n)?, jerk: rows("jerk", jerk, n)?, tau: &[] },
    })
}

/// The fields of an estimate, by name, as arrays of one row a sample; what was not kept is not there.
pub(crate) fn into_dict<'py>(
    py: Python<'py>,
    o: FilterOutput,
    model: &impl Model,
    tool: bool,
) -> PyResult<Bound<'py, PyDict>> {
    let out = PyDict::new(py);
    let (n, m, states, count) = (model.robot().len(), model.channels(), model.states(), o.status.len());
    let put = |name: &str, values: Vec<f64>, shape: &[usize]| {
        let shape: Vec<usize> = core::iter::once(count).chain(shape.iter().copied()).collect();
        out.set_item(name, shaped(py, values, shape)?)
    };
    for (name, values) in [("q", o.q), ("dq", o.dq), ("ddq", o.ddq), ("theta", o.theta), ("dtheta", o.dtheta)] {
        put(name, values, &[n])?;
    }
    put("q_std", o.q_std, &[n])?;
    if !o.disturbance.is_empty() {
        put("disturbance", o.disturbance, &[n])?;
        put("disturbance_std", o.disturbance_std, &[n])?;
    }
    if tool {
        put("tool_position", o.tool, &[3])?;
        put("tool_std", o.tool_std, &[3])?;
    }
    put("nis", o.nis, &[])?;
    put("log_likelihood", o.log_likelihood, &[])?;
    if !o.state.is_empty() {
        put("state", o.state, &[states])?;
        put("covariance", o.covariance, &[states, states])?;
    }
    if !o.innovation.is_empty() {
        put("innovation", o.innovation, &[m])?;
        put("innovation_std", o.innovation_std, &[m])?;
    }
    out.set_item("used", PyArray1::from_vec(py, o.used))?;
    out.set_item("status", PyArray1::from_vec(py, o.status))?;
    out.set_item("findings", findings(&o.findings))?;
    Ok(out)
}

/// A finding: channel, first and last sample, size, the same in standard deviations, and what the readings look like.
pub(crate) type Found = (Option<usize>, u64, u64, f64, f64, &'static str);

pub(crate) fn findings(all: &[Finding]) -> Vec<Found> {
    let one = |f: &Finding| (f.channel, f.since, f.until, f.size, f.deviations, word(f.fault));
    all.iter().map(one).collect()
}

fn word(fault: Fault) -> &'static str {
    match fault {
        Fault::Stuck => "stuck",
        Fault::Saturated => "saturated",
        Fault::Dead => "dead",
        Fault::Wrap => "wrap",
        Fault::Step => "step",
        Fault::Flipped => "flipped",
        Fault::Unknown => "unknown",
    }
}

/// Smoother that takes a recording's stretches from the last to the first.
#[pyclass(module = "linkside._core")]
pub(crate) struct StretchSmoother {
    smoother: kalman::Smoother<JerkDriven>,
    tool: bool,
}

#[pymethods]
impl StretchSmoother {
    #[new]
    fn new(filter: &ExtendedKalmanFilter) -> Self {
        Self { smoother: kalman::Smoother::new(&filter.filter), tool: filter.tool }
    }

    /// Samples whose history fits into the memory set aside.
    #[getter]
    fn stretch(&self) -> usize {
        self.smoother.stretch()
    }

    /// Smooths a stretch; `start` is the filter as it was before it.
    fn back<'py>(
        &mut self,
        py: Python<'py>,
        start: PyRef<'py, ExtendedKalmanFilter>,
        arrays: Arrays<'py>,
        covariance: bool,
    ) -> PyResult<Bound<'py, PyDict>> {
        let recording = recording(start.filter.model(), &arrays)?;
        let (smoother, filter) = (&mut self.smoother, &start.filter);
        let out = py.release(|| smoother.stretch_back(filter, recording, Keep { covariance, innovations: false }))?;
        into_dict(py, out, filter.model(), self.tool)
    }

    /// One row of a stretch, smoothed; `t` is its time.
    fn row(
        &mut self,
        py: Python<'_>,
        start: PyRef<'_, ExtendedKalmanFilter>,
        arrays: Arrays<'_>,
        row: usize,
        t: f64,
    ) -> PyResult<State> {
        let recording = recording(start.filter.model(), &arrays)?;
        let (smoother, filter) = (&mut self.smoother, &start.filter);
        let keep = Keep { covariance: true, innovations: false };
        let out = py.release(|| smoother.stretch_back(filter, recording, keep))?;
        let states = filter.model().states();
        let state = State::of_row(t, filter.model().robot().len(), &out, row);
        Ok(state.with_whole(
            &out.state[row * states..][..states],
            &out.covariance[row * states * states..][..states * states],
        ))
    }
}
