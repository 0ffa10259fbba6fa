//! NumPy arrays in and out: float64, C order, one row a sample.

use crate::error::EstimatorError;
use linkside_core::spatial::{Mat3, Vec3};
use numpy::{
    PyArray1, PyArrayDyn, PyArrayMethods, PyReadonlyArray, PyReadonlyArray1, PyUntypedArrayMethods, ndarray::Dimension,
};
use pyo3::prelude::*;

/// The contents of a C-contiguous array whose last dimension is `width`.
pub(crate) fn rows<'a, D: Dimension>(
    name: &str,
    array: &'a PyReadonlyArray<'_, f64, D>,
    width: usize,
) -> PyResult<&'a [f64]> {
    let found = array.shape().last().copied().unwrap_or(0);
    if found != width {
        return Err(EstimatorError::new_err(format!("{name} has {found} columns, expected {width}")));
    }
    array.as_slice().map_err(|_| EstimatorError::new_err(format!("{name} is not C-contiguous")))
}

/// Hands `values` to NumPy under `shape`, without a copy.
pub(crate) fn shaped<'py>(
    py: Python<'py>,
    values: Vec<f64>,
    shape: Vec<usize>,
) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
    PyArray1::from_vec(py, values).reshape(shape)
}

pub(crate) fn vec3(v: [f64; 3]) -> Vec3<f64> {
    Vec3(v)
}

pub(crate) fn mat3(rows: [[f64; 3]; 3]) -> Mat3<f64> {
    Mat3::from_rows(rows)
}

/// One sample of a signal: a NumPy vector, or any sequence of numbers.
#[derive(FromPyObject)]
pub(crate) enum Signal<'py> {
    Array(PyReadonlyArray1<'py, f64>),
    Sequence(Vec<f64>),
}

impl Signal<'_> {
    pub(crate) fn get(&self, name: &str) -> PyResult<&[f64]> {
        match self {
            Self::Array(a) => a.as_slice().map_err(|_| EstimatorError::new_err(format!("{name} is not contiguous"))),
            Self::Sequence(v) => Ok(v),
        }
    }

    pub(crate) fn sized(&self, name: &str, expected: usize) -> PyResult<&[f64]> {
        let values = self.get(name)?;
        match values.len() {
            found if found == expected => Ok(values),
            found => Err(EstimatorError::new_err(format!("{name} has {found} entries, expected {expected}"))),
        }
    }
}

/// Runs `work`, which gives the values of `out`, once `out` has been found to hold `expected` numbers that may be written.
pub(crate) fn write_into<R>(
    out: &Bound<'_, PyArray1<f64>>,
    expected: usize,
    work: impl FnOnce(&mut [f64]) -> PyResult<R>,
) -> PyResult<R> {
    let mut out = out.try_readwrite().map_err(|e| EstimatorError::new_err(format!("out: {e}")))?;
    let out = out.as_slice_mut().map_err(|_| EstimatorError::new_err("out is not contiguous"))?;
    if out.len() != expected {
        return Err(EstimatorError::new_err(format!("out has {} entries, expected {expected}", out.len())));
    }
    work(out)
}
