//! Kalman filter and smoother on the elastic-joint model, motors moved by torques or by jerk.

use crate::array::{Signal, rows};
use crate::error::{EstimatorError, IntoPyErr};
use crate::filtering::{self, Matrix};
use crate::live::{check_step, fill, given};
use crate::plain::Plain;
use crate::robot::Robot;
use crate::state::State;
use linkside_compiled::description;
use linkside_core::estimate::kalman::{
    ElasticModel, ExtendedKalmanFilter, FilterOutput, Inputs, KalmanRecording, KalmanSample, Keep, Model,
};
use linkside_core::estimate::measurement::Channel;
use numpy::{PyReadonlyArray1, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// Kalman filter on the elastic-joint model of one robot.
#[pyclass(module = "linkside._core")]
#[derive(Clone)]
pub(crate) struct ElasticJointFilter {
    pub(crate) filter: ExtendedKalmanFilter<ElasticModel>,
    /// Readings of accelerometers and of motor velocities; those of motor positions come before them.
    widths: [usize; 2],
    /// A sample put together from its signals.
    readings: Vec<f64>,
    /// Time since the first sample of `step` [s], and the estimate at the last one.
    t: f64,
    row: FilterOutput,
}

type Arrays<'py> = (PyReadonlyArray1<'py, f64>, Matrix<'py>, Matrix<'py>);

impl ElasticJointFilter {
    fn of(filter: ExtendedKalmanFilter<ElasticModel>) -> PyResult<Self> {
        let row = FilterOutput::zeros(1, filter.model(), Keep::default()).map_err(IntoPyErr::into_py_err)?;
        let kinds = filter.model().channel_kinds();
        let count = |is: fn(&Channel) -> bool| kinds.iter().filter(|channel| is(channel)).count();
        let widths = [
            count(|channel| matches!(channel, Channel::Acceleration { .. })),
            count(|channel| matches!(channel, Channel::MotorVelocity(_))),
        ];
        Ok(Self { readings: vec![f64::NAN; kinds.len()], widths, filter, t: 0.0, row })
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

    /// Takes one sample, of motors moved by jerk with that in place of torques; what is not given is missing, and what the
    /// filter does not measure is not looked at.
    #[pyo3(signature = (dt, theta, tau, dtheta=None, acceleration=None, further=None))]
    fn step(
        &mut self,
        dt: f64,
        theta: Signal<'_>,
        tau: Signal<'_>,
        dtheta: Option<Signal<'_>>,
        acceleration: Option<Signal<'_>>,
        further: Option<Signal<'_>>,
    ) -> PyResult<State> {
        check_step(dt)?;
        let Self { filter, widths: [sensed, turned], readings, t, row } = self;
        let (n, m) = (filter.model().robot().len(), readings.len());
        let theta = theta.readings("theta", n)?;
        let acceleration = given(acceleration.as_ref().filter(|_| *sensed > 0), "acceleration", *sensed)?;
        let dtheta = given(dtheta.as_ref().filter(|_| *turned > 0), "dtheta", n)?;
        let further = given(further.as_ref(), "further", m - n - *sensed - *turned)?;
        let tau = tau.sized("tau", n)?;
        if let Some(joint) = tau.iter().position(|t| !t.is_finite()) {
            let what = if filter.model().is_moved_by_jerk() { "jerk" } else { "tau" };
            return Err(EstimatorError::new_err(format!(
                "{what} of joint {joint} is {}, expected a number",
                tau[joint]
            )));
        }
        let (motors, rest) = readings.split_at_mut(n);
        let (accelerations, rest) = rest.split_at_mut(*sensed);
        let (velocities, others) = rest.split_at_mut(*turned);
        motors.copy_from_slice(theta);
        fill(accelerations, acceleration);
        fill(velocities, dtheta);
        fill(others, further);
        let inputs = inputs(filter.model(), tau);
        filtering::step(filter, KalmanSample { dt, readings, inputs }, t, row)
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
