//! What a harmonic drive lacks in stiffness around zero torsion.

use crate::scalar::Scalar;

/// Soft wind-up: −k·exp(−a δ²)·δ (Ulrich and Sasiadek 2011, eqs. (10)–(13)).
///
/// The sign is that of harmonic drives' data sheets, softer at low torque; with a negative k the spring is harder there.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SoftWindup {
    /// k [N m/rad].
    pub stiffness: f64,
    /// a [1/rad²].
    pub shape: f64,
}

impl SoftWindup {
    /// Torque over torsion, at a torsion of this `square` [N m/rad].
    #[inline(always)]
    pub fn secant<T: Scalar>(&self, square: T) -> T {
        match self.stiffness {
            0.0 => T::default(),
            k => -((square * -self.shape).exp() * k),
        }
    }

    /// Slope of the torque, at a torsion of this `square` [N m/rad].
    #[inline(always)]
    pub fn tangent<T: Scalar>(&self, square: T) -> T {
        match self.stiffness {
            0.0 => T::default(),
            _ => self.secant(square) * (square * (-2.0 * self.shape) + 1.0),
        }
    }

    /// The least slope of a spring that has this and `linear` [N m/rad] and `cubic` [N m/rad³] ≥ 0, at any torsion.
    ///
    /// Where k > 0 that is at rest. Where k < 0 it is at s = δ² with 3 c + k a e^{−as} (3 − 2as) = 0, by bisection.
    pub fn least_slope(&self, linear: f64, cubic: f64) -> f64 {
        let Self { stiffness: k, shape: a } = *self;
        let slope = |s: f64| linear + 3.0 * cubic * s + self.tangent(s);
        let falls = |s: f64| 3.0 * cubic + k * a * (-a * s).exp() * (3.0 - 2.0 * a * s) < 0.0;
        if !falls(0.0) {
            return slope(0.0);
        }
        let (mut low, mut high) = (0.0, 1.5 / a);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if falls(middle) { low = middle } else { high = middle }
        }
        slope(low)
    }
}
