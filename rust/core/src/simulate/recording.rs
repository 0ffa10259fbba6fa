//! What is kept of a run.

/// Log and truth of a run, row-major, one row a kept sample.
#[derive(Clone, Debug, Default)]
pub struct Recording {
    /// Time [s].
    pub t: Vec<f64>,
    /// Readings in the order of [`Kind::ALL`](crate::estimate::measurement::Kind::ALL).
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
    /// What the controller was told: q, q̇, θ, θ̇ (4 n).
    pub told: Vec<f64>,
    /// Tool centre point (3) [m]; empty without a tool.
    pub tool: Vec<f64>,
}
