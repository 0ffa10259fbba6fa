//! The motors' motion, as it was recorded.

use super::equation::MotorSample;
use crate::check::{expect_at_least, expect_finite, expect_length, expect_rising};
use crate::error::DesignError;

/// How motors moved, row-major, one row a sample; nothing is missing.
#[derive(Clone, Debug)]
pub struct MotorMotion {
    /// Times [s].
    pub t: Vec<f64>,
    /// Positions (n) [rad].
    pub theta: Vec<f64>,
    /// Velocities (n) [rad/s].
    pub dtheta: Vec<f64>,
    /// Accelerations (n) [rad/s²].
    pub ddtheta: Vec<f64>,
}

impl MotorMotion {
    /// # Errors
    /// Arrays that do not belong together, numbers that are not finite, times that do not rise.
    pub(super) fn check(&self, n: usize) -> Result<(), DesignError> {
        for (what, values) in [("theta", &self.theta), ("dtheta", &self.dtheta), ("ddtheta", &self.ddtheta)] {
            expect_length(what, values.len(), self.t.len() * n)?;
            expect_finite(what, values)?;
        }
        expect_at_least("t", self.t.len(), 2)?;
        expect_rising("t", &self.t)
    }

    /// Motors at the share `c` of the step after `row`, by Hermite's cubics.
    pub(super) fn at(&self, row: usize, c: f64, out: &mut MotorSample) {
        let n = out.theta.len();
        let h = self.t[row + 1] - self.t[row];
        let (a, b) = (row * n..(row + 1) * n, (row + 1) * n..(row + 2) * n);
        let rest = 1.0 - c;
        let weights = [(1.0 + 2.0 * c) * rest * rest, c * c * (3.0 - 2.0 * c), h * c * rest * rest, -h * c * c * rest];
        let cubic = |x: &[f64], dx: &[f64], out: &mut [f64]| {
            let [from, to] = [a.clone(), b.clone()].map(|r| (&x[r.clone()], &dx[r]));
            for (j, out) in out.iter_mut().enumerate() {
                let slopes = weights[2] * from.1[j] + weights[3] * to.1[j];
                *out = weights[0] * from.0[j] + weights[1] * to.0[j] + slopes;
            }
        };
        cubic(&self.theta, &self.dtheta, &mut out.theta);
        cubic(&self.dtheta, &self.ddtheta, &mut out.dtheta);
        for (j, out) in out.ddtheta.iter_mut().enumerate() {
            *out = rest * self.ddtheta[a.start + j] + c * self.ddtheta[b.start + j];
        }
    }
}
