//! Simulation with a controller in the loop.

use crate::array::{Signal, shaped};
use crate::elastic_filter::ElasticJointFilter;
use crate::error::{EstimatorError, IntoPyErr};
use crate::gil::Release;
use crate::observer::AccelerationObserver;
use crate::robot::Robot;
use linkside_core::control::{
    AdaptiveGains, Controller, JointPd, Reference, Refused, RobotState, SimpleAdaptive, StateFeedback,
};
use linkside_core::error::{DesignError, SimulationError};
use linkside_core::estimate::measurement::Kind;
use linkside_core::simulate::{
    self as core, Feedback, FilterFeedback, ObserverFeedback, Outside, Plan, SensorFeedback, SensorModel,
    SimulatedRecording, SimulationStart, StepTolerance, Stepping, Suite, TrueState,
};
use numpy::PyArray1;
use pyo3::exceptions::PyException;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::sync::Arc;

/// How long, how finely, from where.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct SimulationFields {
    period: f64,
    count: usize,
    substeps: usize,
    /// rtol and atol of adaptive steps; fixed ones without.
    tolerance: Option<(f64, f64)>,
    keep_every: usize,
    seed: u64,
    q: Option<Vec<f64>>,
    dq: Option<Vec<f64>>,
    theta: Option<Vec<f64>>,
    dtheta: Option<Vec<f64>>,
    tau: Option<Vec<f64>>,
    /// Torques from outside on the links.
    push: Option<Knots>,
    /// Varying wrenches.
    wrench: Option<Knots>,
}

#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct Channel {
    noise: f64,
    bias: f64,
    resolution: f64,
    delay: f64,
    corner_frequency: f64,
    every: usize,
}

/// Knots in time, row-major.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct Knots {
    times: Vec<f64>,
    values: Vec<f64>,
    width: usize,
}

/// A controller of the core by its settings, or a function.
#[derive(FromPyObject)]
pub(crate) enum Law<'py> {
    #[pyo3(from_item_all)]
    StateFeedback { states: Knots, gains: Vec<f64> },
    #[pyo3(from_item_all)]
    JointPd { reference: Knots, kp: Vec<f64>, kd: Vec<f64>, tau: Vec<f64> },
    #[pyo3(from_item_all)]
    SimpleAdaptive {
        command: Knots,
        coordinates: Vec<usize>,
        position: [f64; 2],
        velocity: [f64; 2],
        leakage: [f64; 2],
        joint_damping: f64,
        bandwidth: f64,
        damping_ratio: f64,
    },
    #[pyo3(transparent)]
    Callable(Bound<'py, PyAny>),
}

/// What the controller knows: the truth or what sensors read, or the estimate of a filter from some readings, or of an observer.
#[derive(FromPyObject)]
pub(crate) enum FeedbackSource<'py> {
    #[pyo3(transparent)]
    Truth(bool),
    Filter(PyRef<'py, ElasticJointFilter>, Vec<usize>),
    #[pyo3(transparent)]
    Observer(PyRef<'py, AccelerationObserver>),
}

/// A function of Python in the loop.
struct Callable {
    function: Py<PyAny>,
    error: Option<PyErr>,
}

impl Controller for Callable {
    fn torque(&mut self, t: f64, state: &RobotState, out: &mut [f64]) -> Result<(), Refused> {
        Python::attach(|py| self.call(py, t, state, out)).map_err(|error| {
            self.error = Some(error);
            Refused
        })
    }
}

impl Callable {
    fn call(&self, py: Python<'_>, t: f64, state: &RobotState, out: &mut [f64]) -> PyResult<()> {
        let [q, dq, theta, dtheta] =
            [&state.q, &state.dq, &state.theta, &state.dtheta].map(|values| PyArray1::from_slice(py, values));
        let torque = self.function.call1(py, (t, q, dq, theta, dtheta))?;
        let torque: Signal<'_> = torque.extract(py)?;
        out.copy_from_slice(torque.sized("the controller's torque", out.len())?);
        Ok(())
    }

    /// What went wrong, the function's own exception as the cause.
    fn explain(self, py: Python<'_>, error: SimulationError) -> PyErr {
        match (error, self.error) {
            (SimulationError::Refused { time }, Some(cause)) if cause.is_instance_of::<PyException>(py) => {
                let error = EstimatorError::new_err(format!("the controller failed at t = {time:.9} s: {cause}"));
                error.set_cause(py, Some(cause));
                error
            }
            (_, Some(cause)) => cause,
            (error, None) => error.into_py_err(),
        }
    }
}

/// Runs `robot` under a controller: log and truth as arrays.
#[pyfunction]
pub(crate) fn simulate<'py>(
    py: Python<'py>,
    robot: &Robot,
    settings: SimulationFields,
    sensors: Vec<Channel>,
    source: FeedbackSource<'_>,
    law: Law<'_>,
) -> PyResult<Bound<'py, PyDict>> {
    let job = Job::new(robot, settings, sensors).map_err(IntoPyErr::into_py_err)?;
    let recording = match source {
        FeedbackSource::Truth(true) => job.with(py, TrueState, law),
        FeedbackSource::Truth(false) => {
            let velocities = Kind::all_channels(&[Kind::Motor, Kind::Acceleration], &robot.0).len();
            job.with(py, SensorFeedback { velocities }, law)
        }
        FeedbackSource::Filter(filter, channels) => {
            let feedback = FilterFeedback::new(filter.filter.clone(), channels).map_err(IntoPyErr::into_py_err)?;
            job.with(py, feedback, law)
        }
        FeedbackSource::Observer(observer) => {
            let feedback = ObserverFeedback::new(observer.fresh.clone(), &job.robot);
            job.with(py, feedback.map_err(IntoPyErr::into_py_err)?, law)
        }
    }?;
    into_dict(py, recording, &robot.0)
}

