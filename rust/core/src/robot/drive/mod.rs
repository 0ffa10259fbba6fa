//! What is between a motor and its link.

mod backlash;
mod curve;
mod friction;
mod hysteresis;
mod load_friction;
mod ripple;
mod soft_windup;
mod spring;
mod transmission;
mod wound;

pub use backlash::Backlash;
pub use curve::{Interpolation, SpringCurve};
pub use friction::Friction;
pub use hysteresis::{FrictionElement, Hysteresis, Moved};
pub use load_friction::{LoadFriction, Loss};
pub use ripple::{GearOutput, Harmonic, Ripple};
pub use soft_windup::SoftWindup;
pub(crate) use spring::SpringRates;
pub use wound::Wound;

use crate::check::expect_of;
use crate::error::RobotError;
use crate::scalar::Scalar;
use crate::simd::{self, Kernel};

/// A joint's drive, reflected through the gear to the link side.
///
/// Torques on link and motor are K δ + k₃ δ³ + soft wind-up + D δ̇ with the torsion δ = θ + ε(θ) − q, the motor's friction,
/// and the link's (Ulrich and Sasiadek 2011, eqs. (10)–(16)). Its law is smooth, so that derivatives exist at
/// standstill too.
///
/// ```
/// let robot = linkside_core::demo::arm()?;
/// let drive = &robot.drives[0];
/// assert_eq!(drive.spring_torque(0.01), 120.0);
/// assert_eq!(drive.torsion(120.0), 0.01); // and back
/// # Ok::<(), linkside_core::error::RobotError>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Drive {
    /// False when the link follows the motor rigidly.
    pub elastic: bool,
    /// K [N m/rad].
    pub stiffness: f64,
    /// D [N m s/rad].
    pub damping: f64,
    /// B [kg m²]; infinite where there is no motor: θ stays what it is, and the joint is [passive](Self::is_passive).
    pub motor_inertia: f64,
    /// Hardening of the spring [N m/rad³].
    pub cubic_stiffness: f64,
    /// Stiffness that is missing around zero torsion [N m/rad], and how sharply it returns [1/rad²].
    pub soft_windup: SoftWindup,
    /// The spring as points have it, in place of stiffness, hardening and wind-up; `stiffness` is then the one that designs
    /// take for it.
    pub curve: SpringCurve,
    /// Play before the spring.
    pub backlash: Backlash,
    /// Friction elements beside the spring, with states of their own; of elastic joints alone.
    pub hysteresis: Hysteresis,
    /// Kinematic error of the gear before both; of elastic joints alone.
    pub ripple: Ripple,
    /// Cycles a turn of θ of what the motor's encoder reads wrong by a phase that nobody knows.
    pub encoder_lines: Vec<f64>,
    /// Friction between motor and ground.
    pub motor_friction: Friction,
    /// What the gear takes of the torque that it transmits, on the motor's side; of elastic joints alone.
    pub gear_loss: LoadFriction,
    /// γ₁ … γ₆ of the link's friction (Ulrich and Sasiadek 2011, eq. (14)).
    pub link_friction: [f64; 6],
    /// Friction between the link and what carries it, beside that.
    pub bearing_friction: Friction,
    /// What of it grows with the torque that the transmission gives the link; likewise.
    pub bearing_loss: LoadFriction,
}

impl Drive {
    /// A linear spring K [N m/rad] and damper D [N m s/rad] behind a motor B [kg m²], and nothing else.
    pub fn spring(stiffness: f64, damping: f64, motor_inertia: f64) -> Self {
        Self {
            elastic: true,
            stiffness,
            damping,
            motor_inertia,
            cubic_stiffness: 0.0,
            soft_windup: SoftWindup::default(),
            curve: SpringCurve::default(),
            backlash: Backlash::default(),
            hysteresis: Hysteresis::default(),
            ripple: Ripple::default(),
            encoder_lines: Vec::new(),
            motor_friction: Friction::default(),
            gear_loss: LoadFriction::default(),
            link_friction: [0.0; 6],
            bearing_friction: Friction::default(),
            bearing_loss: LoadFriction::default(),
        }
    }

    /// Whether nothing drives the joint: a bearing, a link or a base that bends. Its spring is fixed at the other end.
    #[inline(always)]
    pub fn is_passive(&self) -> bool {
        self.motor_inertia == f64::INFINITY
    }

    /// A unit error of the motor's encoder at θ: the sine and the cosine of each of its lines, one after the other.
    #[inline(always)]
    pub(crate) fn encoder_line<T: Scalar>(&self, line: usize, theta: T) -> T {
        let frequency = self.encoder_lines.get(line / 2).copied().unwrap_or_default();
        let (sin, cos) = (theta * frequency).sin_cos();
        if line.is_multiple_of(2) { sin } else { cos }
    }

