//! Particle filters on the jerk-driven model.

use crate::array::{Signal, shaped};
use crate::error::{EstimatorError, IntoPyErr, outcome};
use crate::filtering::{self, Matrix, into_dict};
use crate::gil::Release;
use crate::kalman::{Arrays, recording};
use crate::live::{Live, Signals, check_step};
use crate::plain::Plain;
use crate::robot::Robot;
use crate::state::State;
use linkside_compiled::description::{self, BuildError};
use linkside_core::error::RunError;
use linkside_core::estimate::kalman::{JerkDriven, JerkModel, Keep, Model};
use linkside_core::estimate::particle::{
    self, Collapse, Density, Marginalised, ParticleOutput, ParticleSettings, Proposal, Resampling,
};
use numpy::PyArray1;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::sync::Arc;

/// Degrees of freedom of Student's noise, or share and scale of outliers.
#[derive(FromPyObject)]
enum Outliers {
    Student(f64),
    Mixture(f64, f64),
}

impl From<Outliers> for Density {
    fn from(outliers: Outliers) -> Self {
        match outliers {
            Outliers::Student(freedom) => Self::Student { freedom },
            Outliers::Mixture(share, scale) => Self::Mixture { share, scale },
        }
    }
}

/// ParticleFields as Python spells them.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
struct ParticleFields {
    particles: usize,
    seed: u64,
    proposal: String,
    iterations: usize,
    proposal_tail: Option<u32>,
    resampling: String,
    threshold: f64,
    kernel: Option<f64>,
    outliers: Vec<Option<Outliers>>,
    limits: Vec<(f64, f64)>,
    initial: Vec<f64>,
    collapse: String,
    quantiles: Vec<f64>,
}

fn unknown<T>(what: &str, value: &str) -> PyResult<T> {
    Err(EstimatorError::new_err(format!("{what} {value:?} is not known")))
}

impl ParticleFields {
    fn into_core(self) -> PyResult<ParticleSettings> {
        let proposal = match self.proposal.as_str() {
            "bootstrap" => Proposal::Bootstrap,
            "linearised" => Proposal::Linearised { iterations: self.iterations, tail: self.proposal_tail },
            other => return unknown("proposal", other),
        };
        let resampling = match self.resampling.as_str() {
            "systematic" => Resampling::Systematic,
            "stratified" => Resampling::Stratified,
            "residual" => Resampling::Residual,
            "multinomial" => Resampling::Multinomial,
            other => return unknown("resampling", other),
        };
        let collapse = match self.collapse.as_str() {
            "raise" => Collapse::Stop,
            "flag" => Collapse::Flag,
            "reseed" => Collapse::Reseed,
            other => return unknown("collapse", other),
        };
        let Self { particles, seed, threshold, kernel, outliers, limits, initial, quantiles, .. } = self;
        Ok(ParticleSettings {
            particles,
            seed,
            proposal,
            resampling,
            threshold,
            kernel,
            densities: outliers.into_iter().map(|kind| kind.map_or(Density::Normal, Into::into)).collect(),
            limits,
            initial,
            collapse,
            quantiles,
        })
    }
}

/// Particle filter of one robot.
#[pyclass(module = "linkside._core")]
#[derive(Clone)]
pub(crate) struct ParticleFilter {
    filter: particle::ParticleFilter,
    levels: usize,
    live: Live,
}

