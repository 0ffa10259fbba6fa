//! The spring's law: torque, slope, and the torsion that holds a torque.

use super::Drive;
use crate::scalar::Scalar;
use crate::simd::{self, Kernel};
use core::ops::{Add, Mul};

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
