//! The acceleration-driven observer.

use crate::array::{Signal, counted, rows, shaped};
use crate::error::{EstimatorError, IntoPyErr, outcome};
use crate::gil::Release;
use crate::plain::Plain;
use crate::robot::Robot;
use crate::state::State;
use linkside_compiled::description;
use linkside_core::error::RunError;
use linkside_core::estimate::observer::{
    self, AccelerationMap, Complex, Form, JointModel, ObserverOutput, ObserverRecording, ObserverSample, Poles,
    Sampled, UltimateBound,
};
use linkside_core::robot::Drive;
use numpy::{PyArray1, PyArrayDyn, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// Observer of one robot, designed for one sampling period.
#[pyclass(module = "linkside._core")]
#[derive(Clone)]
pub(crate) struct AccelerationObserver {
    pub(crate) fresh: observer::AccelerationObserver,
    live: observer::AccelerationObserver,
    tool: bool,
}

type Matrix<'py> = PyReadonlyArray2<'py, f64>;
type Arrays<'py> = (Matrix<'py>, Matrix<'py>, Matrix<'py>);

#[pymethods]
impl AccelerationObserver {
    #[new]
    fn new(robot: &Robot, settings: Plain<description::Observer>) -> PyResult<Self> {
        let fresh = settings.0.build(&robot.0).map_err(IntoPyErr::into_py_err)?;
        Ok(Self { live: fresh.clone(), fresh, tool: robot.0.tool.is_some() })
    }

    /// A copy with the same state.
    fn copy(&self) -> Self {
        self.clone()
    }

    fn reset(&mut self) {
        self.live = self.fresh.clone();
    }

    fn start(&mut self, theta: Signal<'_>, q: Signal<'_>, dtheta: Signal<'_>, dq: Signal<'_>) -> PyResult<()> {
        self.live
            .start(theta.get("theta")?, q.get("q")?, dtheta.get("dtheta")?, dq.get("dq")?)
            .map_err(IntoPyErr::into_py_err)
    }

    /// From now on every recording, and `step` after a reset, starts from this state.
    fn begin(&mut self, theta: Signal<'_>, q: Signal<'_>, dtheta: Signal<'_>, dq: Signal<'_>) -> PyResult<()> {
        self.start(theta, q, dtheta, dq)?;
        self.fresh = self.live.clone();
        Ok(())
    }

    fn step(&mut self, theta: Signal<'_>, tau: Signal<'_>, acceleration: Signal<'_>) -> PyResult<State> {
        let (n, m) = (self.live.joints(), self.live.channels());
        let sample = ObserverSample {
            theta: theta.readings("theta", n)?,
            tau: tau.readings("tau", n)?,
            acceleration: acceleration.readings("acceleration", m)?,
        };
        self.live.step(sample).map_err(IntoPyErr::into_py_err)?;
        Ok(State::of_observer(&self.live))
    }

    fn hold(&mut self, tau: Signal<'_>) -> PyResult<()> {
        self.live.hold(tau.get("tau")?).map_err(IntoPyErr::into_py_err)
    }

    /// Goes on from the live state with the rows of a log, or of a piece of one.
    fn run<'py>(
        &mut self,
        py: Python<'py>,
        theta: Matrix<'py>,
        tau: Matrix<'py>,
        acceleration: Matrix<'py>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let arrays = (theta, tau, acceleration);
        let recording = recording(&self.live, &arrays)?;
        let live = &mut self.live;
        let trajectory = py.release(|| live.run(recording))?;
        into_dict(py, trajectory, self.live.joints(), self.tool)
    }

    /// Each log from a fresh start with the observer beside it, on all cores: its arrays, or the exception that it came to.
    #[staticmethod]
    fn run_all<'py>(py: Python<'py>, jobs: Vec<(PyRef<'py, Self>, Arrays<'py>)>) -> PyResult<Vec<Bound<'py, PyAny>>> {
        let recordings = jobs
            .iter()
            .map(|(own, arrays)| Ok((&own.fresh, recording(&own.fresh, arrays)?)))
            .collect::<PyResult<Vec<_>>>()?;
        let results = py.release(|| Ok::<_, RunError>(observer::AccelerationObserver::run_each(&recordings)))?;
        let convert = |own: &Self, t| into_dict(py, t, own.fresh.joints(), own.tool);
        jobs.iter().zip(results).map(|((own, _), result)| outcome(py, result, |t| convert(own, t))).collect()
    }
}

