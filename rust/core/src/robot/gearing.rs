//! Gears that several motors share, as in the wrists of heavy arms.

use super::Robot;
use crate::check::{expect_of, expect_parts};
use crate::error::RobotError;
use crate::scalar::Scalar;

/// What several motors turn together: the output before the spring of each of `joints` stands at Γ q_m, the motors at q_m.
///
/// Motors are seen through Γ, as one motor is through its gear ratio: θ = Γ q_m and τ = Γ⁻ᵀ τ_m, so that power is the same. Their
/// inertia is then a full matrix, Γ⁻ᵀ diag(B) Γ⁻¹, and their friction Γ⁻ᵀ f(Γ⁻¹ θ̇), with B and f of each motor's own drive.
#[derive(Clone, Debug, PartialEq)]
pub struct Gearing {
    /// Joints that share motors, m of them.
    pub(crate) joints: Vec<usize>,
    /// Γ, m × m: speeds of the outputs by those of their motors.
    matrix: Vec<f64>,
    /// Γ⁻¹.
    to_motors: Vec<f64>,
    /// Γ diag(B)⁻¹ Γᵀ diag(B), m × m: from torques over each motor's own inertia to accelerations of the outputs.
    sharing: Vec<f64>,
}

impl Gearing {
    /// Whether joint `j` is turned by several motors.
    pub(crate) fn has(&self, j: usize) -> bool {
        self.joints.contains(&j)
    }

    /// Accelerations in place of torques over each motor's own inertia, which stand at `at(j)`.
    #[inline(always)]
    pub(crate) fn share<T: Scalar>(&self, values: &mut [T], at: impl Fn(usize) -> usize) {
        let mut before = [T::default(); MOST];
        for (before, &j) in before.iter_mut().zip(&self.joints) {
            *before = values[at(j)];
        }
        for (row, &j) in self.sharing.chunks_exact(self.joints.len()).zip(&self.joints) {
            values[at(j)] = row.iter().zip(&before).fold(T::default(), |sum, (&share, &x)| sum + x * share);
        }
    }

    /// Each motor, by the joint whose drive has its numbers.
    #[inline(always)]
    pub(crate) fn motors(&self) -> impl Iterator<Item = Motor<'_>> {
        let (m, each) = (self.joints.len(), self.joints.iter().zip(self.to_motors.chunks_exact(self.joints.len())));
        each.enumerate().map(move |(i, (&drive, row))| Motor { gearing: self, drive, row, column: i..m * m })
    }

    /// The motor of joint `j`, if several turn it.
    pub(crate) fn motor(&self, j: usize) -> Option<Motor<'_>> {
        self.motors().find(|motor| motor.drive == j)
    }
}

/// One of the motors that joints share.
pub(crate) struct Motor<'a> {
    gearing: &'a Gearing,
    /// The joint whose drive has its inertia and friction.
    pub(crate) drive: usize,
    /// Its row of Γ⁻¹, and where its column of Γ is.
    row: &'a [f64],
    column: core::ops::Range<usize>,
}

impl Motor<'_> {
    /// Joints that it turns, or that turn it, with Γ⁻¹.
    #[inline(always)]
    pub(crate) fn joints(&self) -> impl Iterator<Item = (usize, f64)> {
        self.gearing.joints.iter().copied().zip(self.row.iter().copied())
    }

    /// Its speed or acceleration, outputs having `of(j)`.
    #[inline(always)]
    pub(crate) fn speed<T: Scalar>(&self, of: impl Fn(usize) -> T) -> T {
        self.joints().fold(T::default(), |sum, (j, by)| sum + of(j) * by)
    }

    /// Its torque, that on outputs being `of(j)`.
    pub(crate) fn torque(&self, of: impl Fn(usize) -> f64) -> f64 {
        let column = self.gearing.matrix[self.column.clone()].iter().step_by(self.row.len());
        self.gearing.joints.iter().zip(column).map(|(&j, by)| of(j) * by).sum()
    }
}

/// No more joints share their motors.
const MOST: usize = 8;

impl Robot {
    /// The same with gears that several motors share: `matrix` is Γ, of `joints` in rows and of their motors in columns.
    ///
    /// # Errors
    /// A matrix that does not fit or has no inverse; of its joints one that is rigid or has no motor, or a motor that is coupled
    /// to links, or whose friction grows with load.
    pub fn with_gearing(mut self, joints: Vec<usize>, matrix: &[f64]) -> Result<Self, RobotError> {
        let (m, n) = (joints.len(), self.len());
        expect_parts("gearing", matrix.len(), m * m)?;
        expect_of(m <= MOST, "gearing", || "the robot".into(), m as f64, "at most 8 joints")?;
        for &j in &joints {
            let owner = || format!("joint {j}");
            expect_of(j < n, "gearing", owner, j as f64, "a joint that there is")?;
            let drive = &self.drives[j];
            let driven = drive.elastic && !drive.is_passive();
            expect_of(driven, "gearing", owner, 1.0, "none, as the joint is rigid or has no motor")?;
            let coupled = (0..n).any(|i| self.coupling[i * n + j] != 0.0) || self.rotors.iter().any(|r| r.motor == j);
            expect_of(!coupled, "gearing", owner, 1.0, "none, as its motor is coupled to links")?;
            expect_of(drive.gear_loss.is_none(), "gearing", owner, 1.0, "none, as its friction grows with load")?;
        }
        let found = inverse(matrix, m);
        expect_of(found.is_some(), "determinant", || "the gearing".into(), 0.0, "one that is not zero")?;
        let to_motors = found.unwrap_or_default();
        let inertia = |a: usize| self.drives[joints[a]].motor_inertia;
        let entry = |(a, b): (usize, usize)| -> f64 {
            (0..m).map(|i| matrix[a * m + i] * matrix[b * m + i] / inertia(i)).sum::<f64>() * inertia(b)
        };
        let sharing = (0..m * m).map(|k| entry((k / m, k % m))).collect();
        self.gearing = (m > 0).then_some(Gearing { joints, matrix: matrix.to_vec(), to_motors, sharing });
        Ok(self)
    }
}

/// The inverse of `matrix` (m × m), if there is one.
fn inverse(matrix: &[f64], m: usize) -> Option<Vec<f64>> {
    let found = nalgebra::DMatrix::from_row_slice(m, m, matrix).try_inverse()?;
    let rows: Vec<f64> = found.transpose().iter().copied().collect();
    rows.iter().all(|x| x.is_finite()).then_some(rows)
}
