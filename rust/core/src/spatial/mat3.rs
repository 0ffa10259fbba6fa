//! Three-by-three matrices, general and symmetric.

use super::Vec3;
use crate::scalar::Scalar;
use core::ops::{Add, AddAssign};

/// A 3×3 matrix by columns; a rotation when it is a pose's.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Mat3<T>(pub [Vec3<T>; 3]);

impl<T: Scalar> Mat3<T> {
    /// A constant matrix.
    #[inline(always)]
    pub fn constant(m: &Mat3<f64>) -> Self {
        Self([Vec3::constant(&m.0[0]), Vec3::constant(&m.0[1]), Vec3::constant(&m.0[2])])
    }

    /// `self · v`.
    #[inline(always)]
    pub fn apply(&self, v: &Vec3<T>) -> Vec3<T> {
        self.0[0].scale(v.0[0]) + self.0[1].scale(v.0[1]) + self.0[2].scale(v.0[2])
    }

    /// `self · v` for a constant `v`.
    #[inline(always)]
    pub fn apply_constant(&self, v: &Vec3<f64>) -> Vec3<T> {
        self.0[0] * v.0[0] + self.0[1] * v.0[1] + self.0[2] * v.0[2]
    }

    /// `self · m`.
    #[inline(always)]
    pub fn mul(&self, m: &Self) -> Self {
        Self([self.apply(&m.0[0]), self.apply(&m.0[1]), self.apply(&m.0[2])])
    }

    /// `selfᵀ · v`.
    #[inline(always)]
    pub fn apply_transposed(&self, v: &Vec3<T>) -> Vec3<T> {
        Vec3([self.0[0].dot(v), self.0[1].dot(v), self.0[2].dot(v)])
    }

    /// `self · m` for a constant `m`.
    #[inline(always)]
    pub fn mul_constant(&self, m: &Mat3<f64>) -> Self {
        Self([self.apply_constant(&m.0[0]), self.apply_constant(&m.0[1]), self.apply_constant(&m.0[2])])
    }

    /// `self · Rz(angle)`, the angle given as its sine and cosine.
    #[inline(always)]
    pub fn turn_about_z(&self, (sin, cos): (T, T)) -> Self {
        let [x, y, z] = self.0;
        Self([x.scale(cos) + y.scale(sin), y.scale(cos) - x.scale(sin), z])
    }

    /// Sum of the diagonal.
    #[inline(always)]
    pub fn trace(&self) -> T {
        self.0[0].0[0] + self.0[1].0[1] + self.0[2].0[2]
    }
}

impl Mat3<f64> {
    /// The unit matrix.
    pub const IDENTITY: Self = Self([Vec3([1.0, 0.0, 0.0]), Vec3([0.0, 1.0, 0.0]), Vec3([0.0, 0.0, 1.0])]);

    /// `self · v`.
    #[inline(always)]
    pub fn turn<T: Scalar>(&self, v: &Vec3<T>) -> Vec3<T> {
        let [x, y, z] = v.0;
        let [a, b, c] = self.0.map(|column| column.0);
        Vec3([x * a[0] + y * b[0] + z * c[0], x * a[1] + y * b[1] + z * c[1], x * a[2] + y * b[2] + z * c[2]])
    }

    /// `selfᵀ · v`.
    #[inline(always)]
    pub fn turn_back<T: Scalar>(&self, v: &Vec3<T>) -> Vec3<T> {
        Vec3([v.dot_constant(&self.0[0]), v.dot_constant(&self.0[1]), v.dot_constant(&self.0[2])])
    }

    /// From rows, as people and NumPy write it.
    pub fn from_rows(r: [[f64; 3]; 3]) -> Self {
        Self(core::array::from_fn(|c| Vec3([r[0][c], r[1][c], r[2][c]])))
    }

    /// `selfᵀ`.
    pub fn transpose(&self) -> Self {
        Self::from_rows(self.0.map(|c| c.0))
    }

