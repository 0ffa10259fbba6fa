//! What is given: a recording with all signals that bear on a robot's parameters.

use crate::check::{expect, expect_at_least, expect_length, expect_rising};
use crate::error::DesignError;
use crate::robot::Robot;

/// A recording, row-major, one row a sample; NaN where a reading is missing.
#[derive(Clone, Debug)]
pub struct LikelihoodRecording {
    /// Times [s].
    pub t: Vec<f64>,
    /// Motor positions (n) [rad].
    pub theta: Vec<f64>,
    /// Motor velocities (n) [rad/s], NaN to leave the damping torque out.
    pub dtheta: Vec<f64>,
    /// Accelerometer channels as they were recorded (m) [m/s²].
    pub acceleration: Vec<f64>,
    /// Commanded jerk since the sample before (n) [rad/s³].
    pub jerk: Vec<f64>,
    /// Median step of time [s].
    pub period: f64,
}

impl LikelihoodRecording {
    /// Number of samples.
    pub fn len(&self) -> usize {
        self.t.len()
    }

    /// Whether there is no sample.
    pub fn is_empty(&self) -> bool {
        self.t.is_empty()
    }

    /// # Errors
    /// Arrays that do not fit the robot or each other, a first sample without a motor position.
    pub(super) fn check(&self, robot: &Robot) -> Result<(), DesignError> {
        let (n, m, count) = (robot.len(), robot.acceleration_channels(), self.len());
        let lengths = [
            ("theta", &self.theta, n),
            ("dtheta", &self.dtheta, n),
            ("acceleration", &self.acceleration, m),
            ("jerk", &self.jerk, n),
        ];
        for (what, values, width) in lengths {
            expect_length(what, values.len(), count * width)?;
        }
        expect_at_least("t", count, 2)?;
        expect_rising("t", &self.t)?;
        expect(self.period > 0.0, "period", self.period, "a time greater than 0")?;
        match self.theta[..n].iter().position(|x| x.is_nan()) {
            Some(joint) => Err(DesignError::NoStart { joint }),
            None => Ok(()),
        }
    }
}
