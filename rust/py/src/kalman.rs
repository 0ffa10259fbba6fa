//! Kalman filter and smoother on the jerk-driven model.

use crate::array::{Signal, rows, shaped};
use crate::error::{IntoPyErr, outcome};
use crate::filtering::{self, Found, Matrix, findings, into_dict};
use crate::gil::Release;
use crate::live::{Live, Signals, check_step};
use crate::plain::Plain;
use crate::robot::Robot;
use crate::state::State;
use linkside_compiled::description;
use linkside_core::error::RunError;
use linkside_core::estimate::kalman::{
    self, Inputs, JerkDriven, JerkNoise, KalmanRecording, Keep, Model, NoiseEvidence,
};
use numpy::{PyArray1, PyReadonlyArray1, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;

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
    live: Live,
}

/// The noise of each source alone.
type Shares = Vec<Plain<description::JerkNoise>>;

pub(crate) type Arrays<'py> = (PyReadonlyArray1<'py, f64>, Matrix<'py>, Matrix<'py>, Matrix<'py>);

#[pymethods]
impl ExtendedKalmanFilter {
    #[new]
    fn new(robot: &Robot, settings: Plain<description::JerkFilter>) -> PyResult<Self> {
        let filter = settings.0.build(&robot.0).map_err(IntoPyErr::into_py_err)?;
        let live = Live::new(filter.model())?;
        Ok(Self { filter, live })
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

    /// From now on linearises at these leading states, one row a sample.
    fn linearise_along(&mut self, leading: Matrix<'_>) -> PyResult<()> {
        let width = leading.shape()[1];
        self.filter.linearise_along(rows("leading", &leading, width)?, width).map_err(IntoPyErr::into_py_err)
    }

    /// From now on a first sample finds this mean and covariance of the state; nothing: the robot at rest.
    #[pyo3(signature = (mean, covariance))]
    fn set_start(&mut self, mean: Signal<'_>, covariance: Matrix<'_>) -> PyResult<()> {
        let start = filtering::belief(&mean, &covariance, self.filter.model().own_states())?;
        self.filter.set_start(Some(start)).map_err(IntoPyErr::into_py_err)
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
        let Self { filter, live } = self;
        let sensors = filter.model().acceleration_channels();
        live.set(dt, sensors, &Signals { theta, acceleration, dtheta, ddqref, further })?;
        let (sample, t, row) = live.parts(dt);
        filtering::step(filter, sample, t, row)
    }

    /// Covariance of the state after the last sample.
    #[getter]
    fn covariance<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, numpy::PyArrayDyn<f64>>> {
        filtering::covariance(py, &self.filter)
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
        filtering::run(py, &mut self.filter, recording, Keep { covariance, innovations })
    }

    /// Each log from a fresh start with the filter beside it, on all cores, ``"filter"``, ``"smooth"`` or ``"iterate"``: its
    /// arrays, or the exception that it came to.
    #[staticmethod]
    fn run_all<'py>(
        py: Python<'py>,
        jobs: Vec<(PyRef<'py, Self>, Arrays<'py>)>,
        way: &str,
        covariance: bool,
        innovations: bool,
    ) -> PyResult<Vec<Bound<'py, PyAny>>> {
        let jobs = jobs
            .iter()
            .map(|(own, arrays)| Ok((&own.filter, recording(own.filter.model(), arrays)?)))
            .collect::<PyResult<Vec<_>>>()?;
        filtering::run_all(py, &jobs, way, Keep { covariance, innovations })
    }

    /// What each log says of sources of its noise, from a fresh start with the filter beside it, on all cores; of each the noise
    /// of that source alone, and samples a stretch.
    #[staticmethod]
    fn noise_evidence<'py>(
        py: Python<'py>,
        jobs: Vec<(PyRef<'py, Self>, Arrays<'py>, Shares, usize)>,
    ) -> PyResult<Vec<Bound<'py, PyAny>>> {
        let shares: Vec<Vec<JerkNoise>> =
            jobs.iter().map(|(_, _, shares, _)| shares.iter().map(|share| share.0.clone().into()).collect()).collect();
        let each = jobs
            .iter()
            .zip(&shares)
            .map(|((own, arrays, _, stretch), shares)| {
                Ok((&own.filter, recording(own.filter.model(), arrays)?, shares.as_slice(), *stretch))
            })
            .collect::<PyResult<Vec<_>>>()?;
        let found = py.release(|| Ok::<_, RunError>(kalman::ExtendedKalmanFilter::noise_evidence(&each)))?;
        let pairs = found.into_iter().zip(&shares);
        pairs.map(|(one, shares)| outcome(py, one, |one| evidence_into_dict(py, one, shares.len()))).collect()
    }
}

