//! The kinematic error of a gear.

use crate::check::expect_of;
use crate::error::RobotError;
use crate::scalar::Scalar;

/// One harmonic of a gear's error: a sin(ν θ + φ) at motor angle θ.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Harmonic {
    /// a [rad].
    pub amplitude: f64,
    /// ν: cycles a turn of the motor's angle θ as reflected through the gear.
    pub frequency: f64,
    /// φ [rad].
    pub phase: f64,
}

/// How far a gear's output is from its motor's angle: it stands at θ + ε(θ), ε a sum of harmonics.
///
/// Motor and spring are joined by that angle, so that the motor feels (1 + ε′) times the torque that the spring gives the
/// link: then no energy comes out of nothing.
///
/// ```
/// use linkside_core::robot::{Harmonic, Ripple};
/// // 40 µrad, twice a turn of a motor that turns a hundred times as fast as its link.
/// let ripple = Ripple::new(vec![Harmonic { amplitude: 4e-5, frequency: 200.0, phase: 0.3 }]);
/// let gear = ripple.output(0.1_f64);
/// assert!((gear.angle - 0.1 - 4e-5 * 20.3_f64.sin()).abs() < 1e-15);
/// assert!((gear.ratio - 1.0 - 8e-3 * 20.3_f64.cos()).abs() < 1e-15);
/// assert!((ripple.motor(gear.angle) - 0.1).abs() < 1e-15); // and back
/// ```
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Ripple {
    harmonics: Vec<Harmonic>,
}

/// Where a gear's output stands and how it follows the motor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GearOutput<T> {
    /// θ + ε [rad].
    pub angle: T,
    /// 1 + ε′, by which the output turns faster than the motor.
    pub ratio: T,
    /// ε″ [1/rad].
    pub bend: T,
}

/// The output's speed is within this of the motor's: Newton's method then halves its error at least.
const MOST: f64 = 0.2;

impl Ripple {
    /// The sum of `harmonics`.
    pub fn new(harmonics: Vec<Harmonic>) -> Self {
        Self { harmonics }
    }

    /// # Errors
    /// A number that is not finite, or harmonics that change the output's speed by more than a fifth.
    pub(super) fn check(&self, owner: &str) -> Result<(), RobotError> {
        let owner = || owner.to_string();
        for Harmonic { amplitude, frequency, phase } in &self.harmonics {
            for (what, value) in [("amplitude", amplitude), ("frequency", frequency), ("phase", phase)] {
                expect_of(value.is_finite(), what, owner, *value, "a finite number")?;
            }
        }
        let change: f64 = self.harmonics.iter().map(|h| (h.amplitude * h.frequency).abs()).sum();
        expect_of(change <= MOST, "ripple of the speed", owner, change, "at most 0.2 of it")
    }

    /// Whether the output is where the motor is.
    #[inline(always)]
    pub fn is_none(&self) -> bool {
        self.harmonics.is_empty()
    }

    /// The output at motor angle `theta` [rad].
    #[inline(always)]
    pub fn output<T: Scalar>(&self, theta: T) -> GearOutput<T> {
        let mut gear = GearOutput { angle: theta, ratio: T::constant(1.0), bend: T::default() };
        for Harmonic { amplitude, frequency, phase } in &self.harmonics {
            let (sin, cos) = (theta * *frequency + *phase).sin_cos();
            gear.angle += sin * *amplitude;
            gear.ratio += cos * (amplitude * frequency);
            gear.bend -= sin * (amplitude * frequency * frequency);
        }
        gear
    }

    /// The motor angle at which the output stands at `angle` [rad].
    #[inline(always)]
    pub fn motor<T: Scalar>(&self, angle: T) -> T {
        if self.is_none() {
            return angle;
        }
        // One step of Newton's method from the solution gives a derivative number its slopes.
        self.approach(angle, angle.map(|angle| self.solve(angle)))
    }

    /// One step of Newton's method to [`motor`](Self::motor) from `theta`: twice the digits, and twice the coefficients of
    /// a series, are then right.
    #[inline(always)]
    pub(crate) fn approach<T: Scalar>(&self, angle: T, theta: T) -> T {
        let gear = self.output(theta);
        theta + (angle - gear.angle) / gear.ratio
    }

    fn solve(&self, angle: f64) -> f64 {
        let mut theta = angle;
        for _ in 0..60 {
            let next = self.approach(angle, theta);
            let step = (next - theta).abs();
            theta = next;
            if step <= 1e-16 * theta.abs() {
                break;
            }
        }
        theta
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scalar::{Dual, Lanes};

    fn ripples() -> [Ripple; 2] {
        let harmonic = |amplitude, frequency, phase| Harmonic { amplitude, frequency, phase };
        [
            Ripple::new(vec![harmonic(4e-5, 202.0, 0.3), harmonic(1e-4, 1.0, -2.0)]),
            Ripple::new(vec![harmonic(-1e-3, 100.0, 0.0), harmonic(2e-3, -49.0, 1.0)]),
        ]
    }

    const ANGLES: [f64; 6] = [-3.0, -1e-3, 0.0, 0.017, 0.8, 40.0];

    #[test]
    fn slopes_are_the_derivatives_of_the_error() {
        for (ripple, x) in ripples().iter().flat_map(|r| ANGLES.map(|x| (r, x))) {
            let (gear, dual) = (ripple.output(x), ripple.output(Dual::<1>::variable(x, 0)));
            assert!((dual.angle.gradient[0] - gear.ratio).abs() < 1e-14);
            assert!((dual.ratio.gradient[0] - gear.bend).abs() < 1e-12);
            assert_eq!(ripple.output(Lanes([x, 0.1])).angle.0[0], gear.angle);
        }
    }

    #[test]
    fn the_motor_is_found_with_its_slope() {
        for (ripple, x) in ripples().iter().flat_map(|r| ANGLES.map(|x| (r, x))) {
            let gear = ripple.output(x);
            let found = ripple.motor(Dual::<1>::variable(gear.angle, 0));
            assert!((found.value - x).abs() <= 1e-15 * (1.0 + x.abs()), "{x} {}", found.value);
            assert!((found.gradient[0] * gear.ratio - 1.0).abs() < 1e-12);
            assert_eq!(ripple.motor(Lanes([gear.angle, 0.1])).0[0], ripple.motor(gear.angle));
        }
    }

    #[test]
    fn ripples_out_of_range_are_refused() {
        let refused = |amplitude, frequency| {
            let harmonic = Harmonic { amplitude, frequency, phase: 0.0 };
            Ripple::new(vec![harmonic]).check("joint 0").unwrap_err().to_string()
        };
        assert!(refused(f64::NAN, 1.0).starts_with("amplitude of joint 0 is NaN"));
        assert!(refused(3e-3, 100.0).starts_with("ripple of the speed of joint 0 is 0.3, expected at most 0.2"));
        assert!(Ripple::default().check("it").is_ok() && ripples().iter().all(|ripple| ripple.check("it").is_ok()));
    }
}
