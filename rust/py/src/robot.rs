//! A compiled robot and its dynamics over arrays.

use crate::array::{counted, rows, shaped};
use crate::error::IntoPyErr;
use crate::gil::Release;
use crate::plain::Plain;
use linkside_compiled::description;
use linkside_core::dynamics::{Batch, DrivenStates, States};
use linkside_core::error::DesignError;
use linkside_core::memory;
use linkside_core::robot;
use numpy::{PyArrayDyn, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;
use std::sync::Arc;

/// A robot flattened for the kernels.
#[pyclass(frozen, module = "linkside._core")]
pub(crate) struct Robot(pub(crate) Arc<robot::Robot>);

type Input<'py> = PyReadonlyArray2<'py, f64>;
type Output<'py> = PyResult<Bound<'py, PyArrayDyn<f64>>>;

#[pymethods]
impl Robot {
    #[new]
    fn new(description: Plain<description::Robot>) -> PyResult<Self> {
        description.0.build().map(|robot| Self(Arc::new(robot))).map_err(IntoPyErr::into_py_err)
    }

    /// Number of joints.
    #[getter]
    fn n(&self) -> usize {
        self.0.len()
    }

    fn inverse_dynamics<'py>(&self, q: Input<'py>, dq: Input<'py>, ddq: Input<'py>) -> Output<'py> {
        self.states(&q, &dq, &ddq, [self.0.len()], Batch::inverse_dynamics)
    }

    fn forward_dynamics<'py>(
        &self,
        q: Input<'py>,
        dq: Input<'py>,
        theta: Input<'py>,
        dtheta: Input<'py>,
        tau: Input<'py>,
    ) -> Output<'py> {
        let n = self.0.len();
        let count = q.shape()[0];
        let states = DrivenStates {
            q: rows("q", &q, n)?,
            dq: counted("dq", &dq, n, count)?,
            theta: counted("theta", &theta, n, count)?,
            dtheta: counted("dtheta", &dtheta, n, count)?,
            tau: counted("tau", &tau, n, count)?,
        };
        self.over(&q, [2, n], |batch, out| batch.forward_dynamics(states, out))
    }

    fn coriolis_matrix<'py>(&self, q: Input<'py>, dq: Input<'py>) -> Output<'py> {
        self.states(&q, &dq, &dq, [self.0.len(); 2], Batch::coriolis_matrix)
    }

    fn inverse_dynamics_derivatives<'py>(&self, q: Input<'py>, dq: Input<'py>, ddq: Input<'py>) -> Output<'py> {
        let n = self.0.len();
        self.states(&q, &dq, &ddq, [3, n, n], Batch::inverse_dynamics_derivatives)
    }

    fn specific_force<'py>(&self, q: Input<'py>, dq: Input<'py>, ddq: Input<'py>) -> Output<'py> {
        self.states(&q, &dq, &ddq, [self.0.acceleration_channels()], Batch::specific_force)
    }

    fn specific_force_derivatives<'py>(&self, q: Input<'py>, dq: Input<'py>, ddq: Input<'py>) -> Output<'py> {
        let shape = [3, self.0.acceleration_channels(), self.0.len()];
        self.states(&q, &dq, &ddq, shape, Batch::specific_force_derivatives)
    }

    fn angular_rate<'py>(&self, q: Input<'py>, dq: Input<'py>) -> Output<'py> {
        self.states(&q, &dq, &dq, [self.0.gyroscope_channels()], Batch::angular_rate)
    }

    fn mass_matrix<'py>(&self, q: Input<'py>) -> Output<'py> {
        self.positions(&q, [self.0.len(); 2], Batch::mass_matrix)
    }

    fn gravity_torque<'py>(&self, q: Input<'py>) -> Output<'py> {
        self.positions(&q, [self.0.len()], Batch::gravity_torque)
    }

    fn wrench_map<'py>(&self, q: Input<'py>) -> Output<'py> {
        self.positions(&q, [self.0.len(), self.0.wrench_states()], Batch::wrench_map)
    }

    fn link_friction<'py>(&self, dq: Input<'py>, load: Input<'py>) -> Output<'py> {
        let n = self.0.len();
        let (velocities, load) = (rows("dq", &dq, n)?, counted("load", &load, n, dq.shape()[0])?);
        self.over(&dq, [n], |batch, out| batch.link_friction(velocities, load, out))
    }

    fn motor_friction<'py>(&self, dtheta: Input<'py>, load: Input<'py>) -> Output<'py> {
        let n = self.0.len();
        let (velocities, load) = (rows("dtheta", &dtheta, n)?, counted("load", &load, n, dtheta.shape()[0])?);
        self.over(&dtheta, [n], |batch, out| batch.motor_friction(velocities, load, out))
    }

    fn tool_position<'py>(&self, q: Input<'py>) -> Output<'py> {
        self.positions(&q, [3], Batch::tool_position)
    }
}

impl Robot {
    /// Runs `f` over the rows of a state; the output has one array of `shape` a row.
    fn states<'a, 'py, const D: usize>(
        &'a self,
        q: &Input<'py>,
        dq: &Input<'py>,
        ddq: &Input<'py>,
        shape: [usize; D],
        f: impl FnOnce(&mut Batch<'a>, States<'_>, &mut [f64]) + Send,
    ) -> Output<'py> {
        let n = self.0.len();
        // One row of velocities or accelerations is that of all samples.
        let height = |array: &Input<'py>| if array.shape()[0] == 1 { 1 } else { q.shape()[0] };
        let (dq, ddq) = (counted("dq", dq, n, height(dq))?, counted("ddq", ddq, n, height(ddq))?);
        let states = States { q: rows("q", q, n)?, dq, ddq };
        self.over(q, shape, |batch, out| f(batch, states, out))
    }

    /// As [`states`](Self::states), for what depends on positions alone.
    fn positions<'a, 'py, const D: usize>(
        &'a self,
        q: &Input<'py>,
        shape: [usize; D],
        f: impl FnOnce(&mut Batch<'a>, &[f64], &mut [f64]) + Send,
    ) -> Output<'py> {
        let positions = rows("q", q, self.0.len())?;
        self.over(q, shape, |batch, out| f(batch, positions, out))
    }

    fn over<'a, 'py, const D: usize>(
        &'a self,
        q: &Input<'py>,
        shape: [usize; D],
        f: impl FnOnce(&mut Batch<'a>, &mut [f64]) + Send,
    ) -> Output<'py> {
        let (py, count) = (q.py(), q.shape()[0]);
        let values = py.release(|| {
            let mut out = memory::filled(0.0, count, shape.iter().product())?;
            f(&mut Batch::new(&self.0), &mut out);
            Ok::<_, DesignError>(out)
        })?;
        let shape: Vec<usize> = core::iter::once(count).chain(shape).collect();
        shaped(py, values, shape)
    }
}
