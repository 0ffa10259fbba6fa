//! Kalman filter and smoother on the acceleration-driven model.

use crate::array::{Signal, rows, shaped, write_into};
use crate::error::{EstimatorError, IntoPyErr, outcome};
use crate::gil::Release;
use crate::robot::Robot;
use crate::tolerance::{Told, tolerances};
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
pub(crate) struct Noise {
    jerk: Vec<f64>,
    link_walk: Vec<f64>,
    reading: Vec<f64>,
    torsion: f64,
    bias_walk: Vec<f64>,
    bias_time: Vec<f64>,
    initial: Vec<f64>,
    initial_bias: Vec<f64>,
}

impl From<Noise> for kalman::Noise {
    fn from(n: Noise) -> Self {
        let Noise { jerk, link_walk, reading, torsion, bias_walk, bias_time, initial, initial_bias } = n;
        Self { jerk, link_walk, reading, torsion, bias_walk, bias_time, initial, initial_bias }
    }
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
    ddqref: Vec<f64>,
    jerk: Vec<f64>,
}

impl Live {
    pub(crate) fn new(joints: usize, channels: usize) -> Self {
        Self {
            readings: vec![f64::NAN; channels],
            dtheta: vec![f64::NAN; joints],
            ddqref: Vec::new(),
            jerk: vec![0.0; joints],
        }
    }

    pub(crate) fn inputs(&self) -> Inputs<'_> {
        Inputs { dtheta: &self.dtheta, jerk: &self.jerk, tau: &[] }
    }

    pub(crate) fn set(
        &mut self,
        dt: f64,
        sensors: usize,
        theta: &Signal<'_>,
        acceleration: Option<&Signal<'_>>,
        dtheta: Option<&Signal<'_>>,
        ddqref: Option<&Signal<'_>>,
        further: Option<&Signal<'_>>,
    ) -> PyResult<()> {
        let n = self.jerk.len();
        let (motors, rest) = self.readings.split_at_mut(n);
        let (accelerations, others) = rest.split_at_mut(sensors);
        motors.copy_from_slice(theta.sized("theta", n)?);
        fill(accelerations, "acceleration", acceleration)?;
        fill(others, "further readings", further)?;
        fill(&mut self.dtheta, "dtheta", dtheta)?;
        self.jerk.fill(0.0);
        let Some(now) = ddqref else {
            self.ddqref.clear();
            return Ok(());
        };
        let now = now.sized("ddqref", n)?;
        for ((jerk, now), before) in self.jerk.iter_mut().zip(now).zip(&self.ddqref) {
            *jerk = (now - before) / dt;
        }
        self.ddqref.clear();
        self.ddqref.extend_from_slice(now);
        Ok(())
    }
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

/// Copies a signal, or NaN where there is none.
pub(crate) fn fill(to: &mut [f64], name: &str, signal: Option<&Signal<'_>>) -> PyResult<()> {
    match signal {
        Some(signal) => to.copy_from_slice(signal.sized(name, to.len())?),
        None => to.fill(f64::NAN),
    }
    Ok(())
}

pub(crate) type Matrix<'py> = PyReadonlyArray2<'py, f64>;
pub(crate) type Arrays<'py> = (PyReadonlyArray1<'py, f64>, Matrix<'py>, Matrix<'py>, Matrix<'py>);

#[pymethods]
impl ExtendedKalmanFilter {
    #[new]
    #[pyo3(signature = (robot, *, kinds, biased, noise, gate, iterations, damping, told, late=None))]
    fn new(
        robot: &Robot,
        kinds: Vec<String>,
        biased: Vec<bool>,
        noise: Noise,
        gate: Option<f64>,
        iterations: usize,
        damping: bool,
        told: Vec<Told>,
        late: Option<Vec<Inside>>,
    ) -> PyResult<Self> {
        let told = tolerances(&told)?;
        let kinds = named(&kinds)?;
        let build = || {
            let model = JerkModel::new(Arc::clone(&robot.0), &kinds, &biased)?;
            let model =
                JerkDriven::new(model, noise.into(), damping)?.with_tolerances(told).with_late(&inside(late))?;
            kalman::ExtendedKalmanFilter::new(model, FilterSettings { gate, iterations })
        };
        let filter = build().map_err(IntoPyErr::into_py_err)?;
        let (n, m) = (filter.model().robot().len(), filter.model().channels());
        let live = Live::new(n, m);
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
        let states = self.filter.model().states();
        let start = Gaussian::new(mean.sized("mean", states)?, rows("covariance", &covariance, states)?);
        start.and_then(|start| self.filter.set_start(Some(start))).map_err(IntoPyErr::into_py_err)
    }

    /// Takes one sample, and writes the state's mean into `out`; what is not given is missing.
    #[pyo3(signature = (dt, theta, acceleration, dtheta, ddqref, further, out))]
    fn step(
        &mut self,
        dt: f64,
        theta: Signal<'_>,
        acceleration: Option<Signal<'_>>,
        dtheta: Option<Signal<'_>>,
        ddqref: Option<Signal<'_>>,
        further: Option<Signal<'_>>,
        out: &Bound<'_, PyArray1<f64>>,
    ) -> PyResult<u8> {
        let states = self.filter.model().states();
        let sensors = self.filter.model().acceleration_channels();
        write_into(out, states, |out| {
            self.live.set(
                dt,
                sensors,
                &theta,
                acceleration.as_ref(),
                dtheta.as_ref(),
                ddqref.as_ref(),
                further.as_ref(),
            )?;
            let sample = KalmanSample { dt, readings: &self.live.readings, inputs: self.live.inputs() };
            self.filter.step(sample).map_err(IntoPyErr::into_py_err)?;
            out.copy_from_slice(&self.filter.belief().mean);
            Ok(self.filter.status())
        })
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

    /// Each log from a fresh start, on all cores, through the smoother where asked: its arrays, or the exception that it
    /// came to.
    fn run_all<'py>(
        &self,
        py: Python<'py>,
        logs: Vec<Arrays<'py>>,
        smooth: bool,
        covariance: bool,
        innovations: bool,
    ) -> PyResult<Vec<Bound<'py, PyAny>>> {
        let model = self.filter.model();
        let recordings = logs.iter().map(|arrays| recording(model, arrays)).collect::<PyResult<Vec<_>>>()?;
        let filter = &self.filter;
        let keep = Keep { covariance, innovations };
        let results = py.release(|| Ok::<_, RunError>(filter.run_all(&recordings, smooth, keep)))?;
        let convert = |out| into_dict(py, out, model, self.tool);
        results.into_iter().map(|result| outcome(py, result, convert)).collect()
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
}
