//! A compiled robot and its dynamics, at one state or over arrays.

use crate::array::{Rows, shaped};
use crate::error::{EstimatorError, IntoPyErr};
use crate::gil::Release;
use crate::plain::Plain;
use linkside_compiled::description;
use linkside_core::dynamics::{Batch, DrivenStates, States};
use linkside_core::error::DesignError;
use linkside_core::memory;
use linkside_core::robot;
use numpy::{PyArrayDyn, PyArrayMethods};
use pyo3::prelude::*;
use std::sync::{Arc, Mutex};

/// A robot flattened for the kernels, and scratch for single samples.
#[pyclass(frozen, module = "linkside._core")]
pub(crate) struct Robot(pub(crate) Arc<robot::Robot>, Mutex<Batch>);

type Output<'py> = PyResult<Bound<'py, PyArrayDyn<f64>>>;

#[pymethods]
impl Robot {
    #[new]
    fn new(description: Plain<description::Robot>) -> PyResult<Self> {
        let robot = description.0.build().map(Arc::new).map_err(IntoPyErr::into_py_err)?;
        Ok(Self(Arc::clone(&robot), Mutex::new(Batch::new(robot))))
    }

    /// Number of joints.
    #[getter]
    fn n(&self) -> usize {
        self.0.len()
    }

    fn inverse_dynamics<'py>(&self, py: Python<'py>, q: Rows<'py>, dq: Rows<'py>, ddq: Rows<'py>) -> Output<'py> {
        self.ask(py, [("q", q), ("dq", dq), ("ddq", ddq)], [self.0.len()], |batch, [q, dq, ddq], out| {
            batch.inverse_dynamics(States { q, dq, ddq }, out);
        })
    }

    fn forward_dynamics<'py>(
        &self,
        py: Python<'py>,
        q: Rows<'py>,
        dq: Rows<'py>,
        theta: Rows<'py>,
        dtheta: Rows<'py>,
        tau: Rows<'py>,
    ) -> Output<'py> {
        let signals = [("q", q), ("dq", dq), ("theta", theta), ("dtheta", dtheta), ("tau", tau)];
        self.ask(py, signals, [2, self.0.len()], |batch, [q, dq, theta, dtheta, tau], out| {
            batch.forward_dynamics(DrivenStates { q, dq, theta, dtheta, tau }, out);
        })
    }

    fn coriolis_matrix<'py>(&self, py: Python<'py>, q: Rows<'py>, dq: Rows<'py>) -> Output<'py> {
        self.ask(py, [("q", q), ("dq", dq)], [self.0.len(); 2], |batch, [q, dq], out| batch.coriolis_matrix(q, dq, out))
    }

    fn inverse_dynamics_derivatives<'py>(
        &self,
        py: Python<'py>,
        q: Rows<'py>,
        dq: Rows<'py>,
        ddq: Rows<'py>,
    ) -> Output<'py> {
        let n = self.0.len();
        self.ask(py, [("q", q), ("dq", dq), ("ddq", ddq)], [3, n, n], |batch, [q, dq, ddq], out| {
            batch.inverse_dynamics_derivatives(States { q, dq, ddq }, out);
        })
    }

    fn specific_force<'py>(&self, py: Python<'py>, q: Rows<'py>, dq: Rows<'py>, ddq: Rows<'py>) -> Output<'py> {
        let shape = [self.0.acceleration_channels()];
        self.ask(py, [("q", q), ("dq", dq), ("ddq", ddq)], shape, |batch, [q, dq, ddq], out| {
            batch.specific_force(States { q, dq, ddq }, out);
        })
    }

    fn specific_force_derivatives<'py>(
        &self,
        py: Python<'py>,
        q: Rows<'py>,
        dq: Rows<'py>,
        ddq: Rows<'py>,
    ) -> Output<'py> {
        let shape = [3, self.0.acceleration_channels(), self.0.len()];
        self.ask(py, [("q", q), ("dq", dq), ("ddq", ddq)], shape, |batch, [q, dq, ddq], out| {
            batch.specific_force_derivatives(States { q, dq, ddq }, out);
        })
    }

    fn angular_rate<'py>(&self, py: Python<'py>, q: Rows<'py>, dq: Rows<'py>) -> Output<'py> {
        let shape = [self.0.gyroscope_channels()];
        self.ask(py, [("q", q), ("dq", dq)], shape, |batch, [q, dq], out| batch.angular_rate(q, dq, out))
    }

    fn mass_matrix<'py>(&self, py: Python<'py>, q: Rows<'py>) -> Output<'py> {
        self.ask(py, [("q", q)], [self.0.len(); 2], |batch, [q], out| batch.mass_matrix(q, out))
    }

    fn gravity_torque<'py>(&self, py: Python<'py>, q: Rows<'py>) -> Output<'py> {
        self.ask(py, [("q", q)], [self.0.len()], |batch, [q], out| batch.gravity_torque(q, out))
    }

    fn wrench_map<'py>(&self, py: Python<'py>, q: Rows<'py>) -> Output<'py> {
        let shape = [self.0.len(), self.0.wrench_states()];
        self.ask(py, [("q", q)], shape, |batch, [q], out| batch.wrench_map(q, out))
    }

    fn link_friction<'py>(&self, py: Python<'py>, dq: Rows<'py>, load: Rows<'py>) -> Output<'py> {
        let signals = [("dq", dq), ("load", load)];
        self.ask(py, signals, [self.0.len()], |batch, [dq, load], out| batch.link_friction(dq, load, out))
    }

    fn motor_friction<'py>(&self, py: Python<'py>, dtheta: Rows<'py>, load: Rows<'py>) -> Output<'py> {
        let signals = [("dtheta", dtheta), ("load", load)];
        self.ask(py, signals, [self.0.len()], |batch, [dtheta, load], out| batch.motor_friction(dtheta, load, out))
    }

    fn tool_position<'py>(&self, py: Python<'py>, q: Rows<'py>) -> Output<'py> {
        self.ask(py, [("q", q)], [3], |batch, [q], out| batch.tool_position(q, out))
    }
}

