//! Torques for a wanted motion.

use crate::array::{rows, shaped};
use crate::error::EstimatorError;
use crate::gil::Release;
use crate::robot::Robot;
use linkside_core::control::feedforward::{self as core, Path};
use numpy::{PyReadonlyArray1, PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// The highest derivative of link positions that the motor torque depends on.
#[pyfunction]
pub(crate) fn derivative_order(robot: &Robot) -> usize {
    core::derivative_order(&robot.0)
}

/// Motor positions, velocities and torques (T, n) for links that move by derivatives (p + 1, T, n).
#[pyfunction]
pub(crate) fn feedforward<'py>(
    py: Python<'py>,
    robot: &Robot,
    t: PyReadonlyArray1<'py, f64>,
    derivatives: PyReadonlyArray3<'py, f64>,
) -> PyResult<Bound<'py, PyDict>> {
    let n = robot.0.len();
    let t = t.as_slice().map_err(|_| EstimatorError::new_err("t is not contiguous"))?;
    if derivatives.shape()[1] != t.len() {
        let found = derivatives.shape()[1];
        return Err(EstimatorError::new_err(format!(
            "derivatives have {found} rows, expected {}, those of t",
            t.len()
        )));
    }
    let path = Path { t, derivatives: rows("derivatives", &derivatives, n)? };
    let desired = py.release(|| core::inverse_dynamics(&robot.0, path))?;
    let out = PyDict::new(py);
    for (name, values) in [("theta", desired.theta), ("dtheta", desired.dtheta), ("tau", desired.tau)] {
        out.set_item(name, shaped(py, values, vec![t.len(), n])?)?;
    }
    Ok(out)
}
