//! What is between a motor and its link.

use super::expect;
use crate::error::RobotError;
use crate::scalar::Scalar;

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
    pub fn nonlinear_torque<T: Scalar>(&self, torsion: T) -> T {
        let square = torsion * torsion;
        let mut stiffness = square * self.cubic_stiffness;
        if self.soft_windup.stiffness != 0.0 {
            stiffness -= (square * -self.soft_windup.shape).exp() * self.soft_windup.stiffness;
        }
        stiffness * torsion
    }

    /// Torque of the spring at torsion δ [rad] [N m].
    #[inline(always)]
    pub fn spring_torque<T: Scalar>(&self, torsion: T) -> T {
        torsion * self.stiffness + self.nonlinear_torque(torsion)
    }

    /// Slope of the spring's torque at torsion δ [rad] [N m/rad].
    #[inline(always)]
    pub fn tangent_stiffness<T: Scalar>(&self, torsion: T) -> T {
        let square = torsion * torsion;
        let mut slope = square * (3.0 * self.cubic_stiffness) + self.stiffness;
        let SoftWindup { stiffness, shape } = self.soft_windup;
        if stiffness != 0.0 {
            slope -= (square * -shape).exp() * (square * (-2.0 * shape) + 1.0) * stiffness;
        }
        slope
    }

    /// Torsion at which the spring holds `torque` [N m] [rad].
    #[inline(always)]
    pub fn torsion<T: Scalar>(&self, torque: T) -> T {
        if self.is_linear() {
            return torque * (1.0 / self.stiffness);
        }
        // One more step of Newton's method from the solution gives a derivative number its slope.
        let solution = torque.map(|t| self.solve(t));
        solution + (torque - self.spring_torque(solution)) / self.tangent_stiffness(solution)
    }

    /// Whether the spring's torque is K δ.
    #[inline(always)]
    pub fn is_linear(&self) -> bool {
        self.cubic_stiffness == 0.0 && self.soft_windup.stiffness == 0.0
    }

    /// Newton's method, as the spring is monotone.
    fn solve(&self, torque: f64) -> f64 {
        let mut torsion = torque / self.stiffness;
        for _ in 0..50 {
            let step = (self.spring_torque(torsion) - torque) / self.tangent_stiffness(torsion);
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
    pub fn link_friction<T: Scalar>(&self, v: T) -> (T, T) {
        let [g1, g2, g3, g4, g5, g6] = self.link_friction;
        if g1 == 0.0 && g4 == 0.0 {
            return (v * g6, T::constant(g6));
        }
        let [a, b, c] = [g2, g3, g5].map(|g| (v * g).tanh());
        let bell = |t: T| -(t * t) + 1.0;
        let slope = (bell(a) * g2 - bell(b) * g3) * g1 + bell(c) * (g4 * g5) + g6;
        ((a - b) * g1 + c * g4 + v * g6, slope)
    }

    /// Slope of [`dry_friction`](Self::dry_friction) at speed `v` [rad/s] [N m s/rad].
    #[inline(always)]
    pub fn dry_friction_slope<T: Scalar>(&self, v: T) -> T {
        match self.motor_friction.coulomb {
            0.0 => T::default(),
            coulomb => {
                let square = v * v + CREEP * CREEP;
                T::constant(coulomb * CREEP * CREEP) / (square * square.sqrt())
            }
        }
    }

    /// Dry friction of the motor at speed `v` [rad/s] [N m].
    #[inline(always)]
    pub fn dry_friction<T: Scalar>(&self, v: T) -> T {
        match self.motor_friction.coulomb {
            0.0 => T::default(),
            coulomb => v * coulomb / (v * v + CREEP * CREEP).sqrt(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scalar::{Dual, Lanes};

    fn drive() -> Drive {
        Drive {
            elastic: true,
            stiffness: 500.0,
            damping: 1.0,
            motor_inertia: 1.0,
            cubic_stiffness: 3e4,
            soft_windup: SoftWindup { stiffness: 120.0, shape: 800.0 },
            motor_friction: MotorFriction { viscous: 0.1, coulomb: 2.0 },
            link_friction: [0.5, 150.0, 50.0, 2.0, 100.0, 0.5],
        }
    }

    #[test]
    fn slopes_are_the_derivatives_of_the_laws() {
        let d = drive();
        for x in [-0.3, -0.01, 0.0, 1e-3, 0.2] {
            let v = Dual::<1>::variable(x, 0);
            let near = |a: f64, b: f64| assert!((a - b).abs() <= 1e-13 * (1.0 + a.abs()), "{x}: {a} {b}");
            near(d.spring_torque(v).gradient[0], d.tangent_stiffness(x));
            near(d.link_friction(v).0.gradient[0], d.link_friction(x).1);
            near(d.dry_friction(v).gradient[0], d.dry_friction_slope(x));
            let torque = d.spring_torque(v);
            near(d.torsion(torque).value, x);
            near(d.torsion(torque).gradient[0], 1.0);
        }
    }

    #[test]
    fn lanes_hold_the_bits_of_one_number() {
        let (d, x) = (drive(), [-0.3, -0.001, 0.02, 0.7]);
        let v = Lanes(x);
        for i in 0..4 {
            assert_eq!(d.torsion(v).0[i], d.torsion(x[i]));
            assert_eq!(d.link_friction(v).0.0[i], d.link_friction(x[i]).0);
            assert_eq!(d.dry_friction(v).0[i], d.dry_friction(x[i]));
        }
    }
}
