//! The robot as a differential equation ẋ = f(x, τ).

use crate::dynamics::{ElasticDynamics, ElasticLayout};
use crate::robot::Robot;

/// Dynamics of a robot with room to compute them in; what integrators share.
#[derive(Clone, Debug)]
pub struct Plant {
    /// Where in a state each joint's numbers are.
    pub layout: ElasticLayout,
    /// Accelerations, and after a look their derivatives.
    pub dynamics: ElasticDynamics,
}

impl Plant {
    /// Room for `robot`.
    pub fn new(robot: &Robot) -> Self {
        Self::pushed(robot, false)
    }

    /// The same, with a torque from outside on each link in the state if `pushed`; it stays as it is.
    pub fn pushed(robot: &Robot, pushed: bool) -> Self {
        let mut layout = ElasticLayout::new(robot, false);
        if pushed {
            layout = layout.with_link_disturbances(f64::INFINITY);
        }
        Self { dynamics: ElasticDynamics::new(robot, &layout), layout }
    }

    /// f(x, τ) at `x` (dense) under motor torques `tau` (n) [N m], into `out` (dense); NaN when the inertia is not
    /// positive definite.
    #[inline(always)]
    pub fn rate_into(&mut self, robot: &Robot, x: &[f64], tau: &[f64], out: &mut [f64]) {
        self.dynamics.accelerate(robot, &self.layout, x, tau);
        self.dynamics.rate_into(robot, &self.layout, x, out);
    }

    /// As [`rate_into`](Self::rate_into), with the derivatives of the accelerations in [`dynamics`](Self::dynamics).
    #[inline(always)]
    pub fn linearise_into(&mut self, robot: &Robot, x: &[f64], tau: &[f64], out: &mut [f64]) {
        self.rate_into(robot, x, tau, out);
        self.dynamics.differentiate(robot, &self.layout, x);
    }
}