/// What a recording says of p sources of noise, by name: one row a sample, or a stretch.
fn evidence_into_dict<'py>(py: Python<'py>, found: NoiseEvidence, p: usize) -> PyResult<Bound<'py, PyDict>> {
    let out = PyDict::new(py);
    let count = found.log_likelihood.len();
    let stretches = found.information.len() / (p * p).max(1);
    out.set_item("log_likelihood", PyArray1::from_vec(py, found.log_likelihood))?;
    out.set_item("scores", shaped(py, found.scores, vec![count, p])?)?;
    out.set_item("dimensions", shaped(py, found.dimensions, vec![count, p])?)?;
    out.set_item("information", shaped(py, found.information, vec![stretches, p, p])?)?;
    Ok(out)
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

/// Smoother that takes a recording's stretches from the last to the first.
#[pyclass(module = "linkside._core")]
pub(crate) struct StretchSmoother {
    smoother: kalman::Smoother<JerkDriven>,
}

#[pymethods]
impl StretchSmoother {
    #[new]
    fn new(filter: &ExtendedKalmanFilter) -> Self {
        Self { smoother: kalman::Smoother::new(&filter.filter) }
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
        into_dict(py, out, filter.model())
    }
}

/// Smoother of a stream: the estimate of some samples ago.
#[pyclass(module = "linkside._core")]
#[derive(Clone)]
pub(crate) struct FixedLagSmoother {
    smoother: kalman::FixedLagSmoother<JerkDriven>,
    live: Live,
}

#[pymethods]
impl FixedLagSmoother {
    #[new]
    fn new(filter: &ExtendedKalmanFilter, lag: usize) -> PyResult<Self> {
        let smoother = kalman::FixedLagSmoother::new(&filter.filter, lag).map_err(IntoPyErr::into_py_err)?;
        Ok(Self { live: Live::new(smoother.model())?, smoother })
    }

    /// A copy with the same samples.
    fn copy(&self) -> Self {
        self.clone()
    }

    /// Takes one sample; what is not given is missing. Gives the state of a lag ago once there are as many samples.
    #[pyo3(signature = (dt, theta, acceleration=None, dtheta=None, ddqref=None, further=None))]
    fn step(
        &mut self,
        dt: f64,
        theta: Signal<'_>,
        acceleration: Option<Signal<'_>>,
        dtheta: Option<Signal<'_>>,
        ddqref: Option<Signal<'_>>,
        further: Option<Signal<'_>>,
    ) -> PyResult<Option<State>> {
        check_step(dt)?;
        let Self { smoother, live } = self;
        let (sensors, n) = (smoother.model().acceleration_channels(), smoother.model().robot().len());
        live.set(dt, sensors, &Signals { theta, acceleration, dtheta, ddqref, further })?;
        let earlier = smoother.step(live.parts(dt).0).map_err(IntoPyErr::into_py_err)?;
        Ok(earlier.map(|(t, row)| State::of_row(t, n, row, 0).with_whole(&row.state, row.covariance.clone())))
    }

    /// The estimates that no step has given yet, with their times; starts anew.
    fn flush<'py>(&mut self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let (t, rows) = self.smoother.flush().map_err(IntoPyErr::into_py_err)?;
        let out = into_dict(py, rows, self.smoother.model())?;
        out.set_item("t", PyArray1::from_vec(py, t))?;
        Ok(out)
    }
}
