//! Friction between a motor and the ground.

use crate::scalar::Scalar;

/// Below this speed dry friction fades out [rad/s]: an encoder or an estimate cannot tell the direction of so slow a motion.
const CREEP: f64 = 2e-3;

/// Friction torque of a motor: viscous, and dry with a breakaway peak (Stribeck),
/// F_v v + (F_c + F_s e^{−(v/v_s)²}) v/√(v² + ε²), ε = 2 mrad/s.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MotorFriction {
    /// F_v [N m s/rad].
    pub viscous: f64,
    /// F_c [N m].
    pub coulomb: f64,
    /// F_s, by how much breaking away takes more than F_c [N m].
    pub stribeck: f64,
    /// v_s, the speed at which that is gone but for 1/e [rad/s].
    pub stribeck_velocity: f64,
}

impl MotorFriction {
    /// Torque and its slope at speed `v` [rad/s] [N m, N m s/rad].
    #[inline(always)]
    pub fn torque<T: Scalar>(&self, v: T) -> (T, T) {
        let (dry, slope) = self.dry(v);
        (v * self.viscous + dry, slope + self.viscous)
    }

    /// What of it is dry, and its slope.
    #[inline(always)]
    pub fn dry<T: Scalar>(&self, v: T) -> (T, T) {
        if self.coulomb == 0.0 && self.stribeck == 0.0 {
            return (T::default(), T::default());
        }
        let square = v * v + CREEP * CREEP;
        let direction = v / square.sqrt();
        let turning = T::constant(CREEP * CREEP) / (square * square.sqrt());
        let (level, rise) = self.level(v);
        (level * direction, level * turning + rise * direction)
    }

    /// F_c + F_s e^{−(v/v_s)²}, and its slope.
    #[inline(always)]
    fn level<T: Scalar>(&self, v: T) -> (T, T) {
        if self.stribeck == 0.0 {
            return (T::constant(self.coulomb), T::default());
        }
        let inverse = 1.0 / self.stribeck_velocity;
        let x = v * inverse;
        let peak = (-(x * x)).exp() * self.stribeck;
        (peak + self.coulomb, x * peak * (-2.0 * inverse))
    }
}