#[pymethods]
impl ParticleFilter {
    #[new]
    #[pyo3(signature = (
        robot, *, kinds, biased, noise, damping, tolerances, marginalised, settings, correlations=vec![],
        late=None
    ))]
    fn new(
        robot: &Robot,
        kinds: Vec<String>,
        biased: Vec<bool>,
        noise: Plain<description::JerkNoise>,
        damping: bool,
        tolerances: Plain<Vec<description::Tolerance>>,
        marginalised: &str,
        settings: ParticleFields,
        correlations: Vec<(usize, usize, f64)>,
        late: Option<Plain<Vec<Option<description::Late>>>>,
    ) -> PyResult<Self> {
        let settings = settings.into_core()?;
        let marginalised = match marginalised {
            "nothing" => Marginalised::Nothing,
            "biases" => Marginalised::Biases,
            "accelerations" => Marginalised::Accelerations,
            other => return unknown("marginalised", other),
        };
        let levels = settings.quantiles.len();
        let build = || -> Result<_, BuildError> {
            let kinds = description::kinds(&kinds)?;
            let model = JerkModel::new(Arc::clone(&robot.0), &kinds, &biased)?;
            let model = JerkDriven::new(model, noise.0.into(), damping)?
                .with_tolerances(description::tolerances(&robot.0, &tolerances.0, &correlations)?)
                .with_late(&description::late(&late.map_or_else(Vec::new, |late| late.0))?)?;
            Ok(particle::ParticleFilter::new(model, settings, marginalised)?)
        };
        let filter = build().map_err(IntoPyErr::into_py_err)?;
        let live = Live::new(filter.model())?;
        Ok(Self { filter, levels, live })
    }

    /// Number of states.
    #[getter]
    fn states(&self) -> usize {
        self.filter.model().states()
    }

    /// A copy with the same particles.
    fn copy(&self) -> Self {
        self.clone()
    }

    /// Number of states, under the name that all filters have for it.
    #[getter]
    fn own_states(&self) -> usize {
        self.states()
    }

    /// From now on a first sample finds this belief.
    fn set_start(&mut self, mean: Signal<'_>, covariance: Matrix<'_>) -> PyResult<()> {
        let start = filtering::belief(&mean, &covariance, self.states())?;
        self.filter.set_start(Some(start)).map_err(IntoPyErr::into_py_err)
    }

    fn reset(&mut self) {
        self.filter.reset();
        self.live.ddqref.clear();
    }

    /// Takes one sample; what is not given is missing.
    #[pyo3(signature = (dt, theta, acceleration=None, dtheta=None, ddqref=None, further=None))]
    fn step(
        &mut self,
        py: Python<'_>,
        dt: f64,
        theta: Signal<'_>,
        acceleration: Option<Signal<'_>>,
        dtheta: Option<Signal<'_>>,
        ddqref: Option<Signal<'_>>,
        further: Option<Signal<'_>>,
    ) -> PyResult<State> {
        check_step(dt)?;
        let Self { filter, live, .. } = self;
        let sensors = filter.model().acceleration_channels();
        live.set(dt, sensors, &Signals { theta, acceleration, dtheta, ddqref, further })?;
        let (sample, t, row) = live.parts(dt);
        let now = if filter.is_started() { *t + dt } else { 0.0 };
        py.release_briefly(|| filter.step(sample))?;
        *t = now;
        filter.report_into(row);
        let summary = filter.summary();
        let state = State::of_row(now, filter.model().robot().len(), row, 0);
        Ok(state.with_particles(&summary.mean, summary.effective))
    }

    /// Effective number of particles after the last sample.
    #[getter]
    fn effective(&self) -> f64 {
        self.filter.summary().effective
    }

    /// Covariance of the state after the last sample.
    #[getter]
    fn covariance<'py>(&mut self, py: Python<'py>) -> PyResult<Bound<'py, numpy::PyArrayDyn<f64>>> {
        let states = self.filter.model().states();
        shaped(py, self.filter.covariance(), vec![states, states])
    }

    /// Goes on from the live state with the rows of a log, or of a piece of one.
    fn run<'py>(&mut self, py: Python<'py>, arrays: Arrays<'py>, covariance: bool) -> PyResult<Bound<'py, PyDict>> {
        let recording = recording(self.filter.model(), &arrays)?;
        let filter = &mut self.filter;
        let out = py.release(|| filter.run(recording, Keep { covariance, innovations: false }))?;
        self.convert(py, out)
    }

    /// Each log from a fresh start with the settings of the filter beside it, on all cores, by all of its samples where
    /// `smooth`: its arrays, or the exception that it came to.
    #[staticmethod]
    fn run_all<'py>(
        py: Python<'py>,
        jobs: Vec<(PyRef<'py, Self>, Arrays<'py>)>,
        smooth: bool,
        covariance: bool,
    ) -> PyResult<Vec<Bound<'py, PyAny>>> {
        let recordings = jobs
            .iter()
            .map(|(own, arrays)| Ok((&own.filter, recording(own.filter.model(), arrays)?)))
            .collect::<PyResult<Vec<_>>>()?;
        let keep = Keep { covariance, innovations: false };
        let all = if smooth { particle::ParticleFilter::smooth_each } else { particle::ParticleFilter::run_each };
        let results = py.release(|| Ok::<_, RunError>(all(&recordings, keep)))?;
        jobs.iter().zip(results).map(|((own, _), result)| outcome(py, result, |out| own.convert(py, out))).collect()
    }
}

impl ParticleFilter {
    fn convert<'py>(&self, py: Python<'py>, o: ParticleOutput) -> PyResult<Bound<'py, PyDict>> {
        let ParticleOutput { links, effective, reseeded, best, quantiles } = o;
        let (count, n) = (effective.len(), self.filter.model().robot().len());
        let out = into_dict(py, links, self.filter.model())?;
        out.del_item("nis")?;
        out.set_item("effective", shaped(py, effective, vec![count])?)?;
        out.set_item("reseeded", PyArray1::from_vec(py, reseeded))?;
        if !best.is_empty() {
            out.set_item("best", shaped(py, best, vec![count, n])?)?;
        }
        if !quantiles.is_empty() {
            out.set_item("quantiles", shaped(py, quantiles, vec![count, self.levels, n])?)?;
        }
        Ok(out)
    }
}
