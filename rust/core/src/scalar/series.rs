//! Truncated power series in time: a signal with its derivatives.

use super::Scalar;
use core::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

/// The first `P` Taylor coefficients f⁽ᵏ⁾/k! of a signal at one moment; exact, as each operation applies its own recurrence.
///
/// A function of signals that are known up to the p-th derivative gives its own up to the p-th at a cost of O(p²) an
/// operation (Griewank and Walther, Evaluating Derivatives, 2008, chapter 13).
///
/// ```
/// use linkside_core::scalar::{Scalar, Series};
/// let time = Series::<4>([0.0, 1.0, 0.0, 0.0]);
/// let (sin, _) = time.sin_cos();
/// assert_eq!(sin, Series([0.0, 1.0, 0.0, -1.0 / 6.0]));
/// assert_eq!(sin.rate(), Series([1.0, 0.0, -0.5, 0.0]));
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Series<const P: usize>(pub [f64; P]);

impl<const P: usize> Series<P> {
    /// A signal from its derivatives, the signal itself first; what is not given is taken for zero.
    #[inline(always)]
    pub fn from_derivatives(derivatives: impl IntoIterator<Item = f64>) -> Self {
        let mut series = Self([0.0; P]);
        let mut factorial = 1.0;
        for (k, (c, derivative)) in series.0.iter_mut().zip(derivatives).enumerate() {
            factorial *= k.max(1) as f64;
            *c = derivative / factorial;
        }
        series
    }

    /// The signal now.
    #[inline(always)]
    pub fn value(self) -> f64 {
        self.0[0]
    }

    /// The signal's derivative in time; its last coefficient is not known and zero.
    #[inline(always)]
    pub fn rate(self) -> Self {
        Self(core::array::from_fn(|k| if k + 1 < P { self.0[k + 1] * (k + 1) as f64 } else { 0.0 }))
    }

    /// The first `Q` coefficients, those beyond `P` zero.
    #[inline(always)]
    pub fn resized<const Q: usize>(self) -> Series<Q> {
        let mut series = Series([0.0; Q]);
        for k in 0..P.min(Q) {
            series.0[k] = self.0[k];
        }
        series
    }

    /// Coefficient k of the product of `self` and `other`.
    ///
    /// Leibniz's rule without its binomials, as coefficients are derivatives over factorials.
    #[inline(always)]
    fn convolution(&self, other: &Self, k: usize) -> f64 {
        (0..=k).map(|j| self.0[j] * other.0[k - j]).sum()
    }

    /// Coefficient k ≥ 1 of the integral of `self`' · `factor`.
    ///
    /// From (f∘g)' = f'(g) g': every elementary function here is one such line, with f' in terms of f.
    #[inline(always)]
    fn chain(&self, factor: &Self, k: usize) -> f64 {
        let sum: f64 = (1..=k).map(|j| j as f64 * self.0[j] * factor.0[k - j]).sum();
        sum / k as f64
    }
}

impl<const P: usize> Default for Series<P> {
    fn default() -> Self {
        Self([0.0; P])
    }
}

impl<const P: usize> Scalar for Series<P> {
    #[inline(always)]
    fn constant(value: f64) -> Self {
        Self::default() + value
    }

    #[inline(always)]
    fn sin_cos(self) -> (Self, Self) {
        let (s, c) = Scalar::sin_cos(self.0[0]);
        let (mut sin, mut cos) = (Self::constant(s), Self::constant(c));
        for k in 1..P {
            sin.0[k] = self.chain(&cos, k);
            cos.0[k] = -self.chain(&sin, k);
        }
        (sin, cos)
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        let mut root = Self::constant(self.0[0].sqrt());
        for k in 1..P {
            let known: f64 = (1..k).map(|j| root.0[j] * root.0[k - j]).sum();
            root.0[k] = (self.0[k] - known) / (2.0 * root.0[0]);
        }
        root
    }

    #[inline(always)]
    fn exp(self) -> Self {
        let mut exp = Self::constant(Scalar::exp(self.0[0]));
        for k in 1..P {
            exp.0[k] = self.chain(&exp, k);
        }
        exp
    }

    #[inline(always)]
    fn ln(self) -> Self {
        let mut ln = Self::constant(Scalar::ln(self.0[0]));
        for k in 1..P {
            // From x (ln x)' = x'.
            let known: f64 = (1..k).map(|j| j as f64 * ln.0[j] * self.0[k - j]).sum();
            ln.0[k] = (self.0[k] - known / k as f64) / self.0[0];
        }
        ln
    }

