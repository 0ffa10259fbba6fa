//! What is between a motor and its link.

mod backlash;
mod curve;
mod friction;
mod hysteresis;
mod load_friction;
mod ripple;
mod soft_windup;
mod transmission;

pub use backlash::Backlash;
pub use curve::{Interpolation, SpringCurve};
pub use friction::Friction;
pub use hysteresis::{FrictionElement, Hysteresis, Moved, Wound};
pub use load_friction::{LoadFriction, Loss};
pub use ripple::{GearOutput, Harmonic, Ripple};
pub use soft_windup::SoftWindup;

use crate::check::expect_of;
use crate::error::RobotError;
use crate::scalar::Scalar;
use crate::simd::{self, Kernel};
use core::ops::{Add, Mul};

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

/// What of a spring can be freed, plain or with derivatives.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SpringRates<C> {
    /// K [N m/rad].
    pub(crate) stiffness: C,
    /// [N m/rad³].
    pub(crate) cubic: C,
}

/// A number that constants of type `C` scale and add to: plain ones do to every number, so that only what has derivatives
/// pays for them.
pub(crate) trait Over<C>: Scalar + Mul<C, Output = Self> + Add<C, Output = Self> {}

impl<C, T: Scalar + Mul<C, Output = T> + Add<C, Output = T>> Over<C> for T {}

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

    /// What the spring's torque has beyond K δ, at torsion δ [rad] [N m].
    #[inline(always)]
    pub fn nonlinear_torque<T: Scalar>(&self, torsion: T) -> T {
        if self.curve.is_none() && self.backlash.is_none() {
            return self.bend(self.cubic_stiffness, torsion);
        }
        self.spring_torque(torsion) - torsion * self.stiffness
    }

    /// Torque of the spring at torsion δ [rad] [N m].
    #[inline(always)]
    pub fn spring_torque<T: Scalar>(&self, torsion: T) -> T {
        self.engaged_torque(self.rates(), self.backlash.engaged(torsion))
    }

    /// Slope of the spring's torque at torsion δ [rad] [N m/rad].
    #[inline(always)]
    pub fn tangent_stiffness<T: Scalar>(&self, torsion: T) -> T {
        self.slope(self.rates(), torsion)
    }

    #[inline(always)]
    fn rates(&self) -> SpringRates<f64> {
        SpringRates { stiffness: self.stiffness, cubic: self.cubic_stiffness }
    }

    /// Torque beyond K z of hardening and wind-up at torsion z, behind the play.
    #[inline(always)]
    fn bend<C, T: Over<C>>(&self, cubic: C, engaged: T) -> T {
        let square = engaged * engaged;
        (square * cubic + self.soft_windup.secant(square)) * engaged
    }

    /// Torque of the spring at torsion z, behind the play.
    #[inline(always)]
    fn engaged_torque<C: Copy, T: Over<C>>(&self, rates: SpringRates<C>, engaged: T) -> T {
        if !self.curve.is_none() {
            return self.curve.torque(engaged);
        }
        engaged * rates.stiffness + self.bend(rates.cubic, engaged)
    }

    /// Its slope there.
    #[inline(always)]
    fn engaged_slope<C: Copy + Mul<f64, Output = C>, T: Over<C>>(&self, rates: SpringRates<C>, engaged: T) -> T {
        if !self.curve.is_none() {
            return self.curve.slope(engaged);
        }
        let square = engaged * engaged;
        square * (rates.cubic * 3.0) + rates.stiffness + self.soft_windup.tangent(square)
    }

    /// Slope of the spring's torque at torsion δ, play included.
    #[inline(always)]
    fn slope<C: Copy + Mul<f64, Output = C>, T: Over<C>>(&self, rates: SpringRates<C>, torsion: T) -> T {
        let slope = self.engaged_slope(rates, self.backlash.engaged(torsion));
        if self.backlash.is_none() { slope } else { slope * self.backlash.engagement(torsion) }
    }

    /// What the spring's torque gains where its hardening is greater by 1 N m/rad³, at torsion δ [rad] [rad³].
    #[inline(always)]
    pub(crate) fn hardening<T: Scalar>(&self, torsion: T) -> T {
        let engaged = self.backlash.engaged(torsion);
        engaged * engaged * engaged
    }

    /// Torsion at which the spring holds `torque` [rad], and one over its slope there [rad/(N m)], with the derivatives of
    /// `rates`, whose values are the drive's own.
    #[inline(always)]
    pub(crate) fn twist<C: Copy + Mul<f64, Output = C>, T: Over<C>>(&self, rates: SpringRates<C>, torque: T) -> (T, T) {
        // One step of Newton's method from the solution gives a derivative number its slopes.
        let solution = torque.map(|t| self.solve(t));
        let force = self.engaged_torque(rates, self.backlash.engaged(solution));
        let torsion = solution + (torque - force) / self.slope(rates, solution);
        (torsion, T::constant(1.0) / self.slope(rates, torsion))
    }

    /// One over the slope of the spring's torque at torsion δ [rad] [rad/(N m)].
    #[inline(always)]
    pub(crate) fn compliance<T: Scalar>(&self, torsion: T) -> T {
        if self.is_linear() {
            return T::constant(1.0 / self.stiffness);
        }
        T::constant(1.0) / self.tangent_stiffness(torsion)
    }

    /// Torsion at which the spring holds `torque` [N m] [rad].
    #[inline(always)]
    pub fn torsion<T: Scalar>(&self, torque: T) -> T {
        if self.is_linear() {
            return torque * (1.0 / self.stiffness);
        }
        simd::phase(Torsion { drive: self, torque })
    }

    /// Whether the spring's torque is K δ.
    #[inline(always)]
    pub fn is_linear(&self) -> bool {
        let straight = self.curve.is_none() && self.backlash.is_none();
        straight && self.cubic_stiffness == 0.0 && self.soft_windup.stiffness == 0.0
    }

    fn solve(&self, torque: f64) -> f64 {
        let engaged = if self.curve.is_none() { self.solve_engaged(torque) } else { self.curve.torsion(torque) };
        self.backlash.torsion(engaged)
    }

    /// Newton's method, as the spring is monotone.
    fn solve_engaged(&self, torque: f64) -> f64 {
        let (rates, mut torsion) = (self.rates(), torque / self.stiffness);
        for _ in 0..50 {
            let step = (self.engaged_torque(rates, torsion) - torque) / self.engaged_slope(rates, torsion);
            torsion -= step;
            if step.abs() <= 1e-16 * torsion.abs() {
                break;
            }
        }
        torsion
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

/// The torsion of a spring that is not linear; a function of its own, as many rows of sensors ask for it.
struct Torsion<'a, T> {
    drive: &'a Drive,
    torque: T,
}

