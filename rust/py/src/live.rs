//! One sample of the jerk-driven model's filters, put together from its signals.

use crate::array::Signal;
use crate::error::{EstimatorError, IntoPyErr};
use linkside_core::estimate::kalman::{FilterOutput, Inputs, JerkDriven, KalmanSample, Keep, Model};
use pyo3::prelude::*;

/// A sample put together from its signals.
#[derive(Clone)]
pub(crate) struct Live {
    readings: Vec<f64>,
    dtheta: Vec<f64>,
    /// Commanded acceleration of the sample before; empty when there is none.
    pub(crate) ddqref: Vec<f64>,
    jerk: Vec<f64>,
    /// Time since the first sample [s].
    t: f64,
    /// The estimate at the last one.
    row: FilterOutput,
}

impl Live {
    pub(crate) fn new(model: &JerkDriven) -> PyResult<Self> {
        let (joints, channels) = (model.robot().len(), model.channels());
        Ok(Self {
            readings: vec![f64::NAN; channels],
            dtheta: vec![f64::NAN; joints],
            ddqref: Vec::new(),
            jerk: vec![0.0; joints],
            t: 0.0,
            row: FilterOutput::zeros(1, model, Keep::default()).map_err(IntoPyErr::into_py_err)?,
        })
    }

    /// The sample, `dt` after the one before [s]; time, and where its estimate goes.
    pub(crate) fn parts(&mut self, dt: f64) -> (KalmanSample<'_>, &mut f64, &mut FilterOutput) {
        let Self { readings, dtheta, jerk, t, row, .. } = self;
        (KalmanSample { dt, readings, inputs: Inputs { dtheta, jerk, tau: &[] } }, t, row)
    }

    /// Takes over a sample, or leaves everything as it is where a signal cannot be used.
    pub(crate) fn set(&mut self, dt: f64, sensors: usize, signals: &Signals<'_>) -> PyResult<()> {
        let (n, m) = (self.jerk.len(), self.readings.len());
        let Signals { theta, acceleration, dtheta, ddqref, further } = signals;
        let theta = theta.readings("theta", n)?;
        let acceleration = given(acceleration.as_ref(), "acceleration", sensors)?;
        let dtheta = given(dtheta.as_ref(), "dtheta", n)?;
        let ddqref = given(ddqref.as_ref(), "ddqref", n)?;
        let further = given(further.as_ref(), "further", m - n - sensors)?;
        let (motors, rest) = self.readings.split_at_mut(n);
        let (accelerations, others) = rest.split_at_mut(sensors);
        motors.copy_from_slice(theta);
        fill(accelerations, acceleration);
        fill(others, further);
        fill(&mut self.dtheta, dtheta);
        self.jerk.fill(0.0);
        let now = ddqref.unwrap_or_default();
        for ((jerk, now), before) in self.jerk.iter_mut().zip(now).zip(&self.ddqref) {
            let change = (now - before) / dt;
            *jerk = if change.is_finite() { change } else { 0.0 };
        }
        self.ddqref.clear();
        self.ddqref.extend_from_slice(now);
        Ok(())
    }
}

/// One sample of every signal; what is not given is missing.
pub(crate) struct Signals<'py> {
    pub(crate) theta: Signal<'py>,
    pub(crate) acceleration: Option<Signal<'py>>,
    pub(crate) dtheta: Option<Signal<'py>>,
    pub(crate) ddqref: Option<Signal<'py>>,
    pub(crate) further: Option<Signal<'py>>,
}

/// The readings of a signal that may not be there.
pub(crate) fn given<'a>(signal: Option<&'a Signal<'_>>, name: &str, expected: usize) -> PyResult<Option<&'a [f64]>> {
    signal.map(|signal| signal.readings(name, expected)).transpose()
}

/// # Errors
/// A step of time that no clock makes.
pub(crate) fn check_step(dt: f64) -> PyResult<()> {
    if dt > 0.0 && dt.is_finite() {
        return Ok(());
    }
    Err(EstimatorError::new_err(format!("dt is {dt}, expected a positive, finite time in seconds")))
}

/// Copies readings, or NaN where there are none.
pub(crate) fn fill(to: &mut [f64], readings: Option<&[f64]>) {
    match readings {
        Some(readings) => to.copy_from_slice(readings),
        None => to.fill(f64::NAN),
    }
}