fn recording<'a>(observer: &observer::AccelerationObserver, arrays: &'a Arrays<'_>) -> PyResult<ObserverRecording<'a>> {
    let (theta, tau, acceleration) = arrays;
    let (n, m) = (observer.joints(), observer.channels());
    Ok(ObserverRecording {
        count: theta.shape()[0],
        theta: rows("theta", theta, n)?,
        tau: counted("tau", tau, n, theta.shape()[0])?,
        acceleration: counted("acceleration", acceleration, m, theta.shape()[0])?,
    })
}

/// The fields of an estimate, by name, as arrays of one row a sample.
fn into_dict<'py>(py: Python<'py>, t: ObserverOutput, n: usize, tool: bool) -> PyResult<Bound<'py, PyDict>> {
    let out = PyDict::new(py);
    let count = t.status.len();
    for (name, values) in [("q", t.q), ("dq", t.dq), ("ddq", t.ddq), ("theta", t.theta), ("dtheta", t.dtheta)] {
        out.set_item(name, shaped(py, values, vec![count, n])?)?;
    }
    if tool {
        out.set_item("tool_position", shaped(py, t.tool, vec![count, 3])?)?;
    }
    if !t.q_std.is_empty() {
        out.set_item("q_std", shaped(py, t.q_std, vec![count, n])?)?;
    }
    if !t.tool_std.is_empty() {
        out.set_item("tool_std", shaped(py, t.tool_std, vec![count, 3])?)?;
    }
    out.set_item("status", PyArray1::from_vec(py, t.status))?;
    Ok(out)
}

/// Continuous-time gains of one joint, in closed form.
#[pyfunction]
pub(crate) fn observer_gains(
    py: Python<'_>,
    robot: &Robot,
    joint: usize,
    poles: Vec<Complex>,
) -> PyResult<Py<PyArrayDyn<f64>>> {
    let (drive, model, poles) = joint_design(robot, joint, &poles)?;
    let gains = observer::closed_form_gains(model, drive, &poles);
    Ok(shaped(py, gains.as_slice().to_vec(), vec![model.order()])?.unbind())
}

/// One joint's observer in discrete time: transition, responses to held and to ramped inputs, and gain.
#[pyfunction]
pub(crate) fn sampled_observer<'py>(
    py: Python<'py>,
    robot: &Robot,
    joint: usize,
    poles: Vec<Complex>,
    period: f64,
) -> PyResult<[Bound<'py, PyArrayDyn<f64>>; 4]> {
    let (drive, model, poles) = joint_design(robot, joint, &poles)?;
    let order = model.order();
    let [transition, held, ramp, gain] = Sampled::new(model, drive, &poles, period).matrices(order);
    Ok([
        shaped(py, transition, vec![order, order])?,
        shaped(py, held, vec![order, 2])?,
        shaped(py, ramp, vec![order, 2])?,
        shaped(py, gain, vec![order])?,
    ])
}

/// What one joint's link position and velocity can be off by at most, for a unit of torque, acceleration and reading each.
#[pyfunction]
pub(crate) fn observer_bound(
    robot: &Robot,
    joint: usize,
    poles: Vec<Complex>,
    period: f64,
    predictor: bool,
) -> PyResult<[[f64; 2]; 3]> {
    let (drive, model, poles) = joint_design(robot, joint, &poles)?;
    let form = if predictor { Form::Predictor } else { Form::Current };
    let bound = UltimateBound::new(model, drive, &poles, period, form);
    Ok([bound.torque, bound.acceleration, bound.reading])
}

/// By how much each joint's acceleration grows with each accelerometer reading, at rest: the damped inverse of their map.
#[pyfunction]
pub(crate) fn acceleration_inverse<'py>(
    py: Python<'py>,
    robot: &Robot,
    q: Signal<'_>,
    worst_std: f64,
) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
    let (n, channels) = (robot.0.len(), robot.0.acceleration_channels());
    let inverse = AccelerationMap::inverse(&robot.0, q.sized("q", n)?, worst_std);
    shaped(py, inverse, vec![n, channels])
}

fn joint_design<'a>(robot: &'a Robot, joint: usize, poles: &[Complex]) -> PyResult<(&'a Drive, JointModel, Poles)> {
    let drive = robot.0.drives.get(joint).ok_or_else(|| EstimatorError::new_err(format!("no joint {joint}")))?;
    let model = match (drive.elastic, poles.len()) {
        (false, _) => JointModel::Rigid,
        (true, 5) => JointModel::ElasticWithBias,
        (true, _) => JointModel::Elastic,
    };
    let poles = Poles::new(joint, poles, model.order()).map_err(IntoPyErr::into_py_err)?;
    Ok((drive, model, poles))
}