impl Robot {
    /// What `f` makes of one sample (n,), or of rows (T, n): an array of `shape`, or one a row.
    fn ask<'py, const S: usize, const D: usize>(
        &self,
        py: Python<'py>,
        signals: [(&str, Rows<'py>); S],
        shape: [usize; D],
        f: impl FnOnce(&mut Batch, [&[f64]; S], &mut [f64]) + Send,
    ) -> Output<'py> {
        let count = signals[0].1.count();
        let mut values = [&[][..]; S];
        for ((name, signal), values) in signals.iter().zip(&mut values) {
            *values = signal.get(name, count, self.0.len())?;
        }
        let Some(count) = count else { return self.ask_once(py, values, &shape, f) };
        let out = py.release(|| {
            let mut out = memory::filled(0.0, count, shape.iter().product())?;
            f(&mut Batch::new(Arc::clone(&self.0)), values, &mut out);
            Ok::<_, DesignError>(out)
        })?;
        let shape: Vec<usize> = core::iter::once(count).chain(shape).collect();
        shaped(py, out, shape)
    }

    /// Of one sample, which takes less time than to let go of the interpreter.
    fn ask_once<'py, const S: usize>(
        &self,
        py: Python<'py>,
        values: [&[f64]; S],
        shape: &[usize],
        f: impl FnOnce(&mut Batch, [&[f64]; S], &mut [f64]),
    ) -> Output<'py> {
        let out = PyArrayDyn::zeros(py, shape, false);
        let mut room = out.try_readwrite().map_err(|error| EstimatorError::new_err(error.to_string()))?;
        match self.1.try_lock() {
            Ok(mut batch) => f(&mut batch, values, room.as_slice_mut()?),
            // Another thread is at it.
            Err(_) => f(&mut Batch::new(Arc::clone(&self.0)), values, room.as_slice_mut()?),
        }
        drop(room);
        Ok(out)
    }
}
