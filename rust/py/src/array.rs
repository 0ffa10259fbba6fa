//! NumPy arrays in and out: float64, C order, one row a sample.

use crate::error::EstimatorError;
use numpy::{
    PyArray1, PyArray2, PyArrayDescrMethods, PyArrayDyn, PyArrayMethods, PyReadonlyArray, PyReadonlyArray1,
    PyReadonlyArray2, PyUntypedArray, PyUntypedArrayMethods, ndarray::Dimension,
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
    // A slice may also be had of an array in Fortran's order.
    let slice = array.as_slice().ok().filter(|_| array.is_c_contiguous());
    slice.ok_or_else(|| EstimatorError::new_err(format!("{name} is not C-contiguous")))
}

/// The contents of a C-contiguous array of `count` rows of `width`.
pub(crate) fn counted<'a>(
    name: &str,
    array: &'a PyReadonlyArray2<'_, f64>,
    width: usize,
    count: usize,
) -> PyResult<&'a [f64]> {
    match array.shape()[0] {
        found if found == count => rows(name, array, width),
        found => Err(EstimatorError::new_err(format!("{name} has {found} rows, expected {count}"))),
    }
}

/// Hands `values` to NumPy under `shape`, without a copy.
pub(crate) fn shaped<'py>(
    py: Python<'py>,
    values: Vec<f64>,
    shape: Vec<usize>,
) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
    PyArray1::from_vec(py, values).reshape(shape)
}

/// A signal at one sample, (n,), or at many, (T, n): float64.
pub(crate) enum Rows<'py> {
    One(PyReadonlyArray1<'py, f64>),
    Many(PyReadonlyArray2<'py, f64>),
}

impl<'py> FromPyObject<'_, 'py> for Rows<'py> {
    type Error = PyErr;

    fn extract(given: Borrowed<'_, 'py, PyAny>) -> PyResult<Self> {
        let lent = |e: numpy::BorrowError| EstimatorError::new_err(e.to_string());
        match given.cast::<PyArray1<f64>>() {
            Ok(array) => array.try_readonly().map(Self::One).map_err(lent),
            Err(_) => given.cast::<PyArray2<f64>>()?.try_readonly().map(Self::Many).map_err(lent),
        }
    }
}

impl Rows<'_> {
    /// Number of samples, if there are rows.
    pub(crate) fn count(&self) -> Option<usize> {
        match self {
            Self::One(_) => None,
            Self::Many(array) => Some(array.shape()[0]),
        }
    }

    /// The numbers of `count` samples of `width`.
    pub(crate) fn get(&self, name: &str, count: Option<usize>, width: usize) -> PyResult<&[f64]> {
        match (self, count) {
            (Self::One(array), None) => rows(name, array, width),
            (Self::Many(array), Some(count)) => counted(name, array, width, count),
            _ => Err(EstimatorError::new_err(format!("{name} is not of as many samples as the first signal"))),
        }
    }
}

/// One sample of a signal: a NumPy vector, or any sequence of numbers.
pub(crate) enum Signal<'py> {
    Array(PyReadonlyArray1<'py, f64>),
    Values(Vec<f64>),
    /// Something else; why.
    Unfit(String),
}

impl<'py> FromPyObject<'_, 'py> for Signal<'py> {
    type Error = PyErr;

    /// Vectors of float64 are used where they are, and looked for first.
    fn extract(given: Borrowed<'_, 'py, PyAny>) -> PyResult<Self> {
        if let Ok(array) = given.cast::<PyArray1<f64>>() {
            let array = array.try_readonly().map_err(|e| EstimatorError::new_err(e.to_string()))?;
            let strided = array.as_slice().is_err().then(|| array.as_array().to_vec());
            return Ok(strided.map_or(Self::Array(array), Self::Values));
        }
        let complex = given.cast::<PyUntypedArray>().is_ok_and(|array| array.dtype().kind() == b'c');
        if !complex && let Ok(values) = given.extract() {
            return Ok(Self::Values(values)); // of complex numbers NumPy would give the real parts, with a warning
        }
        let shape = PyModule::import(given.py(), "numpy")?.call_method1("shape", (given,));
        Ok(Self::Unfit(match shape {
            Ok(shape) if shape.len().is_ok_and(|dimensions| dimensions != 1) => format!("has shape {shape}"),
            _ => format!("is {}", given.repr()?),
        }))
    }
}

impl Signal<'_> {
    pub(crate) fn get(&self, name: &str) -> PyResult<&[f64]> {
        match self {
            Self::Array(a) => a.as_slice().map_err(|_| EstimatorError::new_err(format!("{name} is not contiguous"))),
            Self::Values(v) => Ok(v),
            Self::Unfit(why) => Err(EstimatorError::new_err(format!("{name} {why}, expected a vector of numbers"))),
        }
    }

    pub(crate) fn sized(&self, name: &str, expected: usize) -> PyResult<&[f64]> {
        let values = self.get(name)?;
        match values.len() {
            found if found == expected => Ok(values),
            found => Err(EstimatorError::new_err(format!("{name} has {found} entries, expected {expected}"))),
        }
    }

    /// A sample's readings, none of them infinite; NaN is one that is missing.
    pub(crate) fn readings(&self, name: &str, expected: usize) -> PyResult<&[f64]> {
        let values = self.sized(name, expected)?;
        match values.iter().position(|x| x.is_infinite()) {
            Some(i) => {
                let value = values[i];
                let why = "expected a finite number, or NaN where a reading is missing";
                Err(EstimatorError::new_err(format!("{name}[{i}] is {value}, {why}")))
            }
            None => Ok(values),
        }
    }
}