impl<T: Scalar> Kernel for Torsion<'_, T> {
    type Output = T;
    const LANES: bool = T::LANES;

    #[inline(always)]
    fn run(self) -> T {
        let Self { drive, torque } = self;
        // One more step of Newton's method from the solution gives a derivative number its slope.
        let solution = torque.map(|t| drive.solve(t));
        solution + (torque - drive.spring_torque(solution)) / drive.tangent_stiffness(solution)
    }
}

/// Friction of a link that is not viscous alone, likewise.
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
mod tests {
    use super::*;
    use crate::scalar::{Dual, Lanes};

    fn drive() -> Drive {
        Drive {
            cubic_stiffness: 3e4,
            soft_windup: SoftWindup { stiffness: 120.0, shape: 800.0 },
            motor_friction: Friction {
                viscous: 0.1,
                coulomb: 2.0,
                stribeck: 1.5,
                stribeck_velocity: 0.05,
                asymmetry: -0.7,
            },
            link_friction: [0.5, 150.0, 50.0, 2.0, 100.0, 0.5],
            bearing_friction: Friction { viscous: 0.3, coulomb: 1.0, asymmetry: 0.2, ..Friction::default() },
            ..Drive::spring(500.0, 1.0, 1.0)
        }
    }

    /// Drives with every law of a spring.
    fn drives() -> [Drive; 4] {
        let backlash = Backlash { half_gap: 2e-3, slope: 0.02, rounding: 3e-4 };
        let curve = SpringCurve::new(&[[0.01, 6.0], [0.1, 90.0]], Interpolation::Monotone).unwrap();
        let table = Drive { curve, ..drive() };
        [drive(), Drive { backlash, ..drive() }, table.clone(), Drive { backlash, ..table }]
    }

