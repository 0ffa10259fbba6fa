//! The velocity observers.

use crate::array::{Signal, counted, rows, shaped};
use crate::error::{IntoPyErr, outcome};
use crate::gil::Release;
use crate::plain::Plain;
use crate::robot::Robot;
use crate::state::State;
use linkside_compiled::description;
use linkside_core::error::RunError;
use linkside_core::estimate::velocity::{self, VelocityOutput, VelocityRecording};
use numpy::{PyArray1, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// Velocity observer of one robot, designed for one sampling period.
#[pyclass(module = "linkside._core")]
#[derive(Clone)]
pub(crate) struct VelocityObserver {
    fresh: velocity::VelocityObserver,
    live: velocity::VelocityObserver,
    tool: bool,
}

type Matrix<'py> = PyReadonlyArray2<'py, f64>;
type Arrays<'py> = (Matrix<'py>, Matrix<'py>);

#[pymethods]
impl VelocityObserver {
    #[new]
    fn new(robot: &Robot, settings: Plain<description::Velocity>) -> PyResult<Self> {
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

    fn start(&mut self, dq: Signal<'_>, lag: Signal<'_>) -> PyResult<()> {
        self.live = self.fresh.clone();
        self.live.start(dq.get("dq")?, lag.get("lag")?).map_err(IntoPyErr::into_py_err)
    }

    /// From now on every recording, and `step` after a reset, starts from this velocity.
    fn begin(&mut self, dq: Signal<'_>, lag: Signal<'_>) -> PyResult<()> {
        self.start(dq, lag)?;
        self.fresh = self.live.clone();
        Ok(())
    }

    fn step(&mut self, q: Signal<'_>, tau: Signal<'_>) -> PyResult<State> {
        let n = self.live.joints();
        self.live.step(q.readings("q", n)?, tau.readings("tau", n)?).map_err(IntoPyErr::into_py_err)?;
        Ok(State::of_velocity_observer(&self.live))
    }

    /// Goes on from the live state with the rows of a log, or of a piece of one.
    fn run<'py>(&mut self, py: Python<'py>, q: Matrix<'py>, tau: Matrix<'py>) -> PyResult<Bound<'py, PyDict>> {
        let arrays = (q, tau);
        let n = self.live.joints();
        let recording = recording(n, &arrays)?;
        let live = &mut self.live;
        let trajectory = py.release(|| live.run(recording))?;
        into_dict(py, trajectory, n, self.tool)
    }

    /// Each log from a fresh start with the observer beside it, on all cores: its arrays, or the exception that it came to.
    #[staticmethod]
    fn run_all<'py>(py: Python<'py>, jobs: Vec<(PyRef<'py, Self>, Arrays<'py>)>) -> PyResult<Vec<Bound<'py, PyAny>>> {
        let recordings = jobs
            .iter()
            .map(|(own, arrays)| Ok((&own.fresh, recording(own.fresh.joints(), arrays)?)))
            .collect::<PyResult<Vec<_>>>()?;
        let results = py.release(|| Ok::<_, RunError>(velocity::VelocityObserver::run_each(&recordings)))?;
        let convert = |own: &Self, t| into_dict(py, t, own.fresh.joints(), own.tool);
        jobs.iter().zip(results).map(|((own, _), result)| outcome(py, result, |t| convert(own, t))).collect()
    }
}

fn recording<'a>(n: usize, (q, tau): &'a Arrays<'_>) -> PyResult<VelocityRecording<'a>> {
    Ok(VelocityRecording { count: q.shape()[0], q: rows("q", q, n)?, torque: counted("tau", tau, n, q.shape()[0])? })
}

fn into_dict<'py>(py: Python<'py>, t: VelocityOutput, n: usize, tool: bool) -> PyResult<Bound<'py, PyDict>> {
    let out = PyDict::new(py);
    let count = t.status.len();
    for (name, values) in [("q", t.q), ("dq", t.dq), ("ddq", t.ddq)] {
        out.set_item(name, shaped(py, values, vec![count, n])?)?;
    }
    if tool {
        out.set_item("tool_position", shaped(py, t.tool, vec![count, 3])?)?;
    }
    out.set_item("level", PyArray1::from_vec(py, t.level))?;
    out.set_item("status", PyArray1::from_vec(py, t.status))?;
    Ok(out)
}
