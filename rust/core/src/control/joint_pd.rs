//! Proportional and derivative control of each motor.

use super::{Controller, Reference, Refused, RobotState};
use crate::check::{expect_finite, expect_length};
use crate::error::DesignError;

/// τ = τ₀ + K_p (θ_ref − θ) + K_d (θ̇_ref − θ̇), joint by joint: the yardstick of everything cleverer.
#[derive(Clone, Debug)]
pub struct JointPd {
    /// θ wanted in time.
    reference: Reference,
    /// K_p, K_d and τ₀ (n each).
    proportional: Vec<f64>,
    derivative: Vec<f64>,
    constant: Vec<f64>,
}

impl JointPd {
    /// Gains K_p [N m/rad] and K_d [N m s/rad] and τ₀ [N m], n each, such as gravity's torque where the robot is.
    ///
    /// # Errors
    /// Numbers that are not finite, not one a joint.
    pub fn new(
        reference: Reference,
        proportional: Vec<f64>,
        derivative: Vec<f64>,
        constant: Vec<f64>,
    ) -> Result<Self, DesignError> {
        let expected = reference.width();
        for (what, values) in [("kp", &proportional), ("kd", &derivative), ("tau", &constant)] {
            expect_length(what, values.len(), expected)?;
            expect_finite(what, values)?;
        }
        Ok(Self { reference, proportional, derivative, constant })
    }
}

impl Controller for JointPd {
    #[inline(always)]
    fn torque(&mut self, t: f64, state: &RobotState, out: &mut [f64]) -> Result<(), Refused> {
        let Self { reference, proportional, derivative, constant } = self;
        reference.at(t, |j, position, velocity| {
            let (off, slow) = (position - state.theta[j], velocity - state.dtheta[j]);
            out[j] = constant[j] + proportional[j] * off + derivative[j] * slow;
        });
        Ok(())
    }
}
