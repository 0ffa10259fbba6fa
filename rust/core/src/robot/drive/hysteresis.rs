//! Friction inside a transmission: elements beside the spring that remember where they have been.

use crate::check::expect_of;
use crate::error::RobotError;
use crate::scalar::{Scalar, exp_m1, log};

/// A friction element beside the spring: a spring of its own that gives way, more and more or at once, up to a limit.
///
/// With z its deflection, F = k z its force, u = ±z/w for a torsion that rises or falls, and w = W/k,
///
/// ```text
/// ż = δ̇ g(u),   g(u) = min(1 − b u, (1 − u)/r)
/// ```
///
/// so that |F| ≤ W. Dahl's (1968) has r = b = 1, that of Bouc and Wen (1976) with exponent 1 r = 1 and b = 2β − 1, a
/// Maxwell-slip element b = 0 and a small r, the part of its way over which it begins to slip. All depend on the way
/// alone and not on its speed, take energy in whole loops, and have their steps in closed form.
///
/// ```
/// use linkside_core::robot::FrictionElement;
/// let element = FrictionElement::slip(1e4, 5.0, 0.1);
/// // 0.4 mrad: it sticks; 2 mrad: it slips; and back by as much: it slips the other way.
/// assert!((element.moved(0.0, 4e-4).deflection - 4e-4).abs() < 1e-15);
/// let slipping = element.moved(0.0, 2e-3).deflection;
/// assert!((slipping - 5e-4).abs() < 1e-8 && (element.moved(slipping, -2e-3).deflection + 5e-4).abs() < 1e-7);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrictionElement {
    /// k, at rest [N m/rad].
    pub stiffness: f64,
    /// W [N m].
    pub limit: f64,
    /// b, 0 to 1: how much stiffer it is when turned back.
    pub recoil: f64,
    /// r, greater than 0 and at most 1.
    pub rounding: f64,
}

/// An element after a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moved {
    /// z [rad].
    pub deflection: f64,
    /// ∂z/∂Δ, Δ the step.
    pub slope: f64,
    /// ∂²z/∂Δ² [1/rad].
    pub bend: f64,
    /// ∂z/∂z₀.
    pub fading: f64,
}

impl FrictionElement {
    /// Dahl's.
    pub fn dahl(stiffness: f64, limit: f64) -> Self {
        Self { stiffness, limit, recoil: 1.0, rounding: 1.0 }
    }

    /// That of Maxwell-slip, which slips over the last part `rounding` of its way.
    pub fn slip(stiffness: f64, limit: f64, rounding: f64) -> Self {
        Self { stiffness, limit, recoil: 0.0, rounding }
    }

    fn check(&self, owner: &impl Fn() -> String) -> Result<(), RobotError> {
        let Self { stiffness, limit, recoil, rounding } = *self;
        for (what, value) in [("stiffness of a friction element", stiffness), ("limit of a friction element", limit)] {
            expect_of(value > 0.0 && value.is_finite(), what, owner, value, "greater than 0")?;
        }
        expect_of((0.0..=1.0).contains(&recoil), "recoil of a friction element", owner, recoil, "0 to 1")?;
        let part = rounding > 0.0 && rounding <= 1.0;
        expect_of(part, "rounding of a friction element", owner, rounding, "greater than 0, at most 1")
    }

    /// w: the deflection at the limit [rad].
    #[inline(always)]
    pub fn reach(&self) -> f64 {
        self.limit / self.stiffness
    }

    /// u at which g turns from its first branch to its second.
    #[inline(always)]
    fn corner(&self) -> f64 {
        let Self { recoil: b, rounding: r, .. } = *self;
        if r == 1.0 { if b < 1.0 { 0.0 } else { -1.0 } } else { (1.0 - r) / (1.0 - b * r) }
    }

    /// g and g′ at `u`.
    #[inline(always)]
    fn giving<T: Scalar>(&self, u: T) -> (T, T) {
        let (corner, one, inverse) = (self.corner(), T::constant(1.0), 1.0 / self.rounding);
        let second = u.map(|u| f64::from(u > corner));
        let first = one - second;
        let g = first * (u * -self.recoil + 1.0) + second * ((one - u) * inverse);
        (g, first * -self.recoil + second * -inverse)
    }

