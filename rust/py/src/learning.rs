//! Iterative learning control.

use crate::array::{counted, shaped};
use crate::error::{EstimatorError, IntoPyErr};
use crate::gil::Release;
use linkside_core::control as core;
use linkside_core::error::RunError;
use numpy::{PyArrayDyn, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3};
use pyo3::prelude::*;

/// How links answer inputs: x₊ = A x + B v and y = C x from x = 0.
#[pyclass(module = "linkside._core", frozen)]
pub(crate) struct LearningLoop {
    model: core::LearningLoop,
    /// Samples, and numbers in each.
    shape: (usize, usize),
}

#[pymethods]
impl LearningLoop {
    #[new]
    fn new(
        transition: PyReadonlyArray3<'_, f64>,
        posture: Vec<usize>,
        entry: PyReadonlyArray2<'_, f64>,
        output: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<Self> {
        let shape = (posture.len(), output.as_array().nrows());
        let [entry, output] = [entry, output].map(|array| array.as_array().iter().copied().collect());
        let transition = transition.as_array().iter().copied().collect();
        let model = core::LearningLoop::new(transition, posture, entry, output, shape.1);
        Ok(Self { model: model.map_err(|error| RunError::from(error).into_py_err())?, shape })
    }

    fn answer<'py>(&self, py: Python<'py>, v: PyReadonlyArray2<'py, f64>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        let v = self.rows("v", &v)?;
        let y = py.release(|| self.model.answer(v))?;
        self.array(py, y)
    }

    fn adjoint<'py>(&self, py: Python<'py>, e: PyReadonlyArray2<'py, f64>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        let e = self.rows("e", &e)?;
        let v = py.release(|| self.model.adjoint(e))?;
        self.array(py, v)
    }
}

impl LearningLoop {
    fn rows<'a>(&self, name: &str, array: &'a PyReadonlyArray2<'_, f64>) -> PyResult<&'a [f64]> {
        counted(name, array, self.shape.1, self.shape.0)
    }

    fn array<'py>(&self, py: Python<'py>, values: Vec<f64>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        shaped(py, values, vec![self.shape.0, self.shape.1])
    }
}

/// The norm-optimal step for weights of errors, inputs and their change.
#[pyclass(module = "linkside._core", frozen)]
pub(crate) struct LearningStep {
    step: core::LearningStep,
    model: Py<LearningLoop>,
}

#[pymethods]
impl LearningStep {
    #[new]
    fn new(
        py: Python<'_>,
        model: Py<LearningLoop>,
        weight: PyReadonlyArray2<'_, f64>,
        roughness: Vec<f64>,
        change: Vec<f64>,
    ) -> PyResult<Self> {
        let own = model.get();
        let weight = own.rows("weight", &weight)?.to_vec();
        let step = py.release(|| core::LearningStep::new(own.model.clone(), weight, roughness, change))?;
        Ok(Self { step, model })
    }

    fn solve<'py>(
        &self,
        py: Python<'py>,
        e: PyReadonlyArray2<'py, f64>,
        mean: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        let own = self.model.get();
        let (e, mean) = (own.rows("e", &e)?, own.rows("mean", &mean)?);
        let found = py.release(|| self.step.solve(e, mean))?;
        own.array(py, found)
    }

    fn contraction(&self, py: Python<'_>, real: &LearningLoop, start: PyReadonlyArray1<'_, f64>) -> PyResult<f64> {
        let start = start.as_slice().map_err(|_| EstimatorError::new_err("start is not contiguous"))?;
        py.release(|| self.step.contraction(&real.model, start))
    }
}
