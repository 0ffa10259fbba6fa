//! Rotations that never change, from one joint's frame to the next.

use super::{Mat3, Sym3, Vec3};
use crate::scalar::Scalar;
use core::ops::Neg;

/// A direction so near to an axis is along it: a quarter turn that was given as an angle, or made of several.
const NEAR: f64 = 1e-15;

/// A constant rotation R. Between most joints of most robots it is a quarter turn or none, which takes no arithmetic.
#[derive(Clone, Debug)]
pub(crate) enum FixedRotation {
    /// R = 1.
    None,
    /// About x by 90°, −90° and 180°.
    AboutX,
    BackAboutX,
    HalfAboutX,
    /// About y by 90° and −90°.
    AboutY,
    BackAboutY,
    General(Mat3<f64>),
}

impl FixedRotation {
    /// One that takes the z axis to the unit vector `axis`.
    pub(crate) fn z_to(axis: &Vec3<f64>) -> Self {
        let quarters = [Self::None, Self::AboutX, Self::BackAboutX, Self::HalfAboutX, Self::AboutY, Self::BackAboutY];
        let z = Vec3([0.0, 0.0, 1.0]);
        let near = |rotation: &Self| (rotation.turn(&z) - *axis).0.iter().all(|apart| apart.abs() < NEAR);
        quarters.into_iter().find(near).unwrap_or_else(|| Self::General(Mat3::z_to(axis)))
    }

    /// R.
    pub(crate) fn matrix(&self) -> Mat3<f64> {
        self.after(&Mat3::IDENTITY)
    }

    /// Entries of R v for those of v; the matrix where it is more than that.
    #[inline(always)]
    fn forth<E: Copy + Neg<Output = E>>(&self, [x, y, z]: [E; 3]) -> Result<[E; 3], &Mat3<f64>> {
        Ok(match self {
            Self::None => [x, y, z],
            Self::AboutX => [x, -z, y],
            Self::BackAboutX => [x, z, -y],
            Self::HalfAboutX => [x, -y, -z],
            Self::AboutY => [z, y, -x],
            Self::BackAboutY => [-z, y, x],
            Self::General(matrix) => return Err(matrix),
        })
    }

    /// Of Rᵀ v likewise.
    #[inline(always)]
    fn back<E: Copy + Neg<Output = E>>(&self, [x, y, z]: [E; 3]) -> Result<[E; 3], &Mat3<f64>> {
        Ok(match self {
            Self::None => [x, y, z],
            Self::AboutX => [x, z, -y],
            Self::BackAboutX => [x, -z, y],
            Self::HalfAboutX => [x, -y, -z],
            Self::AboutY => [-z, y, x],
            Self::BackAboutY => [z, y, -x],
            Self::General(matrix) => return Err(matrix),
        })
    }

    /// R v.
    #[inline(always)]
    pub(crate) fn turn<T: Scalar>(&self, v: &Vec3<T>) -> Vec3<T> {
        self.forth(v.0).map_or_else(|matrix| matrix.turn(v), Vec3)
    }

    /// Rᵀ v.
    #[inline(always)]
    pub(crate) fn turn_back<T: Scalar>(&self, v: &Vec3<T>) -> Vec3<T> {
        self.back(v.0).map_or_else(|matrix| matrix.turn_back(v), Vec3)
    }

    /// M R.
    #[inline(always)]
    pub(crate) fn after<T: Scalar>(&self, m: &Mat3<T>) -> Mat3<T> {
        self.back(m.0).map_or_else(|matrix| m.mul_constant(matrix), Mat3)
    }

    /// R m Rᵀ.
    #[inline(always)]
    pub(crate) fn turn_tensor<T: Scalar>(&self, m: &Sym3<T>) -> Sym3<T> {
        match self.forth(m.columns()) {
            Err(matrix) => m.turned_by(matrix),
            Ok(columns) => {
                let [x, y, z] = columns.map(|column| self.turn(&column).0);
                Sym3([x[0], y[0], z[0], y[1], z[1], z[2]])
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const V: Vec3<f64> = Vec3([0.3, -1.2, 2.5]);
    const M: Sym3<f64> = Sym3([1.0, 0.2, -0.3, 2.0, 0.4, 3.0]);

    #[test]
    fn quarter_turns_are_the_products_by_their_matrices() {
        let axes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(Vec3);
        let mut quarters = 0;
        for axis in axes.into_iter().chain(axes.map(|axis| -axis)) {
            let rounded = axis + Vec3([1e-16, -1e-16, 2e-16]);
            quarters += usize::from(!matches!(check(&rounded), FixedRotation::General(_)));
        }
        assert_eq!(quarters, 6);
        for axis in [Vec3([0.6, 0.0, 0.8]), Vec3([1e-9, 0.0, 1.0])] {
            assert!(matches!(check(&axis), FixedRotation::General(_)));
        }
    }

    fn check(axis: &Vec3<f64>) -> FixedRotation {
        let rotation = FixedRotation::z_to(axis);
        let near = |a: &[f64], b: &[f64]| assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-14), "{a:?} {b:?}");
        let matrix = rotation.matrix();
        near(&matrix.0[2].0, &axis.0);
        near(&matrix.0[0].cross(&matrix.0[1]).0, &axis.0);
        near(&[matrix.0[0].norm(), matrix.0[1].norm(), matrix.0[0].dot(&matrix.0[1])], &[1.0, 1.0, 0.0]);
        near(&rotation.turn(&V).0, &matrix.apply(&V).0);
        near(&rotation.turn_back(&V).0, &matrix.apply_transposed(&V).0);
        near(&rotation.turn_tensor(&M).0, &M.turned(&matrix).0);
        let m = Mat3([V, V * 2.0, -V]);
        for (found, expected) in rotation.after(&m).0.iter().zip(m.mul(&matrix).0) {
            near(&found.0, &expected.0);
        }
        rotation
    }
}
