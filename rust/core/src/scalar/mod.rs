//! The number types that one kernel text serves: `f64`, first derivatives ([`Dual`]), derivatives in time of
//! any order ([`Series`]) and several samples at once ([`Lanes`]).
//!
//! Every kernel of the crate is written once over [`Scalar`]. `f64` runs it, [`Dual`] differentiates it exactly by a
//! few parameters at a time, [`Series`] by time to any order, and [`Lanes`] runs several particles in one register with
//! the bits that each alone would have. Sine, exponential and logarithm are the crate's own: the platform's differ
//! between systems.

mod dual;
mod exponential;
mod lanes;
mod logarithm;
mod series;
mod trig;

pub use dual::Dual;
pub(crate) use exponential::exp_m1;
pub use lanes::Lanes;
pub(crate) use logarithm::{ln, log};
pub use series::Series;

use core::fmt::Debug;
use core::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

/// What a dynamics kernel asks of its numbers: a field with the functions of mechanics.
///
/// Constants of the robot stay `f64` and multiply from the right, so that a derivative number pays for them once.
/// No fused multiply-add: results are then the same bits on every processor, and lanes equal `f64` by `==`.
pub trait Scalar:
    Copy
    + Debug
    + Default
    + PartialEq
    + Send
    + Sync
    + 'static
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + Mul<f64, Output = Self>
    + Add<f64, Output = Self>
    + AddAssign
    + SubAssign
{
    /// Whether it is several numbers side by side.
    const LANES: bool = false;

    /// A constant.
    fn constant(value: f64) -> Self;

    /// `(sin self, cos self)`, self in radians, to within 1 ulp or so of the true values.
    fn sin_cos(self) -> (Self, Self);

    /// Square root.
    fn sqrt(self) -> Self;

    /// e^self, to within 2 ulp; below −708 it is zero, and 709 is taken for what exceeds it.
    fn exp(self) -> Self;

    /// Natural logarithm, to within 1 ulp or so; NaN of what is negative.
    fn ln(self) -> Self;

    /// Hyperbolic tangent, to within 2 ulp.
    fn tanh(self) -> Self;

    /// `f` of the value, or of each lane; a constant: derivatives are dropped.
    fn map(self, f: impl Fn(f64) -> f64) -> Self;
}

impl Scalar for f64 {
    #[inline(always)]
    fn constant(value: f64) -> Self {
        value
    }

    #[inline(always)]
    fn sin_cos(self) -> (Self, Self) {
        trig::sin_cos(self)
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        f64::sqrt(self)
    }

    #[inline(always)]
    fn exp(self) -> Self {
        exponential::exp(self)
    }

    #[inline(always)]
    fn ln(self) -> Self {
        logarithm::log(self)
    }

    #[inline(always)]
    fn tanh(self) -> Self {
        exponential::tanh(self)
    }

    #[inline(always)]
    fn map(self, f: impl Fn(f64) -> f64) -> Self {
        f(self)
    }
}
