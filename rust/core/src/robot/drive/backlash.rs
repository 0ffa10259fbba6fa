//! Play between a motor and its link.

use crate::check::expect_of;
use crate::error::RobotError;
use crate::scalar::{Scalar, log};

/// A smooth dead zone: of a torsion δ the spring is left z = δ − (1 − ρ) s(δ),
/// s = ½ (√((δ + a)² + ε²) − √((δ − a)² + ε²)).
///
/// Within the half gap a the joint yields 1/ρ times as far as beyond it; corners are round over ε. z rises everywhere, by
/// ρ < z′ < 1, so that it has an inverse.
///
/// ```
/// use linkside_core::robot::Backlash;
/// // Two arc minutes either way, with a hundredth of the stiffness in between.
/// let gap = Backlash { half_gap: 5.8e-4, slope: 0.01, rounding: 1e-5 };
/// assert!(gap.engaged(5e-4_f64).abs() < 1e-5 && (gap.engaged(2e-3_f64) - 1.43e-3).abs() < 1e-5);
/// assert!((gap.torsion(gap.engaged(1e-3)) - 1e-3).abs() < 1e-12);
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Backlash {
    /// a [rad]; zero for a drive without play.
    pub half_gap: f64,
    /// ρ, the share of the stiffness that is left within the gap.
    pub slope: f64,
    /// ε [rad].
    pub rounding: f64,
}

impl Backlash {
    /// # Errors
    /// A negative half gap; of a gap, a slope or a rounding out of range.
    pub(super) fn check(&self, owner: &str) -> Result<(), RobotError> {
        let Self { half_gap, slope, rounding } = *self;
        let owner = || owner.to_string();
        let finite = half_gap >= 0.0 && half_gap.is_finite();
        expect_of(finite, "half gap", owner, half_gap, "a finite number of at least 0")?;
        if self.is_none() {
            return Ok(());
        }
        expect_of(slope > 0.0 && slope < 1.0, "slope in the gap", owner, slope, "between 0 and 1")?;
        expect_of(rounding > 0.0 && rounding.is_finite(), "rounding of the gap", owner, rounding, "greater than 0")
    }

    /// Whether there is no play.
    #[inline(always)]
    pub fn is_none(&self) -> bool {
        self.half_gap == 0.0
    }

    /// z: what of a torsion is left for the spring [rad].
    #[inline(always)]
    pub fn engaged<T: Scalar>(&self, torsion: T) -> T {
        if self.is_none() {
            return torsion;
        }
        let [(_, right), (_, left)] = self.ends(torsion);
        // The difference of the roots over their sum: nothing cancels far from the gap.
        torsion - torsion / (right + left) * (2.0 * self.half_gap * (1.0 - self.slope))
    }

    /// z′ at a torsion, between ρ and 1.
    #[inline(always)]
    pub fn engagement<T: Scalar>(&self, torsion: T) -> T {
        if self.is_none() {
            return T::constant(1.0);
        }
        let [(u, right), (v, left)] = self.ends(torsion);
        (u / right - v / left) * (-0.5 * (1.0 - self.slope)) + 1.0
    }

    /// The slope of z in the half gap, at a torsion.
    pub(crate) fn engaged_by_half_gap(&self, torsion: f64) -> f64 {
        let [(u, right), (v, left)] = self.ends(torsion);
        -0.5 * (1.0 - self.slope) * (u / right + v / left)
    }

    /// δ ± a, and the roots over them.
    #[inline(always)]
    fn ends<T: Scalar>(&self, torsion: T) -> [(T, T); 2] {
        let round = self.rounding * self.rounding;
        [self.half_gap, -self.half_gap].map(|a| {
            let u = torsion + a;
            (u, (u * u + round).sqrt())
        })
    }

    /// The torsion that leaves `engaged` for the spring [rad].
    ///
    /// z is convex where δ > 0, and Newton's method comes down to the solution from |z| + (1 − ρ) a.
    pub fn torsion(&self, engaged: f64) -> f64 {
        if self.is_none() {
            return engaged;
        }
        let target = engaged.abs();
        let mut torsion = target + (1.0 - self.slope) * self.half_gap;
        for _ in 0..50 {
            let step = (self.engaged(torsion) - target) / self.engagement(torsion);
            torsion -= step;
            if step <= 1e-16 * torsion {
                break;
            }
        }
        torsion.copysign(engaged)
    }

