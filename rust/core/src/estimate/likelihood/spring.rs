//! A spring whose numbers have derivatives.

use super::parameters::JointParameters;
use crate::robot::{Drive, SoftWindup};
use crate::scalar::Scalar;

/// Torsion that holds `torque`, and one over the spring's slope there; `law` has what is not free.
///
/// φ(δ) = K δ + K₃ δ³ − k exp(−a δ²) δ, solved by Newton's method on values; one more step gives a derivative number its
/// slope in the torque and in the spring's own numbers.
#[inline(always)]
pub(super) fn torsion<T: Scalar>(joint: &JointParameters<T>, law: &Drive, torque: T) -> (T, T) {
    let one = T::constant(1.0);
    let mut torsion = (torque / joint.stiffness).map(|x| x);
    for _ in 0..50 {
        let (force, slope) = at(joint, law, torsion);
        let step = ((force - torque) / slope).map(|x| x);
        torsion -= step;
        // A thousandth of the step is lost to rounding: one more converges.
        if torsion + step * 1e-3 == torsion {
            break;
        }
    }
    let (force, slope) = at(joint, law, torsion);
    let torsion = torsion + (torque - force) / slope;
    (torsion, one / at(joint, law, torsion).1)
}

/// Torque and slope at a torsion.
#[inline(always)]
fn at<T: Scalar>(joint: &JointParameters<T>, law: &Drive, torsion: T) -> (T, T) {
    let square = torsion * torsion;
    let cubic = joint.cubic_stiffness * square;
    let (mut secant, mut slope) = (joint.stiffness + cubic, joint.stiffness + cubic * 3.0);
    let SoftWindup { stiffness, shape } = law.soft_windup;
    if stiffness != 0.0 {
        let missing = (square * -shape).exp() * stiffness;
        secant -= missing;
        slope -= missing * (square * (-2.0 * shape) + 1.0);
    }
    (secant * torsion, slope)
}
