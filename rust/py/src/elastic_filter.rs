//! Kalman filter and smoother on the elastic-joint model, motors moved by torques or by jerk.

use crate::array::{Signal, rows};
use crate::error::{EstimatorError, IntoPyErr};
use crate::filtering::{self, Matrix};
use crate::live::check_step;
use crate::plain::Plain;
use crate::robot::Robot;
use crate::state::State;
use linkside_compiled::description;
use linkside_core::estimate::kalman::{
    ElasticModel, ExtendedKalmanFilter, FilterOutput, Inputs, KalmanRecording, KalmanSample, Keep, Model,
};
use numpy::{PyReadonlyArray1, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// Kalman filter on the elastic-joint model of one robot.
#[pyclass(module = "linkside._core")]
#[derive(Clone)]
pub(crate) struct ElasticJointFilter {
    pub(crate) filter: ExtendedKalmanFilter<ElasticModel>,
    /// Time since the first sample of `step` [s], and the estimate at the last one.
    t: f64,
    row: FilterOutput,
}

type Arrays<'py> = (PyReadonlyArray1<'py, f64>, Matrix<'py>, Matrix<'py>);

impl ElasticJointFilter {
    fn of(filter: ExtendedKalmanFilter<ElasticModel>) -> PyResult<Self> {
        let row = FilterOutput::zeros(1, filter.model(), Keep::default()).map_err(IntoPyErr::into_py_err)?;
        Ok(Self { filter, t: 0.0, row })
    }
}

#[pymethods]
impl ElasticJointFilter {
    #[new]
    fn new(robot: &Robot, settings: Plain<description::ElasticFilter>) -> PyResult<Self> {
        Self::of(settings.0.build(&robot.0).map_err(IntoPyErr::into_py_err)?)
    }

    /// The same of motors moved by jerk: where torques are said to go, their commanded jerk does.
    #[staticmethod]
    fn moved_by_jerk(robot: &Robot, settings: Plain<description::MotorJerkFilter>) -> PyResult<Self> {
        Self::of(settings.0.build(&robot.0).map_err(IntoPyErr::into_py_err)?)
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

    /// Errors of the parameters by the readings so far, in the measure of their tolerances, and the standard deviations
    /// of these.
    #[getter]
    fn parameters(&self) -> (Vec<f64>, Vec<f64>) {
        self.filter.parameters()
    }

    /// A copy with the same belief.
    fn copy(&self) -> Self {
        self.clone()
    }

    fn reset(&mut self) {
        self.filter.reset();
    }

    /// From now on a first sample finds this mean and covariance of the state; nothing: the robot at rest.
    #[pyo3(signature = (mean, covariance))]
    fn set_start(&mut self, mean: Signal<'_>, covariance: Matrix<'_>) -> PyResult<()> {
        let start = filtering::belief(&mean, &covariance, self.filter.model().own_states())?;
        self.filter.set_start(Some(start)).map_err(IntoPyErr::into_py_err)
    }

    /// Takes one sample: one reading a channel, NaN where missing, and the motor torques, or the commanded jerk.
    fn step(&mut self, dt: f64, readings: Signal<'_>, tau: Signal<'_>) -> PyResult<State> {
        check_step(dt)?;
        let model = self.filter.model();
        let readings = readings.readings("readings", model.channels())?;
        let tau = tau.sized("tau", model.robot().len())?;
        if let Some(joint) = tau.iter().position(|t| !t.is_finite()) {
            let what = if model.is_moved_by_jerk() { "jerk" } else { "tau" };
            return Err(EstimatorError::new_err(format!(
                "{what} of joint {joint} is {}, expected a number",
                tau[joint]
            )));
        }
        let inputs = inputs(model, tau);
        filtering::step(&mut self.filter, KalmanSample { dt, readings, inputs }, &mut self.t, &mut self.row)
    }

    /// Covariance of the state after the last sample.
    #[getter]
    fn covariance<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, numpy::PyArrayDyn<f64>>> {
        filtering::covariance(py, &self.filter)
    }

    /// Goes on from the live state with the rows of a log, or of a piece of one.
    fn run<'py>(&mut self, py: Python<'py>, arrays: Arrays<'py>) -> PyResult<Bound<'py, PyDict>> {
        let recording = recording(self.filter.model(), &arrays)?;
        filtering::run(py, &mut self.filter, recording, Keep::default())
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
}

/// What moves motors.
fn inputs<'a>(model: &ElasticModel, moving: &'a [f64]) -> Inputs<'a> {
    if model.is_moved_by_jerk() {
        Inputs { jerk: moving, ..Inputs::default() }
    } else {
        Inputs { tau: moving, ..Inputs::default() }
    }
}

fn recording<'a>(model: &ElasticModel, (dt, readings, tau): &'a Arrays<'_>) -> PyResult<KalmanRecording<'a>> {
    Ok(KalmanRecording {
        dt: rows("dt", dt, dt.len())?,
        readings: rows("readings", readings, model.channels())?,
        inputs: inputs(model, rows("tau", tau, model.robot().len())?),
    })
}