    /// ż at deflection `z` and torsion rate `v`, and its slopes in v and z; at rest the mean of both ways.
    #[inline(always)]
    pub fn rate<T: Scalar>(&self, z: T, v: T) -> (T, [T; 2]) {
        let inverse = 1.0 / self.reach();
        let sign = v.map(|v| if v == 0.0 { 0.0 } else { v.signum() });
        let (u, one) = (z * inverse, T::constant(1.0));
        let ((up, up_by), (down, down_by)) = (self.giving(u), self.giving(-u));
        let (rising, falling) = ((one + sign) * 0.5, (one - sign) * 0.5);
        let by_v = rising * up + falling * down;
        (v * by_v, [by_v, v * (rising * up_by - falling * down_by) * inverse])
    }

    /// Exactly, after the torsion has risen by `step` [rad], or fallen, without a turn.
    pub fn moved(&self, deflection: f64, step: f64) -> Moved {
        let (w, sign) = (self.reach(), if step < 0.0 { -1.0 } else { 1.0 });
        let start = (sign * deflection / w).clamp(-1.0, 1.0);
        let u = self.travel(start, step.abs() / w);
        let ((before, _), (slope, by)) = (self.giving(start), self.giving(u));
        // The flow is autonomous in the way: ∂u/∂u₀ = g(u)/g(u₀).
        let fading = if before > 0.0 { slope / before } else { 1.0 };
        Moved { deflection: sign * u * w, slope, bend: sign * slope * by / w, fading }
    }

    /// u after `way` of u′ = g(u).
    fn travel(&self, u: f64, way: f64) -> f64 {
        let Self { recoil: b, rounding: r, .. } = *self;
        let corner = self.corner();
        let (mut u, mut left) = (u, way);
        if u < corner {
            // u′ = 1 − b u: an exponential, or a line where b is none.
            let ratio = (1.0 - b * corner) / (1.0 - b * u);
            let first = if b > 0.0 { -log(ratio) / b } else { corner - u };
            if left <= first {
                return if b > 0.0 { u - (1.0 - b * u) * exp_m1(-b * left) / b } else { u + left };
            }
            (u, left) = (corner, left - first);
        }
        u - (1.0 - u) * exp_m1(-left / r)
    }
}

/// All friction elements of a transmission.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Hysteresis {
    /// Side by side.
    pub elements: Vec<FrictionElement>,
}

impl Hysteresis {
    /// # Errors
    /// An element out of range.
    pub(super) fn check(&self, owner: &str) -> Result<(), RobotError> {
        self.elements.iter().try_for_each(|element| element.check(&|| owner.to_string()))
    }

    /// Whether there is none.
    #[inline(always)]
    pub fn is_none(&self) -> bool {
        self.elements.is_empty()
    }

