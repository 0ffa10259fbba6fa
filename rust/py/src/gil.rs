//! The one door through which long work leaves Python.

use crate::error::IntoPyErr;
use pyo3::marker::Ungil;
use pyo3::prelude::*;

/// Runs work with the interpreter released, and converts its error.
pub(crate) trait Release {
    fn release<T: Ungil + Send, E: IntoPyErr + Ungil + Send>(
        self,
        work: impl FnOnce() -> Result<T, E> + Ungil + Send,
    ) -> PyResult<T>;
}

impl Release for Python<'_> {
    fn release<T: Ungil + Send, E: IntoPyErr + Ungil + Send>(
        self,
        work: impl FnOnce() -> Result<T, E> + Ungil + Send,
    ) -> PyResult<T> {
        self.detach(work).map_err(IntoPyErr::into_py_err)
    }
}
