//! What a step gives back.

use linkside_core::estimate::kalman::FilterOutput;
use linkside_core::estimate::{observer, velocity};
use numpy::{PyArray1, PyArray2, PyArrayMethods};
use pyo3::prelude::*;

/// The estimate at one sample; arrays are made when they are asked for.
#[pyclass(frozen, module = "linkside._core")]
pub(crate) struct State {
    /// Time since the first sample [s].
    #[pyo3(get)]
    t: f64,
    #[pyo3(get)]
    status: u8,
    n: usize,
    /// q, q̇, q̈, θ, θ̇, standard deviations of q, disturbance torques and theirs, n each; what there is not is left out from
    /// the end.
    joints: Box<[f64]>,
    /// Varying wrenches, then their standard deviations.
    wrench: Box<[f64]>,
    tool: Option<[f64; 3]>,
    tool_std: Option<[f64; 3]>,
    /// Normalised innovation squared.
    #[pyo3(get)]
    nis: Option<f64>,
    /// Logarithm of the readings' probability density.
    #[pyo3(get)]
    log_likelihood: Option<f64>,
    /// Readings used.
    #[pyo3(get)]
    used: Option<u32>,
    /// Effective number of particles.
    #[pyo3(get)]
    effective: Option<f64>,
    /// Level of a velocity observer's gain.
    #[pyo3(get)]
    level: Option<usize>,
    /// The filter's whole state, and its covariance.
    mean: Box<[f64]>,
    covariance: Box<[f64]>,
}

const THETA: usize = 3;
const Q_STD: usize = 5;
const DISTURBANCE: usize = 6;

impl State {
    fn bare(t: f64, status: u8, n: usize, joints: Vec<f64>) -> Self {
        Self {
            t,
            status,
            n,
            joints: joints.into(),
            wrench: Box::default(),
            tool: None,
            tool_std: None,
            nis: None,
            log_likelihood: None,
            used: None,
            effective: None,
            level: None,
            mean: Box::default(),
            covariance: Box::default(),
        }
    }

    /// Row `i` of a filter's estimate, for a robot of `n` joints.
    pub(crate) fn of_row(t: f64, n: usize, rows: &FilterOutput, i: usize) -> Self {
        let mut joints = Vec::with_capacity(8 * n);
        let parts = [&rows.q, &rows.dq, &rows.ddq, &rows.theta, &rows.dtheta, &rows.q_std];
        for part in parts.into_iter().chain([&rows.disturbance, &rows.disturbance_std]).filter(|part| !part.is_empty())
        {
            joints.extend_from_slice(&part[i * n..][..n]);
        }
        let width = rows.wrench.len() / rows.status.len();
        let wrench = [&rows.wrench, &rows.wrench_std].map(|part| &part[i * width..][..width]).concat();
        let three = |values: &[f64]| values.chunks_exact(3).nth(i).and_then(|row| row.first_chunk().copied());
        Self {
            wrench: wrench.into(),
            tool: three(&rows.tool),
            tool_std: three(&rows.tool_std),
            nis: Some(rows.nis[i]),
            log_likelihood: Some(rows.log_likelihood[i]),
            used: Some(rows.used[i]),
            ..Self::bare(t, rows.status[i], n, joints)
        }
    }

    /// With the whole state and its covariance, row-major.
    pub(crate) fn with_whole(self, mean: &[f64], covariance: Vec<f64>) -> Self {
        Self { mean: mean.into(), covariance: covariance.into(), ..self }
    }

    /// Of a particle filter, which has no innovations.
    pub(crate) fn with_particles(self, mean: &[f64], effective: f64) -> Self {
        Self { nis: None, effective: Some(effective), mean: mean.into(), ..self }
    }