    /// ∫₀^δ z: the energy of a spring of 1 N m/rad behind the gap [rad²].
    pub fn energy(&self, torsion: f64) -> f64 {
        if self.is_none() {
            return 0.5 * torsion * torsion;
        }
        let area = |u: f64| {
            let root = (u * u + self.rounding * self.rounding).sqrt();
            let angle = log((u.abs() + root) / self.rounding).copysign(u);
            u * root + self.rounding * self.rounding * angle
        };
        let (a, share) = (self.half_gap, 0.25 * (1.0 - self.slope));
        0.5 * torsion * torsion - share * (area(torsion + a) - area(torsion - a) - 2.0 * area(a))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scalar::{Dual, Lanes, Series};

    const GAPS: [Backlash; 3] = [
        Backlash { half_gap: 1.8e-3, slope: 0.01, rounding: 2e-4 },
        Backlash { half_gap: 0.05, slope: 1e-4, rounding: 1e-5 },
        Backlash { half_gap: 1e-5, slope: 0.5, rounding: 1e-3 },
    ];
    const TORSIONS: [f64; 9] = [-0.3, -0.05, -1.8e-3, -1e-7, 0.0, 2e-4, 1.9e-3, 0.051, 2.0];

    #[test]
    fn slope_inverse_and_energy_belong_to_the_law() {
        for gap in GAPS {
            for x in TORSIONS {
                let dual = gap.engaged(Dual::<1>::variable(x, 0));
                let slope = gap.engagement(x);
                assert!((dual.gradient[0] - slope).abs() < 1e-12, "{gap:?} {x}: {} {slope}", dual.gradient[0]);
                assert!(slope > gap.slope && slope < 1.0 + 1e-12);
                assert!((gap.torsion(dual.value) - x).abs() < 1e-12 * (1.0 + x.abs()), "{gap:?} {x}");
                assert_eq!(gap.engaged(-x), -gap.engaged(x));
                assert_eq!(gap.engaged(Lanes([x, 0.1])).0[0], dual.value);
            }
        }
    }

    /// Simpson's rule on a fine grid.
    #[test]
    fn energy_is_the_integral_of_the_law() {
        for gap in GAPS {
            for x in TORSIONS {
                let (n, mut sum) = (200_000, 0.0);
                let h = x / f64::from(n);
                for i in 0..n {
                    let at = h * f64::from(i);
                    sum += h / 6.0 * (gap.engaged(at) + 4.0 * gap.engaged(at + 0.5 * h) + gap.engaged(at + h));
                }
                assert!((gap.energy(x) - sum).abs() < 1e-9 * (x * x + 1e-9), "{gap:?} {x}: {} {sum}", gap.energy(x));
            }
        }
    }

    #[test]
    fn series_have_its_derivatives_in_time() {
        let gap = GAPS[0];
        let moving = |t: f64| 2e-3 * (3.0 * t).sin() + 1e-3;
        let series = Series::<3>([moving(0.2), 6e-3 * 0.6_f64.cos(), -9e-3 * 0.6_f64.sin()]);
        let (h, at) = (1e-4, |t: f64| gap.engaged(moving(t)));
        let rate = (at(0.2 + h) - at(0.2 - h)) / (2.0 * h);
        assert!((gap.engaged(series).rate().value() - rate).abs() < 1e-6 * rate.abs());
    }

    #[test]
    fn gaps_out_of_range_are_refused() {
        let refused = |gap: Backlash| gap.check("joint 0").unwrap_err().to_string();
        assert!(refused(Backlash { half_gap: -1e-3, ..GAPS[0] }).starts_with("half gap of joint 0 is -0.001"));
        assert!(
            refused(Backlash { slope: 1.0, ..GAPS[0] }).contains("slope in the gap of joint 0 is 1, expected between")
        );
        assert!(refused(Backlash { rounding: 0.0, ..GAPS[0] }).contains("rounding of the gap of joint 0 is 0"));
        assert!(Backlash::default().check("joint 0").is_ok() && GAPS.iter().all(|gap| gap.check("it").is_ok()));
    }
}