    /// Σ k z [N m].
    #[inline(always)]
    pub fn force<T: Scalar>(&self, deflections: &[T]) -> T {
        self.elements.iter().zip(deflections).fold(T::default(), |sum, (e, z)| sum + *z * e.stiffness)
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::scalar::Dual;

    pub(in super::super) fn elements() -> [FrictionElement; 5] {
        let shaped = |recoil, rounding| FrictionElement { stiffness: 2e4, limit: 10.0, recoil, rounding };
        [
            FrictionElement::dahl(1e4, 8.0),
            FrictionElement::slip(2e4, 6.0, 0.1),
            shaped(0.0, 1.0),
            shaped(0.4, 1.0),
            shaped(0.3, 0.2),
        ]
    }

    /// Steps of both directions, within an element's reach and far beyond.
    const STEPS: [f64; 7] = [3e-4, -1e-4, -2e-3, 5e-5, 7e-4, -1e-6, 4e-3];

    #[test]
    fn a_step_is_the_integral_of_the_rate_at_any_speed() {
        for element in elements() {
            for speed in [1e-3, 5.0] {
                let (mut exact, mut z) = (0.2 * element.reach(), 0.2 * element.reach());
                for step in STEPS {
                    let (n, v) = (20_000, step.signum() * speed);
                    let h = step / v / f64::from(n);
                    for _ in 0..n {
                        let half = z + 0.5 * h * element.rate(z, v).0;
                        z += h * element.rate(half, v).0;
                    }
                    exact = element.moved(exact, step).deflection;
                    assert!((z - exact).abs() < 1e-6 * element.reach(), "{element:?} {step}: {z} {exact}");
                }
            }
        }
    }

    #[test]
    fn steps_add_up_and_stay_within_the_limit() {
        for element in elements() {
            let mut z = -0.3 * element.reach();
            for step in STEPS {
                let whole = element.moved(z, step).deflection;
                let half = element.moved(element.moved(z, 0.3 * step).deflection, 0.7 * step).deflection;
                assert!((whole - half).abs() < 1e-13 * element.reach() && whole.abs() <= element.reach());
                z = whole;
            }
        }
    }

    #[test]
    fn slopes_are_the_derivatives_of_the_laws() {
        for element in elements() {
            let w = element.reach();
            for (z, v) in [(0.1, 0.3), (-0.6, 0.2), (0.95, -0.4), (-0.99, -2.0), (0.97, 0.7)] {
                let dual = element.rate(Dual::<2>::variable(z * w, 0), Dual::variable(v, 1));
                let (rate, [by_v, by_z]) = element.rate(z * w, v);
                assert_eq!(dual.0.value, rate);
                assert!((dual.0.gradient[0] - by_z).abs() <= 1e-12 * by_z.abs());
                assert!((dual.0.gradient[1] - by_v).abs() <= 1e-12);
            }
            for (z, step) in [(0.1, 0.37), (-0.6, 0.2), (0.9, -0.43), (-0.7, -0.17), (0.3, 2.0), (0.3, -3.0)] {
                let (moved, h) = (element.moved(z * w, step * w), 1e-6 * w);
                let at = |z: f64, step: f64| element.moved(z, step);
                let by_step = (at(z * w, step * w + h).deflection - at(z * w, step * w - h).deflection) / (2.0 * h);
                let by_start = (at(z * w + h, step * w).deflection - at(z * w - h, step * w).deflection) / (2.0 * h);
                let bend = (at(z * w, step * w + h).slope - at(z * w, step * w - h).slope) / (2.0 * h);
                assert!((moved.slope - by_step).abs() < 1e-8, "{element:?} {z} {step}");
                assert!((moved.fading - by_start).abs() < 1e-8, "{element:?} {z} {step} {} {by_start}", moved.fading);
                assert!((moved.bend - bend).abs() < 1e-7 / w, "{element:?} {z} {step}");
            }
        }
    }

    /// Of a sharp element that slips, 4 W (A − w) at amplitude A (Masing).
    #[test]
    fn a_loop_takes_the_energy_that_is_its_area() {
        let (element, amplitude, n) = (FrictionElement::slip(1e4, 5.0, 1e-3), 2e-3, 40_000);
        let (mut z, mut area) = (0.0, 0.0);
        for k in 0..5 * n / 4 + n {
            let way = |k: i32| amplitude * (core::f64::consts::TAU * f64::from(k) / f64::from(n)).sin();
            let (step, before) = (way(k + 1) - way(k), z);
            z = element.moved(z, step).deflection;
            if k >= 5 * n / 4 {
                area += element.stiffness * 0.5 * (z + before) * step;
            }
        }
        let expected = 4.0 * element.limit * (amplitude - element.reach());
        assert!((area - expected).abs() < 2e-3 * expected, "{area} {expected}");
    }

    #[test]
    fn elements_out_of_range_are_refused() {
        let refused = |element: FrictionElement| {
            let hysteresis = Hysteresis { elements: vec![element] };
            hysteresis.check("joint 0").unwrap_err().to_string()
        };
        assert!(
            refused(FrictionElement::dahl(0.0, 1.0)).starts_with("stiffness of a friction element of joint 0 is 0")
        );
        assert!(refused(FrictionElement::dahl(1.0, f64::NAN)).starts_with("limit of a friction element of joint 0"));
        assert!(
            refused(FrictionElement::slip(1.0, 1.0, 0.0)).contains("rounding of a friction element of joint 0 is 0")
        );
        let stiffer = FrictionElement { recoil: 1.5, ..FrictionElement::dahl(1.0, 1.0) };
        assert!(refused(stiffer).contains("recoil of a friction element of joint 0 is 1.5, expected 0 to 1"));
        assert!(Hysteresis { elements: elements().to_vec() }.check("it").is_ok());
    }
}
