//! Numbers of a robot that are known to a tolerance only.

use crate::error::IntoPyErr;
use linkside_core::estimate::kalman::{Tolerance, Tolerances, Uncertain};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// A parameter's kind, its joint or sensor, its axis, and its standard deviation.
pub(crate) type ToleranceTuple = (String, usize, usize, f64);

/// Two of these, and the correlation of their errors.
pub(crate) type CorrelationTuple = (usize, usize, f64);

pub(crate) fn of_core(given: &[ToleranceTuple], correlations: Vec<CorrelationTuple>) -> PyResult<Tolerances> {
    let each: PyResult<_> = given
        .iter()
        .map(|(kind, i, axis, std)| Ok(Tolerance { parameter: uncertain(kind, *i, *axis)?, std: *std }))
        .collect();
    Tolerances::correlated(each?, correlations).map_err(IntoPyErr::into_py_err)
}

fn uncertain(kind: &str, i: usize, axis: usize) -> PyResult<Uncertain> {
    use Uncertain as U;
    Ok(match kind {
        "stiffness" => U::Stiffness(i),
        "cubic_stiffness" => U::CubicStiffness(i),
        "damping" => U::Damping(i),
        "yielding" => U::Yielding(i),
        "hysteresis" => U::Hysteresis(i),
        "mass" => U::Mass(i),
        "link_friction" => U::LinkFriction(i),
        "torque_constant" => U::TorqueConstant(i),
        "motor_friction" => U::MotorFriction(i),
        "motor_inertia" => U::MotorInertia(i),
        "encoder_zero" => U::EncoderZero(i),
        "encoder_line" => U::EncoderLine(i, axis),
        "lost_motion" => U::LostMotion(i),
        "rotation" => U::Rotation(i, axis),
        "translation" => U::Translation(i, axis),
        "scale" => U::Scale(i, axis),
        _ => return Err(PyValueError::new_err(format!("no parameter {kind:?}"))),
    })
}