/// Everything but the loop.
struct Job {
    robot: Arc<linkside_core::robot::Robot>,
    plan: Plan,
    start: SimulationStart,
    outside: Outside,
    suite: Suite,
}

impl Job {
    fn new(robot: &Robot, s: SimulationFields, sensors: Vec<Channel>) -> Result<Self, DesignError> {
        let models: Vec<SensorModel> = sensors.into_iter().map(Into::into).collect();
        let stepping = s
            .tolerance
            .map_or(Stepping::Fixed(s.substeps), |(rtol, atol)| Stepping::Adaptive(StepTolerance { rtol, atol }));
        Ok(Self {
            robot: Arc::clone(&robot.0),
            suite: Suite::new(&robot.0, &models, s.period, s.seed)?,
            plan: Plan { period: s.period, count: s.count, stepping, keep_every: s.keep_every },
            outside: Outside {
                push: s.push.map(Knots::build).transpose()?,
                wrench: s.wrench.map(Knots::build).transpose()?,
            },
            start: SimulationStart { q: s.q, dq: s.dq, theta: s.theta, dtheta: s.dtheta, tau: s.tau },
        })
    }

    fn with(self, py: Python<'_>, feedback: impl Feedback + Send, law: Law<'_>) -> PyResult<SimulatedRecording> {
        match law {
            Law::StateFeedback { states, gains } => {
                let controller = states.build().and_then(|reference| StateFeedback::new(reference, gains));
                self.run(py, feedback, &mut controller.map_err(IntoPyErr::into_py_err)?)?
                    .map_err(IntoPyErr::into_py_err)
            }
            Law::JointPd { reference, kp, kd, tau } => {
                let controller = reference.build().and_then(|r| JointPd::new(r, kp, kd, tau));
                self.run(py, feedback, &mut controller.map_err(IntoPyErr::into_py_err)?)?
                    .map_err(IntoPyErr::into_py_err)
            }
            Law::SimpleAdaptive {
                command,
                coordinates,
                position,
                velocity,
                leakage,
                joint_damping,
                bandwidth,
                damping_ratio,
            } => {
                let gains = AdaptiveGains { position, velocity, leakage, joint_damping, bandwidth, damping_ratio };
                let (robot, period) = (Arc::clone(&self.robot), self.plan.period);
                let controller =
                    command.build().and_then(|r| SimpleAdaptive::new(robot, r, coordinates, gains, period));
                self.run(py, feedback, &mut controller.map_err(IntoPyErr::into_py_err)?)?
                    .map_err(IntoPyErr::into_py_err)
            }
            Law::Callable(function) => {
                let mut controller = Callable { function: function.unbind(), error: None };
                self.run(py, feedback, &mut controller)?.map_err(|error| controller.explain(py, error))
            }
        }
    }

    fn run(
        self,
        py: Python<'_>,
        mut feedback: impl Feedback + Send,
        controller: &mut (dyn Controller + Send),
    ) -> PyResult<Result<SimulatedRecording, SimulationError>> {
        let Self { robot, plan, start, outside, suite } = self;
        py.release(|| {
            Ok::<_, DesignError>(core::simulate(&robot, start, plan, outside, suite, &mut feedback, controller))
        })
    }
}

impl From<Channel> for SensorModel {
    fn from(c: Channel) -> Self {
        let Channel { noise, bias, resolution, delay, corner_frequency, every } = c;
        Self { noise, bias, resolution, delay, corner_frequency, every }
    }
}

impl Knots {
    fn build(self) -> Result<Reference, DesignError> {
        Reference::new(self.times, self.values, self.width)
    }
}

fn into_dict<'py>(
    py: Python<'py>,
    recording: SimulatedRecording,
    robot: &linkside_core::robot::Robot,
) -> PyResult<Bound<'py, PyDict>> {
    let (n, count) = (robot.len(), recording.t.len());
    let channels = Kind::all_channels(Kind::SENSORS, robot).len();
    let out = PyDict::new(py);
    out.set_item("t", PyArray1::from_vec(py, recording.t))?;
    if robot.tool.is_some() {
        out.set_item("tool", shaped(py, recording.tool, vec![count, 3])?)?;
    }
    if !recording.push.is_empty() {
        out.set_item("push", shaped(py, recording.push, vec![count, n])?)?;
    }
    if !recording.wrench.is_empty() {
        out.set_item("wrench", shaped(py, recording.wrench, vec![count, robot.wrench_states()])?)?;
    }
    for (name, values, width) in [
        ("readings", recording.readings, channels),
        ("known", recording.known, 4 * n),
        ("tau", recording.tau, n),
        ("q", recording.q, n),
        ("dq", recording.dq, n),
        ("ddq", recording.ddq, n),
        ("theta", recording.theta, n),
        ("dtheta", recording.dtheta, n),
    ] {
        out.set_item(name, shaped(py, values, vec![count, width])?)?;
    }
    Ok(out)
}
