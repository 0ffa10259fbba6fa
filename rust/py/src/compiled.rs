//! Estimators for controllers.

use crate::error::IntoPyErr;
use crate::plain::Plain;
use linkside_compiled::{Description, Estimator, Signal};
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use std::collections::BTreeMap;

/// The bytes of a file, of a description that has been built to see that it can be, and the width of each signal that it reads.
#[pyfunction]
pub(crate) fn compiled(py: Python<'_>, description: Plain<Description>) -> PyResult<(Bound<'_, PyBytes>, Widths)> {
    let estimator = Estimator::new(description.0).map_err(IntoPyErr::into_py_err)?;
    let widths = Signal::ALL.into_iter().map(|signal| (signal.name(), estimator.width(signal)));
    let bytes = PyBytes::new(py, &estimator.description().to_bytes());
    Ok((bytes, widths.filter(|(_, width)| *width > 0).collect()))
}

type Widths = BTreeMap<&'static str, usize>;
