//! What a filter is given: one sample, or a whole recording.

use super::model::Model;
use crate::check::{expect, expect_length, refuse_infinite};
use crate::error::DesignError;

/// One sample; NaN where a reading is missing.
#[derive(Clone, Copy, Debug)]
pub struct KalmanSample<'a> {
    /// Time since the sample before [s]; not looked at on the first.
    pub dt: f64,
    /// One reading a channel.
    pub readings: &'a [f64],
    /// Signals that drive the model rather than measure it.
    pub inputs: Inputs<'a>,
}

/// Signals that drive a model; one row of n a sample, or empty where the model takes none.
#[derive(Clone, Copy, Debug, Default)]
pub struct Inputs<'a> {
    /// Motor velocities, for the damping torque [rad/s].
    pub dtheta: &'a [f64],
    /// Jerk of the links since the sample before, as commanded [rad/s³].
    pub jerk: &'a [f64],
    /// Motor torques [N m].
    pub tau: &'a [f64],
}

impl<'a> Inputs<'a> {
    /// Rows of every signal that is there.
    fn rows(&self, rows: core::ops::Range<usize>, n: usize) -> Self {
        let cut = |values: &'a [f64]| if values.is_empty() { values } else { &values[rows.start * n..rows.end * n] };
        Self { dtheta: cut(self.dtheta), jerk: cut(self.jerk), tau: cut(self.tau) }
    }
}

/// A recording, row-major.
#[derive(Clone, Copy, Debug)]
pub struct KalmanRecording<'a> {
    /// Steps of time (count), the first one unused [s].
    pub dt: &'a [f64],
    /// Readings (count × channels).
    pub readings: &'a [f64],
    /// Inputs (count × n each).
    pub inputs: Inputs<'a>,
}

impl KalmanSample<'_> {
    /// Whether a filter can take this sample.
    ///
    /// # Errors
    /// A step of time that is not positive and finite, an infinite reading, wrong lengths.
    pub(crate) fn check(&self, model: &impl Model) -> Result<(), DesignError> {
        let Self { dt, readings, inputs } = *self;
        expect(dt > 0.0 && dt.is_finite(), "dt", dt, "a positive, finite time")?;
        model.check(&KalmanRecording { dt: &[dt], readings, inputs })?;
        let Inputs { dtheta, jerk, tau } = inputs;
        [("readings", readings), ("dtheta", dtheta), ("jerk", jerk), ("tau", tau)]
            .into_iter()
            .try_for_each(|(what, values)| refuse_infinite(what, values))
    }
}

impl<'a> KalmanRecording<'a> {
    /// Some rows.
    pub(super) fn rows(&self, rows: core::ops::Range<usize>, model: &impl Model) -> Self {
        let m = model.channels();
        Self {
            dt: &self.dt[rows.clone()],
            readings: &self.readings[rows.start * m..rows.end * m],
            inputs: self.inputs.rows(rows, model.robot().len()),
        }
    }

    /// Row `i`.
    #[inline(always)]
    pub(crate) fn sample(&self, i: usize, model: &impl Model) -> KalmanSample<'a> {
        let m = model.channels();
        KalmanSample {
            dt: self.dt[i],
            readings: &self.readings[i * m..][..m],
            inputs: self.inputs.rows(i..i + 1, model.robot().len()),
        }
    }

    /// # Errors
    /// Readings, or an input named in `needed`, of another length than the recording.
    pub(super) fn expect(
        &self,
        channels: usize,
        joints: usize,
        needed: &[(&'static str, &[f64])],
    ) -> Result<(), DesignError> {
        let count = self.dt.len();
        expect_length("readings", self.readings.len(), count * channels)?;
        needed.iter().try_for_each(|(what, values)| expect_length(what, values.len(), count * joints))
    }
}