    pub(crate) fn of_observer(observer: &observer::AccelerationObserver) -> Self {
        let n = observer.joints();
        let mut joints = Vec::with_capacity(6 * n);
        for part in [observer.q(), observer.dq(), observer.ddq()] {
            joints.extend_from_slice(part);
        }
        joints.extend((0..n).map(|j| observer.motor(j).0));
        joints.extend((0..n).map(|j| observer.motor(j).1));
        joints.extend_from_slice(observer.q_std());
        let [tool, tool_std] = [observer.tool(), observer.tool_std()].map(|at| (!at[0].is_nan()).then_some(at));
        Self { tool, tool_std, ..Self::bare(observer.time(), observer.status(), n, joints) }
    }

    pub(crate) fn of_velocity_observer(observer: &velocity::VelocityObserver) -> Self {
        let n = observer.joints();
        let mut joints = Vec::with_capacity(5 * n);
        for part in [observer.q(), observer.dq(), observer.ddq()] {
            joints.extend_from_slice(part);
        }
        if observer.is_of_motors() {
            joints.extend_from_within(..2 * n);
        }
        let tool = observer.tool();
        Self {
            tool: (!tool[0].is_nan()).then_some(tool),
            level: Some(observer.level()),
            ..Self::bare(observer.time(), observer.status(), n, joints)
        }
    }

    fn values(&self, part: usize) -> Option<&[f64]> {
        self.joints.get(part * self.n..(part + 1) * self.n)
    }

    fn part<'py>(&self, py: Python<'py>, part: usize) -> Option<Bound<'py, PyArray1<f64>>> {
        self.values(part).map(|values| PyArray1::from_slice(py, values))
    }
}

#[pymethods]
impl State {
    #[getter]
    fn q<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<f64>>> {
        self.part(py, 0)
    }

    #[getter]
    fn dq<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<f64>>> {
        self.part(py, 1)
    }

    #[getter]
    fn ddq<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<f64>>> {
        self.part(py, 2)
    }

    #[getter]
    fn theta<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<f64>>> {
        self.part(py, THETA)
    }

    #[getter]
    fn dtheta<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<f64>>> {
        self.part(py, THETA + 1)
    }

    #[getter]
    fn q_std<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<f64>>> {
        self.part(py, Q_STD)
    }

    #[getter]
    fn disturbance<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<f64>>> {
        self.part(py, DISTURBANCE)
    }

    #[getter]
    fn disturbance_std<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<f64>>> {
        self.part(py, DISTURBANCE + 1)
    }

    #[getter]
    fn wrench<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<f64>>> {
        let (mean, _) = self.wrench.split_at(self.wrench.len() / 2);
        (!mean.is_empty()).then(|| PyArray1::from_slice(py, mean))
    }

    #[getter]
    fn wrench_std<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<f64>>> {
        let (_, std) = self.wrench.split_at(self.wrench.len() / 2);
        (!std.is_empty()).then(|| PyArray1::from_slice(py, std))
    }

    #[getter]
    fn tool_position<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<f64>>> {
        self.tool.map(|tool| PyArray1::from_slice(py, &tool))
    }

    #[getter]
    fn tool_std<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<f64>>> {
        self.tool_std.map(|std| PyArray1::from_slice(py, &std))
    }

    /// The filter's whole state.
    #[getter]
    fn state<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<f64>>> {
        (!self.mean.is_empty()).then(|| PyArray1::from_slice(py, &self.mean))
    }

    /// Covariance of the whole state.
    #[getter]
    fn covariance<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
        if self.covariance.is_empty() {
            return Ok(None);
        }
        let size = self.mean.len();
        PyArray1::from_slice(py, &self.covariance).reshape([size, size]).map(Some)
    }

    fn __repr__(&self) -> String {
        use std::fmt::Write;
        let mut text = format!("State(t={:.6}", self.t);
        for (name, part) in [("q", 0), ("dq", 1), ("q_std", Q_STD)] {
            if let Some(values) = self.values(part) {
                let _ = write!(text, ", {name}={values:.6?}");
            }
        }
        if let Some(tool) = self.tool {
            let _ = write!(text, ", tool_position={tool:.6?}");
        }
        if let Some(nis) = self.nis {
            let _ = write!(text, ", nis={nis:.3}");
        }
        let _ = write!(text, ", status={})", self.status);
        text
    }
}
