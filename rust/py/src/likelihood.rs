//! The likelihood of a recording, and what its sensors would read.

use crate::array::{rows, shaped};
use crate::error::{EstimatorError, IntoPyErr};
use crate::gil::Release;
use crate::plain::Plain;
use crate::robot::Robot;
use linkside_compiled::description;
use linkside_core::estimate::likelihood::{self, LikelihoodRecording, LikelihoodSettings, MotorMotion, Parameter};
use linkside_core::estimate::measurement::Kind;
use numpy::{PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;

type Matrix<'py> = PyReadonlyArray2<'py, f64>;
/// A kind of parameter, and up to two indices: joint or sensor, then axis or joint.
type Name = (String, usize, usize);

/// A recording's signals by name.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
struct LikelihoodSignals<'py> {
    t: PyReadonlyArray1<'py, f64>,
    theta: Matrix<'py>,
    dtheta: Matrix<'py>,
    acceleration: Matrix<'py>,
    jerk: Matrix<'py>,
    period: f64,
}

impl LikelihoodSignals<'_> {
    fn recording(&self, joints: usize, channels: usize) -> PyResult<LikelihoodRecording> {
        Ok(LikelihoodRecording {
            t: rows("t", &self.t, self.t.len())?.to_vec(),
            theta: rows("theta", &self.theta, joints)?.to_vec(),
            dtheta: rows("dtheta", &self.dtheta, joints)?.to_vec(),
            acceleration: rows("acceleration", &self.acceleration, channels)?.to_vec(),
            jerk: rows("jerk", &self.jerk, joints)?.to_vec(),
            period: self.period,
        })
    }
}

fn parameter((kind, i, k): &Name) -> PyResult<Parameter> {
    use Parameter as P;
    let (i, k) = (*i, *k);
    Ok(match kind.as_str() {
        "stiffness" => P::Stiffness(i),
        "cubic_stiffness" => P::CubicStiffness(i),
        "damping" => P::Damping(i),
        "motor_inertia" => P::MotorInertia(i),
        "viscous" => P::ViscousFriction(i),
        "coulomb" => P::CoulombFriction(i),
        "hysteresis_stiffness" => P::ElementStiffness(i, k),
        "hysteresis_limit" => P::ElementLimit(i, k),
        "torque_constant" => P::TorqueScale(i),
        "half_gap" => P::HalfGap(i),
        "link_coulomb" => P::LinkCoulomb(i),
        "link_friction" => P::LinkFriction(i),
        "coupling" => P::Coupling(i, k),
        "mass_scale" => P::MassScale(i),
        "payload_mass" => P::PayloadMass,
        "payload_xyz" => P::PayloadCentre(k),
        "translation" => P::SensorTranslation(i, k),
        "rotation" => P::SensorRotation(i, k),
        "bias" => P::SensorBias(i, k),
        "scale" => P::SensorScale(i, k),
        "time_constant" => P::TimeConstant(i),
        "delay" => P::Delay(i),
        "sensor_noise" => P::SensorNoise(i),
        _ => return Err(EstimatorError::new_err(format!("{kind:?} is no kind of parameter"))),
    })
}

fn parameters(names: &[Name]) -> PyResult<Vec<Parameter>> {
    names.iter().map(parameter).collect()
}

/// Likelihood of one recording.
#[pyclass(frozen, module = "linkside._core")]
pub(crate) struct Likelihood(likelihood::Likelihood);

#[pymethods]
impl Likelihood {
    #[new]
    #[pyo3(signature = (robot, signals, *, noise, biased, fixed, huber))]
    fn new(
        robot: &Robot,
        signals: LikelihoodSignals<'_>,
        noise: Plain<description::JerkNoise>,
        biased: Vec<bool>,
        fixed: Vec<(Name, f64)>,
        huber: f64,
    ) -> PyResult<Self> {
        let recording = signals.recording(robot.0.len(), robot.0.acceleration_channels())?;
        let fixed: PyResult<Vec<_>> = fixed.iter().map(|(name, value)| Ok((parameter(name)?, *value))).collect();
        let settings = LikelihoodSettings { noise: noise.0.into(), biased, fixed: fixed?, huber };
        likelihood::Likelihood::new(robot.0.clone(), settings, recording).map(Self).map_err(IntoPyErr::into_py_err)
    }

    fn log_likelihood(&self, py: Python<'_>, names: Vec<Name>, values: Vec<f64>) -> PyResult<f64> {
        let parameters = parameters(&names)?;
        py.release(|| self.0.log_likelihood(&parameters, &values))
    }
}

/// What sensors would read if nothing but the motors moved the links.
#[pyclass(frozen, module = "linkside._core")]
pub(crate) struct Response {
    response: likelihood::Response,
    joints: usize,
}

#[pymethods]
impl Response {
    #[new]
    #[pyo3(signature = (robot, motion, *, kinds, fixed))]
    fn new(robot: &Robot, motion: Motion<'_>, kinds: Vec<String>, fixed: Vec<(Name, f64)>) -> PyResult<Self> {
        let joints = robot.0.len();
        let motion = MotorMotion {
            t: rows("t", &motion.t, motion.t.len())?.to_vec(),
            theta: rows("theta", &motion.theta, joints)?.to_vec(),
            dtheta: rows("dtheta", &motion.dtheta, joints)?.to_vec(),
            ddtheta: rows("ddtheta", &motion.ddtheta, joints)?.to_vec(),
        };
        let kind = |name: &String| {
            Kind::named(name).ok_or_else(|| EstimatorError::new_err(format!("{name:?} is no kind of channel")))
        };
        let kinds: PyResult<Vec<_>> = kinds.iter().map(kind).collect();
        let fixed: PyResult<Vec<_>> = fixed.iter().map(|(name, value)| Ok((parameter(name)?, *value))).collect();
        let response = likelihood::Response::new(robot.0.clone(), &kinds?, fixed?, motion);
        Ok(Self { response: response.map_err(IntoPyErr::into_py_err)?, joints })
    }

    fn evaluate<'py>(
        &self,
        py: Python<'py>,
        names: Vec<Name>,
        values: Vec<f64>,
        offset: Vec<f64>,
    ) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyAny>)> {
        let parameters = parameters(&names)?;
        let out = py.release(|| self.response.evaluate(&parameters, &values, &offset))?;
        let (count, channels) = (self.response.len(), self.response.channels());
        let width = parameters.len() + 2 * self.joints;
        let prediction = shaped(py, out.prediction, vec![count, channels])?;
        let slopes = shaped(py, out.slopes, vec![count, channels, width])?;
        Ok((prediction.into_any(), slopes.into_any()))
    }
}

/// How motors moved, by name.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
struct Motion<'py> {
    t: PyReadonlyArray1<'py, f64>,
    theta: Matrix<'py>,
    dtheta: Matrix<'py>,
    ddtheta: Matrix<'py>,
}
