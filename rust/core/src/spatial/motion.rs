//! Spatial motions and forces, taken at the base origin.

use super::Vec3;
use crate::scalar::Scalar;
use core::ops::{Add, AddAssign};

/// A twist, a spatial acceleration or a joint's axis: angular part, and linear part of the point now at the origin.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Motion<T> {
    /// Angular part.
    pub angular: Vec3<T>,
    /// Linear part at the base origin.
    pub linear: Vec3<T>,
}

/// A wrench or a momentum: moment about the base origin, and force.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Force<T> {
    /// Moment about the base origin.
    pub moment: Vec3<T>,
    /// Force.
    pub force: Vec3<T>,
}

impl<T: Scalar> Motion<T> {
    /// `self · k`.
    #[inline(always)]
    pub fn scale(&self, k: T) -> Self {
        Self { angular: self.angular.scale(k), linear: self.linear.scale(k) }
    }

    /// Cross product of motions, `self × o`.
    #[inline(always)]
    pub fn cross(&self, o: &Self) -> Self {
        Self {
            angular: self.angular.cross(&o.angular),
            linear: self.angular.cross(&o.linear) + self.linear.cross(&o.angular),
        }
    }

    /// Cross product with a force, `self ×* f`.
    #[inline(always)]
    pub fn cross_force(&self, f: &Force<T>) -> Force<T> {
        Force {
            moment: self.angular.cross(&f.moment) + self.linear.cross(&f.force),
            force: self.angular.cross(&f.force),
        }
    }

    /// Power of `f` along this motion.
    #[inline(always)]
    pub fn dot(&self, f: &Force<T>) -> T {
        self.angular.dot(&f.moment) + self.linear.dot(&f.force)
    }

    /// The linear part at point `p`.
    #[inline(always)]
    pub fn at(&self, p: &Vec3<T>) -> Vec3<T> {
        self.linear + self.angular.cross(p)
    }
}

impl<T: Scalar> Add for Motion<T> {
    type Output = Self;
    #[inline(always)]
    fn add(self, o: Self) -> Self {
        Self { angular: self.angular + o.angular, linear: self.linear + o.linear }
    }
}

impl<T: Scalar> Add for Force<T> {
    type Output = Self;
    #[inline(always)]
    fn add(self, o: Self) -> Self {
        Self { moment: self.moment + o.moment, force: self.force + o.force }
    }
}

impl<T: Scalar> AddAssign for Force<T> {
    #[inline(always)]
    fn add_assign(&mut self, o: Self) {
        *self = *self + o;
    }
}
