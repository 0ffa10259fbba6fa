//! What is kept of a run.

use crate::error::DesignError;
use crate::memory::room;
use crate::robot::Robot;

/// Log and truth of a run, row-major, one row a kept sample.
#[derive(Clone, Debug, Default)]
pub struct SimulatedRecording {
    /// Time [s].
    pub t: Vec<f64>,
    /// Readings in the order of [`Kind::SENSORS`](crate::estimate::measurement::Kind::SENSORS).
    pub readings: Vec<f64>,
    /// Motor torques from this sample until the next (n) [N m].
    pub tau: Vec<f64>,
    /// Link positions (n) [rad].
    pub q: Vec<f64>,
    /// Link velocities (n) [rad/s].
    pub dq: Vec<f64>,
    /// Link accelerations just before the torque changes (n) [rad/s²].
    pub ddq: Vec<f64>,
    /// Motor positions (n) [rad].
    pub theta: Vec<f64>,
    /// Motor velocities (n) [rad/s].
    pub dtheta: Vec<f64>,
    /// Torques from outside on the links (n) [N m]; empty where there are none.
    pub push: Vec<f64>,
    /// Numbers of varying wrenches from outside [N, N m]; empty where there are none.
    pub wrench: Vec<f64>,
    /// What the controller knew: q, q̇, θ, θ̇ (4 n).
    pub known: Vec<f64>,
    /// Tool centre point (3) [m]; empty without a tool.
    pub tool: Vec<f64>,
}

impl SimulatedRecording {
    /// # Errors
    /// [`DesignError::Memory`].
    pub(super) fn with_capacity(robot: &Robot, count: usize, channels: usize) -> Result<Self, DesignError> {
        let joints = || room(count, robot.len());
        Ok(Self {
            t: room(count, 1)?,
            readings: room(count, channels)?,
            tau: joints()?,
            q: joints()?,
            dq: joints()?,
            ddq: joints()?,
            theta: joints()?,
            dtheta: joints()?,
            push: Vec::new(),
            wrench: Vec::new(),
            known: room(count, 4 * robot.len())?,
            tool: room(if robot.tool.is_some() { count } else { 0 }, 3)?,
        })
    }
}
