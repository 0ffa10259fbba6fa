//! What an observer takes and gives: samples, recordings and estimates.

use crate::error::DesignError;
use crate::memory::room;

/// One sample of a log; NaN where a reading is missing.
#[derive(Clone, Copy, Debug)]
pub struct ObserverSample<'a> {
    /// Motor positions θ (n) [rad].
    pub theta: &'a [f64],
    /// Motor torques τ (n) [N m], held until the next sample.
    pub tau: &'a [f64],
    /// Accelerometer channels [m/s²], or link accelerations (n) [rad/s²].
    pub acceleration: &'a [f64],
}

/// A recording: `count` samples of θ, τ and acceleration, row-major.
#[derive(Clone, Copy, Debug)]
pub struct ObserverRecording<'a> {
    /// Number of samples.
    pub count: usize,
    /// θ, n columns.
    pub theta: &'a [f64],
    /// τ, n columns.
    pub tau: &'a [f64],
    /// Acceleration channels.
    pub acceleration: &'a [f64],
}

/// Estimates of a recording, row-major, one row a sample.
#[derive(Clone, Debug, Default)]
pub struct ObserverOutput {
    /// Link positions (n).
    pub q: Vec<f64>,
    /// Link velocities (n).
    pub dq: Vec<f64>,
    /// Link accelerations (n).
    pub ddq: Vec<f64>,
    /// Motor positions (n).
    pub theta: Vec<f64>,
    /// Motor velocities (n).
    pub dtheta: Vec<f64>,
    /// Tool centre point (3); empty when the robot has none.
    pub tool: Vec<f64>,
    /// Standard deviations of link positions (n); empty where they are not wanted, as the next.
    pub q_std: Vec<f64>,
    /// Those of the tool centre point (3).
    pub tool_std: Vec<f64>,
    /// See [`Status`](crate::estimate::Status).
    pub status: Vec<u8>,
}

impl ObserverOutput {
    /// # Errors
    /// [`DesignError::Memory`].
    pub(super) fn with_capacity(count: usize, n: usize, tool: bool, std: bool) -> Result<Self, DesignError> {
        let joints = || room(count, n);
        let deviations = if std { count } else { 0 };
        Ok(Self {
            q: joints()?,
            dq: joints()?,
            ddq: joints()?,
            theta: joints()?,
            dtheta: joints()?,
            tool: room(if tool { count } else { 0 }, 3)?,
            q_std: room(deviations, n)?,
            tool_std: room(if tool { deviations } else { 0 }, 3)?,
            status: room(count, 1)?,
        })
    }
}
