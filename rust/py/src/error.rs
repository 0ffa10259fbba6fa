//! Core errors as the package's own exceptions.

use linkside_bag::BagError;
use linkside_compiled::description::BuildError;
use linkside_core::error::{DesignError, RobotError, RunError, SimulationError};
use pyo3::exceptions::{PyKeyboardInterrupt, PyMemoryError};
use pyo3::prelude::*;
use pyo3::types::PyDict;

pyo3::import_exception!(linkside.errors, ConfigError);
pyo3::import_exception!(linkside.errors, EstimatorError);
pyo3::import_exception!(linkside.errors, LogError);
pyo3::import_exception!(linkside.errors, NumericalError);

/// What an error of the core is called in Python.
pub(crate) trait IntoPyErr {
    fn into_py_err(self) -> PyErr;
}

impl IntoPyErr for RobotError {
    fn into_py_err(self) -> PyErr {
        ConfigError::new_err(self.to_string())
    }
}

impl IntoPyErr for BagError {
    fn into_py_err(self) -> PyErr {
        LogError::new_err(self.to_string())
    }
}

impl IntoPyErr for DesignError {
    fn into_py_err(self) -> PyErr {
        match self {
            Self::Memory { .. } => PyMemoryError::new_err(self.to_string()),
            _ => EstimatorError::new_err(self.to_string()),
        }
    }
}

impl IntoPyErr for BuildError {
    fn into_py_err(self) -> PyErr {
        match self {
            Self::Robot(robot) => robot.into_py_err(),
            Self::Design(design) => design.into_py_err(),
            other => EstimatorError::new_err(other.to_string()),
        }
    }
}

impl IntoPyErr for RunError {
    fn into_py_err(self) -> PyErr {
        match self {
            Self::Design(design) => design.into_py_err(),
            Self::Interrupted { .. } => PyKeyboardInterrupt::new_err(self.to_string()),
            Self::NotFinite { .. } | Self::Impossible { .. } | Self::Lost { .. } | Self::SingularInertia { .. } => {
                NumericalError::new_err(self.to_string())
            }
        }
    }
}

impl IntoPyErr for SimulationError {
    fn into_py_err(self) -> PyErr {
        match self {
            Self::Design(design) => design.into_py_err(),
            Self::Interrupted { .. } => PyKeyboardInterrupt::new_err(self.to_string()),
            Self::Singular => ConfigError::new_err(self.to_string()),
            Self::NotFinite { .. } | Self::Abrupt { .. } => NumericalError::new_err(self.to_string()),
            Self::Step { .. } | Self::Torque { .. } | Self::Refused { .. } => EstimatorError::new_err(self.to_string()),
        }
    }
}

/// What became of one log of several: its result, or the exception as a value, for the caller to name the log and raise.
pub(crate) fn outcome<'py, T>(
    py: Python<'py>,
    result: Result<T, impl IntoPyErr>,
    convert: impl FnOnce(T) -> PyResult<Bound<'py, PyDict>>,
) -> PyResult<Bound<'py, PyAny>> {
    match result {
        Ok(value) => convert(value).map(Bound::into_any),
        Err(error) => Ok(error.into_py_err().into_value(py).into_bound(py).into_any()),
    }
}