    /// A rotation that takes the z axis to the unit vector `axis`.
    pub fn z_to(axis: &Vec3<f64>) -> Self {
        // Any perpendicular will do: take the coordinate axis that `axis` leans on least.
        let least = (0..3).min_by(|&i, &j| axis.0[i].abs().total_cmp(&axis.0[j].abs())).unwrap_or(0);
        let mut unit = Vec3([0.0; 3]);
        unit.0[least] = 1.0;
        let x = unit - *axis * axis.dot(&unit);
        let x = x * (1.0 / x.norm());
        Self([x, axis.cross(&x), *axis])
    }
}

impl<T: Scalar> Add for Mat3<T> {
    type Output = Self;
    #[inline(always)]
    fn add(self, o: Self) -> Self {
        Self([self.0[0] + o.0[0], self.0[1] + o.0[1], self.0[2] + o.0[2]])
    }
}

/// A symmetric 3×3 matrix: `xx, xy, xz, yy, yz, zz`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sym3<T>(pub [T; 6]);

impl<T: Scalar> Sym3<T> {
    /// `R · m · Rᵀ` for a constant `m`.
    #[inline(always)]
    pub fn rotated(m: &Sym3<f64>, r: &Mat3<T>) -> Self {
        let [xx, xy, xz, yy, yz, zz] = m.0;
        let row = |row: [f64; 3]| r.apply_constant(&Vec3(row));
        let rows = [row([xx, xy, xz]), row([xy, yy, yz]), row([xz, yz, zz])];
        // rows[k] is column k of R·m; entry (i, j) sums over k.
        let entry =
            |i: usize, j: usize| rows[0].0[i] * r.0[0].0[j] + rows[1].0[i] * r.0[1].0[j] + rows[2].0[i] * r.0[2].0[j];
        Self([entry(0, 0), entry(0, 1), entry(0, 2), entry(1, 1), entry(1, 2), entry(2, 2)])
    }

    /// `R · self · Rᵀ`.
    #[inline(always)]
    pub fn turned(&self, r: &Mat3<T>) -> Self {
        let [a, b, c] = self.columns();
        let rows = [r.apply(&a), r.apply(&b), r.apply(&c)];
        let entry =
            |i: usize, j: usize| rows[0].0[i] * r.0[0].0[j] + rows[1].0[i] * r.0[1].0[j] + rows[2].0[i] * r.0[2].0[j];
        Self([entry(0, 0), entry(0, 1), entry(0, 2), entry(1, 1), entry(1, 2), entry(2, 2)])
    }

    /// `R · self · Rᵀ` for a constant `R`.
    #[inline(always)]
    pub(crate) fn turned_by(&self, r: &Mat3<f64>) -> Self {
        let [a, b, c] = self.columns();
        let [a, b, c] = [r.turn(&a).0, r.turn(&b).0, r.turn(&c).0];
        // a, b and c are the columns of R·self; entry (i, j) sums over them.
        let entry = |i: usize, j: usize| a[i] * r.0[0].0[j] + b[i] * r.0[1].0[j] + c[i] * r.0[2].0[j];
        Self([entry(0, 0), entry(0, 1), entry(0, 2), entry(1, 1), entry(1, 2), entry(2, 2)])
    }

    /// `v · wᵀ`, known to be symmetric.
    #[inline(always)]
    pub fn outer(v: &Vec3<T>, w: &Vec3<T>) -> Self {
        let ([a, b, c], [x, y, z]) = (v.0, w.0);
        Self([a * x, a * y, a * z, b * y, b * z, c * z])
    }

    /// `self · v`.
    #[inline(always)]
    pub fn apply(&self, v: &Vec3<T>) -> Vec3<T> {
        let [x, y, z] = self.columns();
        Vec3([x.dot(v), y.dot(v), z.dot(v)])
    }

    /// The three columns.
    #[inline(always)]
    pub fn columns(&self) -> [Vec3<T>; 3] {
        let [xx, xy, xz, yy, yz, zz] = self.0;
        [Vec3([xx, xy, xz]), Vec3([xy, yy, yz]), Vec3([xz, yz, zz])]
    }

    /// Sum of the diagonal.
    #[inline(always)]
    pub fn trace(&self) -> T {
        self.0[0] + self.0[3] + self.0[5]
    }
}

impl<T: Scalar> AddAssign for Sym3<T> {
    #[inline(always)]
    fn add_assign(&mut self, o: Self) {
        for i in 0..6 {
            self.0[i] += o.0[i];
        }
    }
}
