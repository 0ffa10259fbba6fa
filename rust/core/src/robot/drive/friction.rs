//! Friction of a motor, or of the bearing of a link.

use crate::check::expect_of;
use crate::error::RobotError;
use crate::scalar::Scalar;

/// Below this speed dry friction fades out [rad/s]: an encoder or an estimate cannot tell the direction of so slow a motion.
const CREEP: f64 = 2e-3;

/// Friction torque at a speed v: viscous, and dry with a breakaway peak (Stribeck), perhaps not the same in both directions,
/// F_v v + (F_c + F_s e^{−(v/v_s)²}) s + F_a s², s = v/√(v² + ε²), ε = 2 mrad/s.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Friction {
    /// F_v [N m s/rad].
    pub viscous: f64,
    /// F_c [N m].
    pub coulomb: f64,
    /// F_s, by how much breaking away takes more than F_c [N m].
    pub stribeck: f64,
    /// v_s, the speed at which that is gone but for 1/e [rad/s].
    pub stribeck_velocity: f64,
    /// F_a, by how much dry friction is more than F_c forwards, and less backwards [N m].
    pub asymmetry: f64,
}

/// Which way it turns, −1 to 1, and the slope of that by the speed.
#[inline(always)]
pub(super) fn direction<T: Scalar>(v: T) -> (T, T) {
    let square = v * v + CREEP * CREEP;
    (v / square.sqrt(), T::constant(CREEP * CREEP) / (square * square.sqrt()))
}

impl Friction {
    /// # Errors
    /// A number that is not finite, a Stribeck speed of none, more asymmetry than friction.
    pub(super) fn check(&self, owner: &str) -> Result<(), RobotError> {
        let Self { viscous, coulomb, stribeck, stribeck_velocity, asymmetry } = *self;
        let owner = || owner.to_string();
        for (what, value) in [
            ("viscous friction", viscous),
            ("dry friction", coulomb),
            ("Stribeck friction", stribeck),
            ("Stribeck velocity", stribeck_velocity),
            ("asymmetry of dry friction", asymmetry),
        ] {
            expect_of(value.is_finite(), what, owner, value, "a finite number")?;
        }
        let fades = stribeck == 0.0 || stribeck_velocity > 0.0;
        expect_of(fades, "Stribeck velocity", owner, stribeck_velocity, "greater than 0")?;
        let fine = asymmetry == 0.0 || asymmetry.abs() <= coulomb;
        expect_of(fine, "asymmetry of dry friction", owner, asymmetry, "at most that friction itself")
    }

    /// Whether there is none.
    #[inline(always)]
    pub fn is_none(&self) -> bool {
        self.viscous == 0.0 && self.coulomb == 0.0 && self.stribeck == 0.0
    }

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
        let (direction, turning) = direction(v);
        let (level, rise) = self.level(v);
        let dry = (level * direction, level * turning + rise * direction);
        if self.asymmetry == 0.0 {
            return dry;
        }
        let more = direction * self.asymmetry;
        (dry.0 + more * direction, dry.1 + (more + more) * turning)
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
