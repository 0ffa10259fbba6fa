//! Three-vectors.

use crate::scalar::Scalar;
use core::ops::{Add, AddAssign, Mul, Neg, Sub, SubAssign};

/// A vector in space.
///
/// Written out entry by entry: `map` and `from_fn` are calls that do not always dissolve, and one call that stays costs
/// a kernel its vector instructions.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Vec3<T>(pub [T; 3]);

impl<T: Scalar> Vec3<T> {
    /// A constant vector.
    #[inline(always)]
    pub fn constant(v: &Vec3<f64>) -> Self {
        Self([T::constant(v.0[0]), T::constant(v.0[1]), T::constant(v.0[2])])
    }

    /// Scalar product.
    #[inline(always)]
    pub fn dot(&self, o: &Self) -> T {
        self.0[0] * o.0[0] + self.0[1] * o.0[1] + self.0[2] * o.0[2]
    }

    /// Scalar product with a constant vector.
    #[inline(always)]
    pub fn dot_constant(&self, o: &Vec3<f64>) -> T {
        self.0[0] * o.0[0] + self.0[1] * o.0[1] + self.0[2] * o.0[2]
    }

    /// Vector product `self × o`.
    #[inline(always)]
    pub fn cross(&self, o: &Self) -> Self {
        let ([a, b, c], [x, y, z]) = (self.0, o.0);
        Self([b * z - c * y, c * x - a * z, a * y - b * x])
    }

    /// `self · k`.
    #[inline(always)]
    pub fn scale(&self, k: T) -> Self {
        Self([self.0[0] * k, self.0[1] * k, self.0[2] * k])
    }
}

impl Vec3<f64> {
    /// Euclidean length.
    pub fn norm(&self) -> f64 {
        self.dot(self).sqrt()
    }
}

impl<T: Scalar> Add for Vec3<T> {
    type Output = Self;
    #[inline(always)]
    fn add(self, o: Self) -> Self {
        Self([self.0[0] + o.0[0], self.0[1] + o.0[1], self.0[2] + o.0[2]])
    }
}

impl<T: Scalar> Sub for Vec3<T> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, o: Self) -> Self {
        Self([self.0[0] - o.0[0], self.0[1] - o.0[1], self.0[2] - o.0[2]])
    }
}

impl<T: Scalar> Neg for Vec3<T> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self([-self.0[0], -self.0[1], -self.0[2]])
    }
}

impl<T: Scalar> Mul<f64> for Vec3<T> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, k: f64) -> Self {
        Self([self.0[0] * k, self.0[1] * k, self.0[2] * k])
    }
}

impl<T: Scalar> AddAssign for Vec3<T> {
    #[inline(always)]
    fn add_assign(&mut self, o: Self) {
        *self = *self + o;
    }
}

impl<T: Scalar> SubAssign for Vec3<T> {
    #[inline(always)]
    fn sub_assign(&mut self, o: Self) {
        *self = *self - o;
    }
}
