//! Python's dicts, lists, strings and numbers as values of Rust.

use crate::error::EstimatorError;
use pyo3::prelude::*;
use pythonize::depythonize;
use serde::de::DeserializeOwned;

/// A value that was given as plain Python.
pub(crate) struct Plain<T>(pub(crate) T);

impl<T: DeserializeOwned> FromPyObject<'_, '_> for Plain<T> {
    type Error = PyErr;

    fn extract(given: Borrowed<'_, '_, PyAny>) -> PyResult<Self> {
        depythonize(&given).map(Self).map_err(|error| EstimatorError::new_err(error.to_string()))
    }
}
