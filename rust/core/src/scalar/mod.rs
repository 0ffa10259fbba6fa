//! The number types that one kernel text serves: `f64`, first derivatives ([`Dual`]) and several samples at once ([`Lanes`]).

mod dual;
mod lanes;
mod trig;

pub use dual::Dual;
pub use lanes::Lanes;

use core::fmt::Debug;
use core::ops::{Add, AddAssign, Mul, Neg, Sub, SubAssign};

/// What a dynamics kernel asks of its numbers: a ring with sine and cosine.
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
    + Neg<Output = Self>
    + Mul<f64, Output = Self>
    + Add<f64, Output = Self>
    + AddAssign
    + SubAssign
{
    /// A constant.
    fn constant(value: f64) -> Self;

    /// `(sin self, cos self)`, self in radians, to within 1 ulp or so of the true values.
    fn sin_cos(self) -> (Self, Self);
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
}
