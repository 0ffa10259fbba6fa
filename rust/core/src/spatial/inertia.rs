//! Mass as three moments, and what a moving mass does to a moving frame.

use super::{Force, Mat3, Motion, Sym3, Vec3};
use crate::scalar::Scalar;
use core::ops::AddAssign;

/// Moments of a body's mass about the base origin: ∫dm, ∫r dm and ∫r rᵀ dm. Bodies add.
///
/// The rotational inertia is `tr(second)·1 − second`.
///
/// ```
/// use linkside_core::spatial::{Inertia, Motion, Vec3};
/// // Two kilograms half a metre out, turning at 3 rad/s about z: 3 N s along y, and 1.5 N m s about z.
/// let mass = Inertia::point(2.0, &Vec3([0.5, 0.0, 0.0]));
/// let momentum = mass.apply(&Motion { angular: Vec3([0.0, 0.0, 3.0]), linear: Vec3([0.0; 3]) });
/// assert_eq!((momentum.force.0[1], momentum.moment.0[2]), (3.0, 1.5));
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Inertia<T> {
    /// ∫dm [kg].
    pub mass: T,
    /// ∫r dm [kg m].
    pub first: Vec3<T>,
    /// ∫r rᵀ dm [kg m²].
    pub second: Sym3<T>,
}

impl<T: Scalar> Inertia<T> {
    /// The moments of a mass `m` in the point `at`.
    pub fn point(m: T, at: &Vec3<T>) -> Self {
        let first = at.scale(m);
        Self { mass: m, first, second: Sym3::outer(at, &first) }
    }

    /// The same mass turned by `rotation`, then moved by `origin`.
    #[inline(always)]
    pub fn moved(&self, rotation: &Mat3<T>, origin: &Vec3<T>) -> Self {
        let offset = rotation.apply(&self.first);
        let first = offset + origin.scale(self.mass);
        let mut second = self.second.turned(rotation);
        second += Sym3::outer(&offset, origin);
        second += Sym3::outer(origin, &first);
        Self { mass: self.mass, first, second }
    }

    /// The same numbers as constants.
    #[inline(always)]
    pub(crate) fn constant(mass: &Inertia<f64>) -> Self {
        let [a, b, c, d, e, f] = mass.second.0.map(T::constant);
        Self { mass: T::constant(mass.mass), first: Vec3::constant(&mass.first), second: Sym3([a, b, c, d, e, f]) }
    }

    /// The same mass turned about z by an angle, given as its sine and cosine.
    #[inline(always)]
    pub(crate) fn turned_about_z(&self, (sin, cos): (T, T)) -> Self {
        let turn = |x: T, y: T| (x * cos - y * sin, y * cos + x * sin);
        let [xx, xy, xz, yy, yz, zz] = self.second.0;
        // Columns turn, then rows.
        let ((a, b), (c, d)) = (turn(xx, xy), turn(xy, yy));
        let ((xx, _), (xy, yy), (xz, yz)) = (turn(a, c), turn(b, d), turn(xz, yz));
        let (x, y) = turn(self.first.0[0], self.first.0[1]);
        Self { mass: self.mass, first: Vec3([x, y, self.first.0[2]]), second: Sym3([xx, xy, xz, yy, yz, zz]) }
    }

    /// The same mass moved by `by`.
    #[inline(always)]
    pub(crate) fn shifted(&self, by: &Vec3<T>) -> Self {
        let first = self.first + by.scale(self.mass);
        let mut second = self.second;
        // first·byᵀ + by·(first + m by)ᵀ is symmetric only as a sum.
        second += Sym3::outer(&self.first, by);
        second += Sym3::outer(by, &first);
        Self { mass: self.mass, first, second }
    }

    /// The same for a constant `by`.
    #[inline(always)]
    pub(crate) fn shifted_by(&self, by: &Vec3<f64>) -> Self {
        let ([x, y, z], m) = (by.0, self.mass);
        let first = self.first + Vec3([m * x, m * y, m * z]);
        let ([a, b, c], [d, e, f]) = (self.first.0, first.0);
        let mut second = self.second;
        second += Sym3([a * x + d * x, a * y + e * x, a * z + f * x, b * y + e * y, b * z + f * y, c * z + f * z]);
        Self { mass: m, first, second }
    }

    /// Momentum of the mass moving with twist `v`; or the force that gives it the spatial acceleration `v`.
    #[inline(always)]
    pub fn apply(&self, v: &Motion<T>) -> Force<T> {
        let w = &v.angular;
        Force {
            moment: w.scale(self.second.trace()) - self.second.apply(w) + self.first.cross(&v.linear),
            force: v.linear.scale(self.mass) + w.cross(&self.first),
        }
    }
}

impl<T: Scalar> AddAssign for Inertia<T> {
    #[inline(always)]
    fn add_assign(&mut self, o: Self) {
        self.mass += o.mass;
        self.first += o.first;
        self.second += o.second;
    }
}

/// First moments of a moving mass's velocity: ∫ẋ dm and ∫ẋ rᵀ dm. Bodies add.
///
/// In a frame that turns with angular velocity ω the mass needs the Coriolis force ∫2ω × ẋ dm. Half of that is the
/// operator B of Echeandia and Wensing (2021); in these moments it has twelve numbers in place of thirty-six.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Coriolis<T> {
    /// ∫ẋ dm.
    momentum: Vec3<T>,
    /// tr(Y)·1 − Y with Y = ∫ẋ rᵀ dm.
    turning: Mat3<T>,
}

impl<T: Scalar> Coriolis<T> {
    /// Of the mass `inertia` moving with twist `v`.
    #[inline(always)]
    pub fn new(inertia: &Inertia<T>, v: &Motion<T>) -> Self {
        let [a, b, c] = inertia.second.columns();
        let (first, angular, linear) = (inertia.first.0, v.angular, v.linear);
        let y = Mat3([
            angular.cross(&a) + linear.scale(first[0]),
            angular.cross(&b) + linear.scale(first[1]),
            angular.cross(&c) + linear.scale(first[2]),
        ]);
        let trace = y.trace();
        let mut turning = Mat3([-y.0[0], -y.0[1], -y.0[2]]);
        for k in 0..3 {
            turning.0[k].0[k] += trace;
        }
        Self { momentum: inertia.apply(v).force, turning }
    }

    /// `B · m`: ∫ω × ẋ dm and its moment, for the angular part ω of `m`.
    #[inline(always)]
    pub fn apply(&self, m: &Motion<T>) -> Force<T> {
        Force { moment: self.turning.apply(&m.angular), force: m.angular.cross(&self.momentum) }
    }

    /// The angular part of `Bᵀ · m`; the linear part is zero.
    #[inline(always)]
    pub fn apply_transposed(&self, m: &Motion<T>) -> Vec3<T> {
        self.turning.apply_transposed(&m.angular) + self.momentum.cross(&m.linear)
    }
}

impl<T: Scalar> AddAssign for Coriolis<T> {
    #[inline(always)]
    fn add_assign(&mut self, o: Self) {
        self.momentum += o.momentum;
        self.turning = self.turning + o.turning;
    }
}
