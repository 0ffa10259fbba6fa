//! Torsion that makes a spring and a damper transmit a given torque: D δ̇ + φ(δ) = r.
//!
//! Without damper r gives δ and all its derivatives at one moment, by Newton's method on power series. With one, δ obeys a
//! differential equation of time constant D/K, often far shorter than a sample: it is solved exactly for its linear part.

use crate::robot::Drive;
use crate::scalar::{Scalar, Series};

/// Torsion with its derivatives where nothing damps it: φ(δ) = r.
#[inline(always)]
pub(super) fn undamped<const P: usize>(drive: &Drive, load: Series<P>) -> Series<P> {
    let mut torsion = drive.torsion(load);
    // A step of Newton's method doubles the number of coefficients that are right; the first two are.
    let mut known = 2;
    while known < P && !drive.is_linear() {
        torsion += (load - drive.spring_torque(torsion)) / drive.tangent_stiffness(torsion);
        known *= 2;
    }
    torsion
}

/// Torsion with its derivatives where it is damped and has the value `torsion` now.
#[inline(always)]
pub(super) fn damped<const P: usize>(drive: &Drive, load: Series<P>, torsion: f64) -> Series<P> {
    let mut series = Series::constant(torsion);
    for k in 0..P - 1 {
        let torque = drive.spring_torque(series);
        series.0[k + 1] = (load.0[k] - torque.0[k]) / (drive.damping * (k + 1) as f64);
    }
    series
}

/// The motor's angle with its derivatives where the gear's output stands at `angle`.
#[inline(always)]
pub(super) fn motor<const P: usize>(drive: &Drive, angle: Series<P>) -> Series<P> {
    let (mut theta, mut known) = (drive.ripple.motor(angle), 2);
    while known < P && !drive.ripple.is_none() {
        theta = drive.ripple.approach(angle, theta);
        known *= 2;
    }
    theta
}

/// A damped transmission at one moment.
#[derive(Clone, Copy, Debug)]
pub(super) struct LoadedTransmission<const P: usize> {
    /// r [N m].
    pub(super) load: Series<P>,
    /// δ [rad].
    pub(super) torsion: f64,
}

/// The highest derivative of the load that is looked at.
pub(super) const SMOOTHEST: usize = 3;
/// Of the polynomial with that many derivatives at both ends, and its coefficients.
const DEGREE: usize = 2 * SMOOTHEST + 1;
type Polynomial = [f64; DEGREE + 1];

/// Torsion `dt` after `before`, when the load is then `load`; both loads are known up to the derivative `known`.
///
/// The linear part is solved exactly for a load that follows the polynomial through all derivatives at both ends, whatever
/// K/D·`dt` is. What a nonlinear spring has beyond its slope at `before` is taken to that load, and iterated.
#[inline(always)]
pub(super) fn advance<const P: usize>(
    drive: &Drive,
    before: LoadedTransmission<P>,
    dt: f64,
    load: Series<P>,
    known: usize,
) -> f64 {
    let slope = drive.tangent_stiffness(before.torsion);
    let remainder = |load: Series<P>, torsion: f64| {
        if drive.is_linear() {
            return load;
        }
        let torsion = damped(drive, load, torsion);
        load - (drive.spring_torque(torsion) - torsion * slope)
    };
    let moments = moments(slope / drive.damping * dt);
    let start = remainder(before.load, before.torsion);
    let mut torsion = before.torsion;
    for _ in 0..if drive.is_linear() { 1 } else { 30 } {
        let between = hermite(start, remainder(load, torsion), dt, known);
        let forced: f64 = between.iter().zip(&moments.powers).map(|(a, b)| a * b).sum();
        let next = moments.decay * before.torsion + dt / drive.damping * forced;
        if (next - torsion).abs() <= 1e-15 * next.abs() {
            break;
        }
        torsion = next;
    }
    torsion
}

/// Coefficients in s = time/`dt` of the polynomial with the derivatives up to `known` of `start` at 0 and `end` at 1.
#[inline(always)]
fn hermite<const P: usize>(start: Series<P>, end: Series<P>, dt: f64, known: usize) -> Polynomial {
    let mut polynomial = [0.0; DEGREE + 1];
    let mut rest = [0.0; SMOOTHEST + 1];
    let mut scale = 1.0;
    for k in 0..=known {
        polynomial[k] = start.0[k] * scale;
        rest[k] = end.0[k] * scale;
        scale *= dt;
    }
    // What the part known at 0 leaves over at 1, divided by s to the power of known + 1, as a series in s − 1 …
    for k in 0..=known {
        rest[k] -= (k..=known).map(|j| binomial(j, k) * polynomial[j]).sum::<f64>();
    }
    let divided = |k: usize| -> f64 {
        (0..=k).map(|j| rest[k - j] * binomial(known + j, j) * if j % 2 == 0 { 1.0 } else { -1.0 }).sum()
    };
    // … and back to powers of s.
    for k in 0..=known {
        let factor = divided(k);
        for j in 0..=k {
            let sign = if (k - j) % 2 == 0 { 1.0 } else { -1.0 };
            polynomial[known + 1 + j] += factor * sign * binomial(k, j);
        }
    }
    polynomial
}

