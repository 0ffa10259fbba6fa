//! Several samples or particles at once.

use super::{Scalar, trig};
use core::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

/// `L` independent numbers that go through a kernel together, one vector register or two, never across lines of the cache.
///
/// A plain array: the compiler chooses the instructions of whatever target the caller was compiled for.
/// Every lane holds the same bits that `f64` alone would.
///
/// ```
/// use linkside_core::scalar::{Lanes, Scalar};
/// let (sines, _) = Lanes([0.1, 0.2, 0.3, 0.4]).sin_cos();
/// assert_eq!(sines.0[2], Scalar::sin_cos(0.3).0); // to the last bit
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(align(64))]
pub struct Lanes<const L: usize>(pub [f64; L]);

impl<const L: usize> Lanes<L> {
    /// `f` of both, lane by lane.
    #[inline(always)]
    fn zip(mut self, other: Self, f: impl Fn(f64, f64) -> f64) -> Self {
        // A loop: `from_fn` and `map` are calls that do not always dissolve.
        for i in 0..L {
            self.0[i] = f(self.0[i], other.0[i]);
        }
        self
    }

    /// `f` of each lane.
    #[inline(always)]
    fn each(mut self, f: impl Fn(f64) -> f64) -> Self {
        for i in 0..L {
            self.0[i] = f(self.0[i]);
        }
        self
    }
}

impl<const L: usize> Default for Lanes<L> {
    fn default() -> Self {
        Self::constant(0.0)
    }
}

impl<const L: usize> Scalar for Lanes<L> {
    const LANES: bool = true;

    #[inline(always)]
    fn constant(value: f64) -> Self {
        Self([value; L])
    }

    #[inline(always)]
    fn sin_cos(self) -> (Self, Self) {
        let mut out = (Self::default(), Self::default());
        if self.0.iter().all(|x| trig::is_reducible(*x)) {
            for i in 0..L {
                (out.0.0[i], out.1.0[i]) = trig::reduced(self.0[i]);
            }
        } else {
            for i in 0..L {
                (out.0.0[i], out.1.0[i]) = trig::sin_cos(self.0[i]);
            }
        }
        out
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        self.each(f64::sqrt)
    }

    #[inline(always)]
    fn exp(self) -> Self {
        self.each(Scalar::exp)
    }

    #[inline(always)]
    fn ln(self) -> Self {
        self.each(Scalar::ln)
    }

    #[inline(always)]
    fn tanh(self) -> Self {
        self.each(Scalar::tanh)
    }

    #[inline(always)]
    fn map(self, f: impl Fn(f64) -> f64) -> Self {
        self.each(f)
    }
}

impl<const L: usize> Add for Lanes<L> {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        self.zip(other, |a, b| a + b)
    }
}

impl<const L: usize> Sub for Lanes<L> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        self.zip(other, |a, b| a - b)
    }
}

impl<const L: usize> Mul for Lanes<L> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        self.zip(other, |a, b| a * b)
    }
}

impl<const L: usize> Div for Lanes<L> {
    type Output = Self;
    #[inline(always)]
    fn div(self, other: Self) -> Self {
        self.zip(other, |a, b| a / b)
    }
}

impl<const L: usize> Neg for Lanes<L> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        self.each(|a| -a)
    }
}

impl<const L: usize> Mul<f64> for Lanes<L> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, c: f64) -> Self {
        self.each(|a| a * c)
    }
}

impl<const L: usize> Add<f64> for Lanes<L> {
    type Output = Self;
    #[inline(always)]
    fn add(self, c: f64) -> Self {
        self.each(|a| a + c)
    }
}

impl<const L: usize> AddAssign for Lanes<L> {
    #[inline(always)]
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl<const L: usize> SubAssign for Lanes<L> {
    #[inline(always)]
    fn sub_assign(&mut self, other: Self) {
        *self = *self - other;
    }
}