    /// # Errors
    /// A number that is not finite, and of an elastic joint a stiffness or motor inertia that is not positive, or a
    /// negative damping.
    pub(crate) fn check(&self, owner: &str) -> Result<(), RobotError> {
        let owner = || owner.to_string();
        let SoftWindup { stiffness, shape } = self.soft_windup;
        let finite = [
            ("stiffness", self.stiffness),
            ("damping", self.damping),
            ("motor inertia", if self.elastic && self.is_passive() { 1.0 } else { self.motor_inertia }),
            ("cubic stiffness", self.cubic_stiffness),
            ("soft wind-up's stiffness", stiffness),
            ("soft wind-up's shape", shape),
        ];
        let friction = self.link_friction.iter().map(|&g| ("link friction", g));
        let lines = self.encoder_lines.iter().map(|&cycles| ("line of the encoder", cycles));
        for (what, value) in finite.into_iter().chain(friction).chain(lines) {
            expect_of(value.is_finite(), what, owner, value, "a finite number")?;
        }
        self.motor_friction.check(&owner())?;
        self.gear_loss.check(&owner())?;
        self.bearing_friction.check(&owner())?;
        self.bearing_loss.check(&owner())?;
        let LoadFriction { driving, driven, .. } = self.bearing_loss;
        expect_of(driving == driven, "load friction of the bearing", owner, driving, "the same both ways")?;
        if self.elastic {
            expect_of(self.stiffness > 0.0, "stiffness", owner, self.stiffness, "greater than 0")?;
            expect_of(self.motor_inertia > 0.0, "motor inertia", owner, self.motor_inertia, "greater than 0")?;
            expect_of(self.damping >= 0.0, "damping", owner, self.damping, "at least 0")?;
            let (cubic, rising) = (self.cubic_stiffness, "greater than 0: the spring's torque must rise with torsion");
            expect_of(cubic >= 0.0, "cubic stiffness", owner, cubic, "at least 0")?;
            expect_of(shape >= 0.0, "soft wind-up's shape", owner, shape, "at least 0")?;
            let least = self.soft_windup.least_slope(self.stiffness, cubic);
            expect_of(least > 0.0, "least tangent stiffness", owner, least, rising)?;
            self.backlash.check(&owner())?;
        }
        let none = "none, as the joint is rigid";
        for (what, absent) in [
            ("ripple", self.ripple.is_none()),
            ("hysteresis", self.hysteresis.is_none()),
            ("load friction", self.gear_loss.is_none() && self.bearing_loss.is_none()),
        ] {
            expect_of(absent || self.elastic, what, owner, 1.0, none)?;
        }
        self.hysteresis.check(&owner())?;
        self.ripple.check(&owner())
    }

    /// Friction torque of the link at speed `v` [rad/s], and its slope [N m, N m s/rad]:
    /// γ₁(tanh γ₂v − tanh γ₃v) + γ₄ tanh γ₅v + γ₆v (Ulrich and Sasiadek 2011, eq. (14)), and that of its bearing without load.
    #[inline(always)]
    pub fn link_friction<T: Scalar>(&self, v: T) -> (T, T) {
        let own = self.fitted_friction(v);
        if self.bearing_friction.is_none() {
            return own;
        }
        let (torque, slope) = self.bearing_friction.torque(v);
        (own.0 + torque, own.1 + slope)
    }

    /// All friction of the link at speed `v` where nothing else takes `rest` [N m], with its slopes by both.
    #[inline(always)]
    pub(crate) fn link_friction_beside<T: Scalar>(&self, v: T, rest: T) -> Loss<T> {
        let (torque, by_speed) = self.link_friction(v);
        if self.bearing_loss.is_none() {
            return Loss { torque, by_speed, by_load: T::default() };
        }
        let loss = self.bearing_loss.loss_beside(v, rest + torque);
        // Of the rest with the other friction.
        let gain = loss.by_load + 1.0;
        Loss { torque: torque + loss.torque, by_speed: by_speed * gain + loss.by_speed, by_load: loss.by_load }
    }

    #[inline(always)]
    fn fitted_friction<T: Scalar>(&self, v: T) -> (T, T) {
        let [g1, .., g4, _, g6] = self.link_friction;
        if g1 == 0.0 && g4 == 0.0 {
            return (v * g6, T::constant(g6));
        }
        simd::phase(LinkFriction { law: &self.link_friction, v })
    }

    /// Friction torque of the motor at speed `v` [rad/s] without load, and its slope [N m, N m s/rad].
    #[inline(always)]
    pub fn motor_friction<T: Scalar>(&self, v: T) -> (T, T) {
        self.motor_friction.torque(v)
    }

    /// Slope of [`dry_friction`](Self::dry_friction) at speed `v` [rad/s] [N m s/rad].
    #[inline(always)]
    pub fn dry_friction_slope<T: Scalar>(&self, v: T) -> T {
        self.motor_friction.dry(v).1
    }

    /// Dry friction of the motor at speed `v` [rad/s] [N m].
    #[inline(always)]
    pub fn dry_friction<T: Scalar>(&self, v: T) -> T {
        self.motor_friction.dry(v).0
    }
}

/// Friction of a link that is not viscous alone; a function of its own, as many rows ask for it.
struct LinkFriction<'a, T> {
    law: &'a [f64; 6],
    v: T,
}

impl<T: Scalar> Kernel for LinkFriction<'_, T> {
    type Output = (T, T);
    const LANES: bool = T::LANES;

    #[inline(always)]
    fn run(self) -> (T, T) {
        let Self { law: &[g1, g2, g3, g4, g5, g6], v } = self;
        let [a, b, c] = [g2, g3, g5].map(|g| (v * g).tanh());
        let bell = |t: T| -(t * t) + 1.0;
        let slope = (bell(a) * g2 - bell(b) * g3) * g1 + bell(c) * (g4 * g5) + g6;
        ((a - b) * g1 + c * g4 + v * g6, slope)
    }
}

#[cfg(test)]
mod tests;
