//! The acceleration-driven observer.

use crate::array::{Signal, rows, shaped};
use crate::error::{EstimatorError, IntoPyErr, outcome};
use crate::gil::Release;
use crate::robot::Robot;
use linkside_core::error::RunError;
use linkside_core::estimate::observer::{
    self, AccelerationSource, Complex, Form, JointModel, Poles, Recording, Sample, Settings, Trajectory,
};
use numpy::{PyArray1, PyArrayDyn, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::sync::Arc;

/// Observer of one robot, designed for one sampling period.
#[pyclass(module = "linkside._core")]
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
    #[pyo3(signature = (robot, *, period, poles, bias, predictor, joint_accelerations, worst_acceleration_std))]
    fn new(
        robot: &Robot,
        period: f64,
        poles: Vec<Vec<Complex>>,
        bias: bool,
        predictor: bool,
        joint_accelerations: bool,
        worst_acceleration_std: f64,
    ) -> PyResult<Self> {
        let source = if joint_accelerations { AccelerationSource::Joints } else { AccelerationSource::Sensors };
        let form = if predictor { Form::Predictor } else { Form::Current };
        let settings = Settings { period, poles, bias, form, source, worst_acceleration_std };
        let fresh = observer::AccelerationObserver::new(Arc::clone(&robot.0), settings);
        let fresh = fresh.map_err(IntoPyErr::into_py_err)?;
        Ok(Self { live: fresh.clone(), fresh, tool: robot.0.tool.is_some() })
    }

    fn reset(&mut self) {
        self.live = self.fresh.clone();
    }

    fn start(&mut self, theta: Signal<'_>, q: Signal<'_>, dtheta: Signal<'_>, dq: Signal<'_>) -> PyResult<()> {
        self.live
            .start(theta.get("theta")?, q.get("q")?, dtheta.get("dtheta")?, dq.get("dq")?)
            .map_err(IntoPyErr::into_py_err)
    }

    fn step(&mut self, theta: Signal<'_>, tau: Signal<'_>, acceleration: Signal<'_>) -> PyResult<ObserverState> {
        let (n, m) = (self.live.joints(), self.live.channels());
        let sample = Sample {
            theta: theta.sized("theta", n)?,
            tau: tau.sized("tau", n)?,
            acceleration: acceleration.sized("acceleration", m)?,
        };
        self.live.step(sample).map_err(IntoPyErr::into_py_err)?;
        Ok(ObserverState::of(&self.live))
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

    /// Each log from a fresh start, on all cores: its arrays, or the exception that it came to.
    fn run_all<'py>(&self, py: Python<'py>, logs: Vec<Arrays<'py>>) -> PyResult<Vec<Bound<'py, PyAny>>> {
        let recordings = logs.iter().map(|arrays| recording(&self.fresh, arrays)).collect::<PyResult<Vec<_>>>()?;
        let fresh = &self.fresh;
        let results = py.release(|| Ok::<_, RunError>(fresh.run_all(&recordings)))?;
        let convert = |t| into_dict(py, t, self.fresh.joints(), self.tool);
        results.into_iter().map(|result| outcome(py, result, convert)).collect()
    }
}

fn recording<'a>(observer: &observer::AccelerationObserver, arrays: &'a Arrays<'_>) -> PyResult<Recording<'a>> {
    let (theta, tau, acceleration) = arrays;
    let (n, m) = (observer.joints(), observer.channels());
    Ok(Recording {
        count: theta.shape()[0],
        theta: rows("theta", theta, n)?,
        tau: rows("tau", tau, n)?,
        acceleration: rows("acceleration", acceleration, m)?,
    })
}

/// The fields of an estimate, by name, as arrays of one row a sample.
fn into_dict<'py>(py: Python<'py>, t: Trajectory, n: usize, tool: bool) -> PyResult<Bound<'py, PyDict>> {
    let out = PyDict::new(py);
    let count = t.status.len();
    for (name, values) in [("q", t.q), ("dq", t.dq), ("ddq", t.ddq), ("theta", t.theta), ("dtheta", t.dtheta)] {
        out.set_item(name, shaped(py, values, vec![count, n])?)?;
    }
    if tool {
        out.set_item("tool_position", shaped(py, t.tool, vec![count, 3])?)?;
    }
    out.set_item("status", PyArray1::from_vec(py, t.status))?;
    Ok(out)
}

/// The estimate at one sample; arrays are made when they are asked for.
#[pyclass(frozen, module = "linkside._core")]
pub(crate) struct ObserverState {
    /// q, q̇, q̈, θ and θ̇, one after the other.
    values: Box<[f64]>,
    tool: [f64; 3],
    #[pyo3(get)]
    status: u8,
}

impl ObserverState {
    fn of(observer: &observer::AccelerationObserver) -> Self {
        let n = observer.joints();
        let mut values = Vec::with_capacity(5 * n);
        for part in [observer.q(), observer.dq(), observer.ddq()] {
            values.extend_from_slice(part);
        }
        values.extend((0..n).map(|j| observer.motor(j).0));
        values.extend((0..n).map(|j| observer.motor(j).1));
        Self { values: values.into(), tool: observer.tool(), status: observer.status() }
    }

    fn part<'py>(&self, py: Python<'py>, index: usize) -> Bound<'py, PyArray1<f64>> {
        let n = self.values.len() / 5;
        PyArray1::from_slice(py, &self.values[index * n..][..n])
    }
}

#[pymethods]
impl ObserverState {
    #[getter]
    fn q<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.part(py, 0)
    }

    #[getter]
    fn dq<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.part(py, 1)
    }

    #[getter]
    fn ddq<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.part(py, 2)
    }

    #[getter]
    fn theta<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.part(py, 3)
    }

    #[getter]
    fn dtheta<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.part(py, 4)
    }

    #[getter]
    fn tool_position<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<f64>>> {
        (!self.tool[0].is_nan()).then(|| PyArray1::from_slice(py, &self.tool))
    }
}

/// Continuous-time gains of one joint, in closed form.
#[pyfunction]
pub(crate) fn observer_gains(
    py: Python<'_>,
    robot: &Robot,
    joint: usize,
    poles: Vec<Complex>,
) -> PyResult<Py<PyArrayDyn<f64>>> {
    let drive = robot.0.drives.get(joint).ok_or_else(|| EstimatorError::new_err(format!("no joint {joint}")))?;
    let model = match (drive.elastic, poles.len()) {
        (false, _) => JointModel::Rigid,
        (true, 5) => JointModel::ElasticWithBias,
        (true, _) => JointModel::Elastic,
    };
    let poles = Poles::new(joint, &poles, model.order()).map_err(IntoPyErr::into_py_err)?;
    let gains = observer::closed_form_gains(model, drive, &poles);
    Ok(shaped(py, gains.as_slice().to_vec(), vec![model.order()])?.unbind())
}
