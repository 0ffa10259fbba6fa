//! Accelerations of a robot whose joints are taken to be rigid.

use crate::dynamics::NewtonEuler;
use crate::linear::{factorise_joints, is_definite, solve, solve_joints};
use crate::robot::Robot;
use crate::spatial::Vec3;
use std::sync::Arc;

/// (M + B + S + Sᵀ) a + C v + friction + g = τ, solved for a.
#[derive(Clone, Debug)]
pub(super) struct RigidDynamics {
    pub(super) robot: Arc<Robot>,
    /// Whether torques are the motors', and their inertia and friction count.
    motors: bool,
    /// T [s], over half of which dry friction is taken implicitly.
    period: f64,
    /// M and C v + g of the links.
    links: NewtonEuler<f64>,
    /// What the motors add to M, n × n.
    added: Vec<f64>,
    /// The factorised inertia at the position that was set last.
    factor: Vec<f64>,
    /// n zeros.
    zero: Vec<f64>,
}

impl RigidDynamics {
    pub(super) fn new(robot: Arc<Robot>, motors: bool, period: f64) -> Self {
        let n = robot.len();
        let mut added = vec![0.0; n * n];
        if motors {
            for i in 0..n {
                added[i * n + i] = robot.drives[i].motor_inertia;
                for j in i + 1..n {
                    added[i * n + j] = robot.coupling[i * n + j];
                    added[j * n + i] = added[i * n + j];
                }
            }
        }
        let links = NewtonEuler::new(&robot.tree);
        Self { robot, motors, period, links, added, factor: vec![0.0; n * n], zero: vec![0.0; n] }
    }

    /// Factors the inertia at `q`; false when it is singular there.
    ///
    /// Dry friction is steep about standstill. Its slope at `v` over half a period goes into the inertia, a linearly
    /// implicit step, so that the explicit one is stable with any dry friction.
    #[inline(always)]
    pub(super) fn set_position(&mut self, q: &[f64], v: &[f64]) -> bool {
        let n = q.len();
        self.links.set_position(&self.robot.tree, q);
        self.links.mass_matrix_into(&self.robot.tree, &mut self.factor);
        for (entry, added) in self.factor.iter_mut().zip(&self.added) {
            *entry += added;
        }
        for (j, drive) in self.robot.drives.iter().enumerate() {
            if self.motors {
                self.factor[j * n + j] += 0.5 * self.period * drive.dry_friction_slope(v[j]);
            }
            self.factor[j * n + j] += 0.5 * self.period * drive.bearing_friction.dry(v[j]).1;
        }
        factorise_joints(&mut self.factor, n);
        is_definite(&self.factor, n)
    }

    /// Acceleration at velocity `v` under `torque`, at the position that was set.
    #[inline(always)]
    pub(super) fn acceleration_into(&mut self, v: &[f64], torque: &[f64], out: &mut [f64]) {
        let tree = &self.robot.tree;
        self.links.set_motion(tree, v, &self.zero);
        self.links.inverse_dynamics_into(tree, out);
        for (j, drive) in self.robot.drives.iter().enumerate() {
            let motor = if self.motors { drive.motor_friction(v[j]).0 } else { 0.0 };
            out[j] = torque[j] - out[j] - motor - drive.link_friction(v[j]).0;
        }
        self.solve(out);
    }

    /// M⁻¹ x, in place.
    #[inline(always)]
    pub(super) fn solve(&self, x: &mut [f64]) {
        solve_joints(&self.factor, x);
    }

    /// Largest eigenvalue of M⁻¹ diag(`spring`) [1/s²].
    pub(super) fn stiffest(&self, spring: &[f64]) -> f64 {
        let n = spring.len();
        let mut columns = vec![0.0; n * n];
        for (j, k) in spring.iter().enumerate() {
            columns[j * n + j] = k.sqrt();
        }
        solve(&self.factor, n, &mut columns, n);
        let scaled = |i: usize, j: usize| spring[i].sqrt() * columns[i * n + j];
        nalgebra::DMatrix::from_fn(n, n, scaled).symmetric_eigenvalues().max()
    }

    /// The tool at the position that was set, if there is one [m].
    pub(super) fn tool(&self) -> Option<Vec3<f64>> {
        self.robot.tool.as_ref().map(|tool| self.links.position(&self.robot.tree, tool))
    }
}
