//! What Kalman filters on both models have in common: channels, runs, and what comes out.

use crate::array::{Signal, rows, shaped};
use crate::error::{EstimatorError, IntoPyErr, outcome};
use crate::gil::Release;
use crate::state::State;
use linkside_core::error::RunError;
use linkside_core::estimate::kalman::{
    ExtendedKalmanFilter, Fault, FilterOutput, Finding, Gaussian, KalmanRecording, KalmanSample, Keep, Model, Phases,
    Way,
};
use numpy::{PyArray1, PyArrayDyn, PyReadonlyArray2};
use pyo3::prelude::*;
use pyo3::types::PyDict;

pub(crate) type Matrix<'py> = PyReadonlyArray2<'py, f64>;

/// A belief of `states` states.
pub(crate) fn belief(mean: &Signal<'_>, covariance: &Matrix<'_>, states: usize) -> PyResult<Gaussian> {
    Gaussian::new(mean.sized("mean", states)?, rows("covariance", covariance, states)?).map_err(IntoPyErr::into_py_err)
}

/// Takes one sample at time `t` since the first [s], and reports into `row`.
pub(crate) fn step<M: Phases>(
    filter: &mut ExtendedKalmanFilter<M>,
    sample: KalmanSample<'_>,
    t: &mut f64,
    row: &mut FilterOutput,
) -> PyResult<State> {
    let now = if filter.is_started() { *t + sample.dt } else { 0.0 };
    filter.step(sample).map_err(IntoPyErr::into_py_err)?;
    *t = now;
    filter.report_into(row);
    let mut covariance = vec![0.0; filter.model().states().pow(2)];
    filter.covariance_into(&mut covariance).map_err(IntoPyErr::into_py_err)?;
    let state = State::of_row(now, filter.model().robot().len(), row, 0);
    Ok(state.with_whole(&filter.belief().mean, covariance))
}

/// Covariance of the state after the last sample.
pub(crate) fn covariance<'py, M: Phases>(
    py: Python<'py>,
    filter: &ExtendedKalmanFilter<M>,
) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
    let states = filter.model().states();
    shaped(py, filter.covariance().dense().collect(), vec![states, states])
}

/// Goes on from the live state with the rows of a log.
pub(crate) fn run<'py, M: Phases>(
    py: Python<'py>,
    filter: &mut ExtendedKalmanFilter<M>,
    recording: KalmanRecording<'_>,
    keep: Keep,
) -> PyResult<Bound<'py, PyDict>> {
    let out = py.release(|| filter.run(recording, keep))?;
    into_dict(py, out, filter.model())
}

/// Each log from a fresh start with the filter beside it, on all cores: its arrays, or the exception that it came to.
pub(crate) fn run_all<'py, M: Phases>(
    py: Python<'py>,
    jobs: &[(&ExtendedKalmanFilter<M>, KalmanRecording<'_>)],
    way: &str,
    keep: Keep,
) -> PyResult<Vec<Bound<'py, PyAny>>> {
    let way = match way {
        "filter" => Way::Filter,
        "smooth" => Way::Smooth,
        "iterate" => Way::Iterate,
        other => return Err(EstimatorError::new_err(format!("{other:?} is not filter, smooth or iterate"))),
    };
    let results = py.release(|| Ok::<_, RunError>(ExtendedKalmanFilter::run_each(jobs, way, keep)))?;
    let convert = |(filter, _): &(&ExtendedKalmanFilter<M>, _), out| into_dict(py, out, filter.model());
    jobs.iter().zip(results).map(|(job, result)| outcome(py, result, |out| convert(job, out))).collect()
}

/// The fields of an estimate, by name, as arrays of one row a sample; what was not kept is not there.
pub(crate) fn into_dict<'py>(py: Python<'py>, o: FilterOutput, model: &impl Model) -> PyResult<Bound<'py, PyDict>> {
    let out = PyDict::new(py);
    let (n, m, states, count) = (model.robot().len(), model.channels(), model.states(), o.status.len());
    let wrenches = model.robot().wrench_states();
    let put = |name: &str, values: Vec<f64>, shape: &[usize]| {
        let shape: Vec<usize> = core::iter::once(count).chain(shape.iter().copied()).collect();
        out.set_item(name, shaped(py, values, shape)?)
    };
    for (name, values) in [("q", o.q), ("dq", o.dq), ("ddq", o.ddq), ("theta", o.theta), ("dtheta", o.dtheta)] {
        put(name, values, &[n])?;
    }
    put("q_std", o.q_std, &[n])?;
    if !o.disturbance.is_empty() {
        put("disturbance", o.disturbance, &[n])?;
        put("disturbance_std", o.disturbance_std, &[n])?;
    }
    if !o.wrench.is_empty() {
        put("wrench", o.wrench, &[wrenches])?;
        put("wrench_std", o.wrench_std, &[wrenches])?;
    }
    if model.robot().tool.is_some() {
        put("tool_position", o.tool, &[3])?;
        put("tool_std", o.tool_std, &[3])?;
    }
    put("nis", o.nis, &[])?;
    put("log_likelihood", o.log_likelihood, &[])?;
    if !o.state.is_empty() {
        put("state", o.state, &[states])?;
        put("covariance", o.covariance, &[states, states])?;
    }
    if !o.innovation.is_empty() {
        put("innovation", o.innovation, &[m])?;
        put("innovation_std", o.innovation_std, &[m])?;
    }
    out.set_item("used", PyArray1::from_vec(py, o.used))?;
    out.set_item("status", PyArray1::from_vec(py, o.status))?;
    out.set_item("findings", findings(&o.findings))?;
    Ok(out)
}

/// A finding: channel, first and last sample, size, the same in standard deviations, and what the readings look like.
pub(crate) type Found = (Option<usize>, u64, u64, f64, f64, &'static str);

pub(crate) fn findings(all: &[Finding]) -> Vec<Found> {
    let one = |f: &Finding| (f.channel, f.since, f.until, f.size, f.deviations, word(f.fault));
    all.iter().map(one).collect()
}

fn word(fault: Fault) -> &'static str {
    match fault {
        Fault::Stuck => "stuck",
        Fault::Saturated => "saturated",
        Fault::Dead => "dead",
        Fault::Wrap => "wrap",
        Fault::Step => "step",
        Fault::Flipped => "flipped",
        Fault::Drift => "drift",
        Fault::Correlated => "correlated",
        Fault::Unknown => "unknown",
    }
}
