//! Core errors as the package's own exceptions.

use linkside_core::error::RobotError;
use pyo3::PyErr;

pyo3::import_exception!(linkside.errors, ConfigError);
pyo3::import_exception!(linkside.errors, EstimatorError);

/// What an error of the core is called in Python.
pub(crate) trait IntoPyErr {
    fn into_py_err(self) -> PyErr;
}

impl IntoPyErr for RobotError {
    fn into_py_err(self) -> PyErr {
        ConfigError::new_err(self.to_string())
    }
}
