//! The one door through which long work leaves Python.

use crate::error::IntoPyErr;
use linkside_core::interrupt;
use pyo3::marker::Ungil;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::cell::RefCell;
use std::rc::Rc;

/// Runs work with the interpreter released, and converts its error.
pub(crate) trait Release {
    /// Work that may take long: Ctrl-C, and an exception set from another thread (`PyThreadState_SetAsyncExc`), end it early.
    /// What it was writing into is then not to be used.
    fn release<T: Ungil + Send, E: IntoPyErr + Ungil + Send>(
        self,
        work: impl FnOnce() -> Result<T, E> + Ungil + Send,
    ) -> PyResult<T>;

    /// Work that is done to its end, as it changes what is used afterwards.
    fn release_briefly<T: Ungil + Send, E: IntoPyErr + Ungil + Send>(
        self,
        work: impl FnOnce() -> Result<T, E> + Ungil + Send,
    ) -> PyResult<T>;
}

impl Release for Python<'_> {
    fn release<T: Ungil + Send, E: IntoPyErr + Ungil + Send>(
        self,
        work: impl FnOnce() -> Result<T, E> + Ungil + Send,
    ) -> PyResult<T> {
        let (outcome, raised) = self.detach(|| {
            let raised = Rc::new(RefCell::new(None));
            let seen = Rc::clone(&raised);
            let ask = move || match Python::attach(pending) {
                Ok(()) => false,
                Err(error) => {
                    seen.replace(Some(error));
                    true
                }
            };
            let outcome = interrupt::watched(ask, work);
            (outcome, raised.take())
        });
        match raised {
            Some(error) => Err(error),
            None => outcome.map_err(IntoPyErr::into_py_err),
        }
    }

    fn release_briefly<T: Ungil + Send, E: IntoPyErr + Ungil + Send>(
        self,
        work: impl FnOnce() -> Result<T, E> + Ungil + Send,
    ) -> PyResult<T> {
        self.detach(work).map_err(IntoPyErr::into_py_err)
    }
}

/// Lets Python handle its signals, and raise what another thread has set; the latter it only does where it runs code.
fn pending(py: Python<'_>) -> PyResult<()> {
    py.check_signals()?;
    py.eval(c"None", Some(&PyDict::new(py)), None).map(drop)
}