    #[test]
    fn slopes_are_the_derivatives_of_the_laws() {
        for (d, x) in drives().iter().flat_map(|d| [-0.3, -0.01, 0.0, 1e-3, 0.2].map(|x| (d, x))) {
            let v = Dual::<1>::variable(x, 0);
            let near = |a: f64, b: f64| assert!((a - b).abs() <= 1e-12 * (1.0 + a.abs()), "{x}: {a} {b}");
            near(d.spring_torque(v).gradient[0], d.tangent_stiffness(x));
            near(d.link_friction(v).0.gradient[0], d.link_friction(x).1);
            near(d.motor_friction(v).0.gradient[0], d.motor_friction(x).1);
            near(d.nonlinear_torque(x) + d.stiffness * x, d.spring_torque(x));
            let torque = d.spring_torque(v);
            near(d.torsion(torque).value, x);
            near(d.torsion(torque).gradient[0], 1.0);
        }
    }

    /// Rates with derivatives give torsions with those: δ(K, c, τ) of φ(δ; K, c) = τ has δ_K = −φ_K/φ′.
    #[test]
    fn torsions_have_the_derivatives_of_rates() {
        for (d, x) in drives()[..2].iter().flat_map(|d| [-0.3, 1e-3, 0.05].map(|x| (d, x))) {
            let rates = SpringRates { stiffness: Dual::<3>::variable(d.stiffness, 0), cubic: Dual::variable(3e4, 1) };
            let (torsion, compliance) = d.twist(rates, Dual::variable(d.spring_torque(x), 2));
            let (engaged, slope) = (d.backlash.engaged(x), d.tangent_stiffness(x));
            let expected = [-engaged / slope, -d.hardening(x) / slope, 1.0 / slope];
            assert!((torsion.value - x).abs() < 1e-12 && (compliance.value * slope - 1.0).abs() < 1e-12);
            for (found, expected) in torsion.gradient.iter().zip(expected) {
                assert!((found - expected).abs() <= 1e-10 * expected.abs(), "{x}: {found} {expected}");
            }
        }
    }

    /// The least slope on a fine grid, for wind-ups that are missing and that are added.
    #[test]
    fn the_softest_torsion_is_found() {
        for (k, shape, cubic) in [(300.0, 800.0, 3e4), (-900.0, 800.0, 0.0), (-900.0, 800.0, 3e4), (-9.0, 80.0, 3e5)] {
            let d = Drive { soft_windup: SoftWindup { stiffness: k, shape }, cubic_stiffness: cubic, ..drive() };
            let grid = (0..20_000).map(|i| d.tangent_stiffness(1e-5 * f64::from(i)));
            let least = grid.fold(f64::INFINITY, f64::min);
            assert!((d.soft_windup.least_slope(d.stiffness, cubic) - least).abs() < 1e-5 * d.stiffness, "{k} {least}");
        }
    }

    #[test]
    fn a_spring_that_gives_way_is_refused() {
        let windup = |stiffness, shape| Drive { soft_windup: SoftWindup { stiffness, shape }, ..drive() }.check("it");
        assert!(windup(499.0, 800.0).is_ok() && windup(-1000.0, 800.0).is_ok());
        for (stiffness, shape) in [(501.0, 800.0), (-2000.0, 2e5)] {
            let error = windup(stiffness, shape).unwrap_err().to_string();
            assert!(error.contains("least tangent stiffness of it") && error.contains("must rise"), "{error}");
        }
        assert!(windup(10.0, -1.0).unwrap_err().to_string().contains("soft wind-up's shape of it is -1"));
        let cubic = Drive { cubic_stiffness: -1.0, ..drive() }.check("it").unwrap_err();
        assert!(cubic.to_string().contains("cubic stiffness of it is -1, expected at least 0"));
        let stribeck = Friction { stribeck: 1.0, ..Friction::default() };
        let error = Drive { motor_friction: stribeck, ..drive() }.check("it").unwrap_err();
        assert!(error.to_string().contains("Stribeck velocity of it is 0, expected greater than 0"));
    }

    #[test]
    fn lanes_hold_the_bits_of_one_number() {
        let (drives, x) = (drives(), [-0.3, -0.001, 0.02, 0.7]);
        let v = Lanes(x);
        for (d, i) in drives.iter().flat_map(|d| [0, 1, 2, 3].map(|i| (d, i))) {
            assert_eq!(d.torsion(v).0[i], d.torsion(x[i]));
            assert_eq!(d.link_friction(v).0.0[i], d.link_friction(x[i]).0);
            assert_eq!(d.dry_friction(v).0[i], d.dry_friction(x[i]));
        }
    }
}
