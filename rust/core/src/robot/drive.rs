//! What is between a motor and its link.

use super::expect;
use crate::error::RobotError;

/// A joint's drive, reflected through the gear to the link side.
#[derive(Clone, Debug, PartialEq)]
pub struct Drive {
    /// False when the link follows the motor rigidly.
    pub elastic: bool,
    /// K [N m/rad].
    pub stiffness: f64,
    /// D [N m s/rad].
    pub damping: f64,
    /// B [kg m²].
    pub motor_inertia: f64,
    /// Hardening of the spring [N m/rad³].
    pub cubic_stiffness: f64,
    /// Stiffness that is missing around zero torsion [N m/rad], and how sharply it returns [1/rad²].
    pub soft_windup: SoftWindup,
    /// Friction between motor and ground.
    pub motor_friction: MotorFriction,
    /// γ₁ … γ₆ of the link's friction (Ulrich and Sasiadek 2011, eq. (14)).
    pub link_friction: [f64; 6],
}

/// Soft wind-up of a harmonic drive: −k·exp(−a δ²)·δ (Ulrich and Sasiadek 2011, eqs. (10)–(13)).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SoftWindup {
    /// k [N m/rad].
    pub stiffness: f64,
    /// a [1/rad²].
    pub shape: f64,
}

/// Friction torque of a motor.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MotorFriction {
    /// [N m s/rad].
    pub viscous: f64,
    /// [N m].
    pub coulomb: f64,
}

/// Below this speed dry friction fades out [rad/s]: an encoder or an estimate cannot tell the direction of so slow a motion.
const CREEP: f64 = 2e-3;

impl Drive {
    /// # Errors
    /// A number that is not finite, and of an elastic joint a stiffness or motor inertia that is not positive, or a
    /// negative damping.
    pub(crate) fn check(&self, owner: &str) -> Result<(), RobotError> {
        let owner = || owner.to_string();
        let SoftWindup { stiffness, shape } = self.soft_windup;
        let MotorFriction { viscous, coulomb } = self.motor_friction;
        let finite = [
            ("stiffness", self.stiffness),
            ("damping", self.damping),
            ("motor inertia", self.motor_inertia),
            ("cubic stiffness", self.cubic_stiffness),
            ("soft wind-up's stiffness", stiffness),
            ("soft wind-up's shape", shape),
            ("viscous motor friction", viscous),
            ("dry motor friction", coulomb),
        ];
        let friction = self.link_friction.iter().map(|&g| ("link friction", g));
        for (what, value) in finite.into_iter().chain(friction) {
            expect(value.is_finite(), what, owner, value, "a finite number")?;
        }
        if self.elastic {
            expect(self.stiffness > 0.0, "stiffness", owner, self.stiffness, "greater than 0")?;
            expect(self.motor_inertia > 0.0, "motor inertia", owner, self.motor_inertia, "greater than 0")?;
            expect(self.damping >= 0.0, "damping", owner, self.damping, "at least 0")?;
        }
        Ok(())
    }

    /// What the spring's torque has beyond K δ, at torsion δ [rad] [N m].
    #[inline(always)]
    pub fn nonlinear_torque(&self, torsion: f64) -> f64 {
        let square = torsion * torsion;
        let missing = match self.soft_windup {
            SoftWindup { stiffness: 0.0, .. } => 0.0,
            SoftWindup { stiffness, shape } => stiffness * (-shape * square).exp(),
        };
        (self.cubic_stiffness * square - missing) * torsion
    }

    /// Slope of the spring's torque at torsion δ [rad] [N m/rad].
    pub fn tangent_stiffness(&self, torsion: f64) -> f64 {
        let square = torsion * torsion;
        let SoftWindup { stiffness, shape } = self.soft_windup;
        self.stiffness + 3.0 * self.cubic_stiffness * square
            - stiffness * (-shape * square).exp() * (1.0 - 2.0 * shape * square)
    }

    /// Torsion at which the spring holds `torque` [N m]; Newton's method, as the spring is monotone [rad].
    #[inline(always)]
    pub fn torsion(&self, torque: f64) -> f64 {
        let mut torsion = torque / self.stiffness;
        if self.cubic_stiffness == 0.0 && self.soft_windup.stiffness == 0.0 {
            return torsion;
        }
        for _ in 0..50 {
            let excess = self.stiffness * torsion + self.nonlinear_torque(torsion) - torque;
            let step = excess / self.tangent_stiffness(torsion);
            torsion -= step;
            if step.abs() <= 1e-16 * torsion.abs() {
                break;
            }
        }
        torsion
    }

    /// Friction torque of the link at speed `v` [rad/s], and its slope [N m, N m s/rad]:
    /// γ₁(tanh γ₂v − tanh γ₃v) + γ₄ tanh γ₅v + γ₆v (Ulrich and Sasiadek 2011, eq. (14)).
    #[inline(always)]
    pub fn link_friction(&self, v: f64) -> (f64, f64) {
        let [g1, g2, g3, g4, g5, g6] = self.link_friction;
        if g1 == 0.0 && g4 == 0.0 {
            return (g6 * v, g6);
        }
        let [a, b, c] = [g2, g3, g5].map(|g| (g * v).tanh());
        let bell = |t: f64| 1.0 - t * t;
        let slope = g1 * (g2 * bell(a) - g3 * bell(b)) + g4 * g5 * bell(c) + g6;
        (g1 * (a - b) + g4 * c + g6 * v, slope)
    }

    /// Dry friction of the motor at speed `velocity` [rad/s] [N m].
    #[inline(always)]
    pub fn dry_friction(&self, velocity: f64) -> f64 {
        match self.motor_friction.coulomb {
            0.0 => 0.0,
            coulomb => coulomb * velocity / (velocity * velocity + CREEP * CREEP).sqrt(),
        }
    }
}