/// n over k.
#[inline(always)]
fn binomial(n: usize, k: usize) -> f64 {
    (0..k).fold(1.0, |product, i| product * (n - i) as f64 / (i + 1) as f64)
}

/// What is left of a torsion, and ∫₀¹ e^{−z(1−s)} sᵐ ds for every power m.
struct ExponentialMoments {
    /// e^(−z) and the integrals, by the power.
    decay: f64,
    powers: Polynomial,
}

/// By the recurrence z I_m = 1 − m I_(m−1), in the direction in which it does not cancel.
#[inline(always)]
fn moments(z: f64) -> ExponentialMoments {
    let decay = Scalar::exp(-z);
    let mut powers = [0.0; DEGREE + 1];
    if z > 3.0 {
        powers[0] = (1.0 - decay) / z;
        for m in 1..=DEGREE {
            powers[m] = (1.0 - m as f64 * powers[m - 1]) / z;
        }
        return ExponentialMoments { decay, powers };
    }
    // Upwards the recurrence would cancel: begin at the top with its power series in z.
    let mut term = 1.0 / (DEGREE + 1) as f64;
    for k in 0..30 {
        powers[DEGREE] += term;
        term *= -z / (DEGREE + 2 + k) as f64;
    }
    for m in (1..=DEGREE).rev() {
        powers[m - 1] = (1.0 - z * powers[m]) / m as f64;
    }
    ExponentialMoments { decay, powers }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::SoftWindup;

    fn drive(cubic_stiffness: f64, windup: f64) -> Drive {
        Drive {
            cubic_stiffness,
            soft_windup: SoftWindup { stiffness: windup, shape: 800.0 },
            ..Drive::spring(1e4, 20.0, 1.0)
        }
    }

    #[test]
    fn moments_are_the_integrals() {
        for z in [0.0, 1e-6, 0.3, 1.9, 2.1, 40.0] {
            let found = moments(z);
            for m in 0..=DEGREE as i32 {
                let steps = 20_000;
                let f = |s: f64| (-z * (1.0 - s)).exp() * s.powi(m);
                let middle: f64 = (0..steps).map(|i| f((i as f64 + 0.5) / f64::from(steps))).sum::<f64>();
                assert!((found.powers[m as usize] - middle / f64::from(steps)).abs() < 1e-6, "{z} {m}");
            }
        }
    }

    #[test]
    fn torsion_gives_the_load_back_in_every_coefficient() {
        let load = Series::<9>([120.0, -800.0, 3e4, 1e5, -2e6, 1e7, 0.0, 1e9, -1e10]);
        for d in [drive(0.0, 0.0), drive(5e6, 2e3)] {
            let stiff = undamped(&d, load);
            let soft = damped(&d, load, 0.004);
            for (k, expected) in load.0.into_iter().enumerate() {
                let near =
                    |found: f64| assert!((found - expected).abs() <= 1e-9 * 1e3_f64.powi(k as i32), "{k} {found}");
                near(d.spring_torque(stiff).0[k]);
                if k < 8 {
                    near((d.spring_torque(soft) + soft.rate() * d.damping).0[k]);
                }
            }
        }
    }

    /// The load's Taylor coefficients at `t`.
    fn load(t: f64) -> Series<6> {
        let angle = Series([40.0 * t, 40.0, 0.0, 0.0, 0.0, 0.0]);
        angle.sin_cos().0 * 300.0 + 100.0
    }

    #[test]
    fn a_polynomial_goes_through_both_ends() {
        let (dt, s) = (0.01, Series::<6>([1.0, 1.0, 0.0, 0.0, 0.0, 0.0]));
        for known in 1..=SMOOTHEST {
            let p = hermite(load(0.3), load(0.3 + dt), dt, known);
            let at_end = p.iter().rev().fold(Series::default(), |sum, &c| sum * s + c);
            for k in 0..=known {
                let scale = dt.powi(k as i32);
                assert!((p[k] - load(0.3).0[k] * scale).abs() < 1e-12);
                assert!((at_end.0[k] - load(0.3 + dt).0[k] * scale).abs() < 1e-10, "{known} {k}");
            }
        }
    }

    #[test]
    fn a_step_meets_many_small_ones() {
        for (d, known) in [(drive(0.0, 0.0), 1), (drive(0.0, 0.0), 3), (drive(5e6, 2e3), 1), (drive(5e6, 2e3), 2)] {
            let walk = |steps: u32| {
                let dt = 0.02 / f64::from(steps);
                (0..steps).fold(0.01, |torsion, i| {
                    let (a, b) = (load(f64::from(i) * dt), load(f64::from(i + 1) * dt));
                    advance(&d, LoadedTransmission { load: a, torsion }, dt, b, known)
                })
            };
            let (coarse, fine) = (walk(40), walk(4000));
            let bound = [1e-9, 1e-12, 1e-14][known - 1];
            assert!((coarse - fine).abs() < bound, "{known} {coarse} {fine}");
        }
    }
}