    #[inline(always)]
    fn tanh(self) -> Self {
        let mut tanh = Self::constant(Scalar::tanh(self.0[0]));
        let mut bell = Self::default();
        for k in 1..P {
            bell.0[k - 1] = f64::from(k == 1) - tanh.convolution(&tanh, k - 1);
            tanh.0[k] = self.chain(&bell, k);
        }
        tanh
    }

    #[inline(always)]
    fn map(self, f: impl Fn(f64) -> f64) -> Self {
        Self::constant(f(self.0[0]))
    }
}

impl<const P: usize> Add for Series<P> {
    type Output = Self;
    #[inline(always)]
    fn add(mut self, other: Self) -> Self {
        self += other;
        self
    }
}

impl<const P: usize> Sub for Series<P> {
    type Output = Self;
    #[inline(always)]
    fn sub(mut self, other: Self) -> Self {
        self -= other;
        self
    }
}

impl<const P: usize> Mul for Series<P> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        Self(core::array::from_fn(|k| self.convolution(&other, k)))
    }
}

impl<const P: usize> Div for Series<P> {
    type Output = Self;
    #[inline(always)]
    fn div(self, other: Self) -> Self {
        let mut quotient = Self::default();
        for k in 0..P {
            let known: f64 = (1..=k).map(|j| other.0[j] * quotient.0[k - j]).sum();
            quotient.0[k] = (self.0[k] - known) / other.0[0];
        }
        quotient
    }
}

impl<const P: usize> Neg for Series<P> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self(self.0.map(|c| -c))
    }
}

impl<const P: usize> Mul<f64> for Series<P> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, factor: f64) -> Self {
        Self(self.0.map(|c| c * factor))
    }
}

impl<const P: usize> Add<f64> for Series<P> {
    type Output = Self;
    #[inline(always)]
    fn add(mut self, c: f64) -> Self {
        self.0[0] += c;
        self
    }
}

impl<const P: usize> AddAssign for Series<P> {
    #[inline(always)]
    fn add_assign(&mut self, other: Self) {
        for (c, o) in self.0.iter_mut().zip(other.0) {
            *c += o;
        }
    }
}

impl<const P: usize> SubAssign for Series<P> {
    #[inline(always)]
    fn sub_assign(&mut self, other: Self) {
        for (c, o) in self.0.iter_mut().zip(other.0) {
            *c -= o;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scalar::Dual;

    const A: Series<7> = Series([0.4, -1.2, 0.7, 0.3, -0.5, 0.9, 0.1]);
    const B: Series<7> = Series([1.3, 0.6, -0.2, 0.8, 0.4, -0.7, 0.2]);

    fn near(a: Series<7>, b: Series<7>) {
        for k in 0..7 {
            assert!((a.0[k] - b.0[k]).abs() < 1e-13 * (1.0 + a.0[k].abs()), "{k}: {a:?} {b:?}");
        }
    }

    #[test]
    fn functions_keep_their_identities_in_every_coefficient() {
        let one = Series::constant(1.0);
        let (sin, cos) = A.sin_cos();
        near(sin * sin + cos * cos, one);
        near(A / B * B, A);
        near(B.sqrt() * B.sqrt(), B);
        near(A.exp() * (-A).exp(), one);
        let square = (A * 2.0).exp();
        near(A.tanh(), (square - one) / (square + one));
    }

    #[test]
    fn closed_forms_of_time_are_met() {
        let time = Series::<7>([0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        let of_sine = time.sin_cos().0.exp(); // exp(sin t) = 1 + t + t²/2 − t⁴/8 − t⁵/15 − t⁶/240
        near(of_sine, Series([1.0, 1.0, 0.5, 0.0, -1.0 / 8.0, -1.0 / 15.0, -1.0 / 240.0]));
        near((-time + 1.0).map(|_| 1.0) / (-time + 1.0), Series([1.0; 7]));
        near(Series::from_derivatives([2.0, 3.0, 8.0, 6.0]), Series([2.0, 3.0, 4.0, 1.0, 0.0, 0.0, 0.0]));
    }

    #[test]
    fn the_first_derivative_is_that_of_dual_numbers() {
        fn f<T: Scalar>(x: T) -> T {
            (x * x + 0.3).sqrt() * x.tanh() - x.sin_cos().0 / (x.exp() + 2.0)
        }
        let dual = f(Dual::<1>::variable(A.0[0], 0));
        let series = f(A);
        assert!((series.0[0] - dual.value).abs() < 1e-15);
        assert!((series.0[1] - dual.gradient[0] * A.0[1]).abs() < 1e-15);
    }
}
