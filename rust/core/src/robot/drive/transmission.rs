//! Spring and damper between a gear's output and the link: torsion, torque and slopes in motion.

use super::Drive;
use crate::scalar::Scalar;

/// Slopes of τ_e = φ(δ) + D δ̇, δ = θ + ε(θ) − q, in where motor and link are and how they move.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TransmissionSlopes<T> {
    pub(crate) by_theta: T,
    pub(crate) by_dtheta: T,
    pub(crate) by_q: T,
    pub(crate) by_dq: T,
}

impl Drive {
    /// δ = θ + ε(θ) − q [rad].
    #[inline(always)]
    pub(crate) fn torsion_between<T: Scalar>(&self, theta: T, q: T) -> T {
        if self.ripple.is_none() { theta - q } else { self.ripple.output(theta).angle - q }
    }

    /// δ̇ = (1 + ε′) θ̇ − q̇ [rad/s].
    #[inline(always)]
    pub(crate) fn slip<T: Scalar>(&self, theta: T, [dtheta, dq]: [T; 2]) -> T {
        if self.ripple.is_none() { dtheta - dq } else { self.ripple.output(theta).ratio * dtheta - dq }
    }

    /// See [`TransmissionSlopes`].
    #[inline(always)]
    pub(crate) fn transmission_slopes<T: Scalar>(&self, theta: T, dtheta: T, q: T) -> TransmissionSlopes<T> {
        let damping = T::constant(self.damping);
        if self.ripple.is_none() {
            let slope = self.tangent_stiffness(theta - q);
            return TransmissionSlopes { by_theta: slope, by_dtheta: damping, by_q: -slope, by_dq: -damping };
        }
        let gear = self.ripple.output(theta);
        let slope = self.tangent_stiffness(gear.angle - q);
        TransmissionSlopes {
            by_theta: slope * gear.ratio + damping * gear.bend * dtheta,
            by_dtheta: damping * gear.ratio,
            by_q: -slope,
            by_dq: -damping,
        }
    }
}
