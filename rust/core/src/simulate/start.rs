//! Where a run begins.

use crate::check::{expect_finite, expect_length};
use crate::control::RobotState;
use crate::dynamics::{Kinematics, Loads};
use crate::error::DesignError;
use crate::robot::{Drive, Robot};

/// State and motor torques at the start, n numbers each; what is None holds the robot at rest where its links are.
///
/// A link that nothing drives hangs where its spring holds it, unless `theta` is given, too: then it is where `q` says.
#[derive(Clone, Debug, Default)]
pub struct SimulationStart {
    /// Link positions [rad]; else zero.
    pub q: Option<Vec<f64>>,
    /// Link velocities [rad/s]; else zero.
    pub dq: Option<Vec<f64>>,
    /// Motor positions [rad], not looked at where rigid; else where the springs hold gravity.
    pub theta: Option<Vec<f64>>,
    /// Motor velocities [rad/s], not looked at where rigid; else those at which torsions stay.
    pub dtheta: Option<Vec<f64>>,
    /// Motor torques before the first sample [N m]; else gravity's.
    pub tau: Option<Vec<f64>>,
}

impl SimulationStart {
    /// The whole state and the torques, links being pushed by `push` (n) and varying wrenches being `wrench`.
    ///
    /// # Errors
    /// Not n finite numbers.
    pub(super) fn complete(
        self,
        robot: &Robot,
        push: &[f64],
        wrench: &[f64],
    ) -> Result<(RobotState, Vec<f64>), DesignError> {
        let n = robot.len();
        let given = [("q", &self.q), ("dq", &self.dq), ("theta", &self.theta), ("dtheta", &self.dtheta)];
        for (what, values) in given.into_iter().chain([("tau", &self.tau)]) {
            let Some(values) = values else { continue };
            expect_length(what, values.len(), n)?;
            expect_finite(what, values)?;
        }
        let mut q = self.q.unwrap_or_else(|| vec![0.0; n]);
        if self.theta.is_none() {
            hang(robot, &mut q, push, wrench);
        }
        let dq = self.dq.unwrap_or_else(|| vec![0.0; n]);
        let mut gravity = gravity(robot, &q, wrench);
        crate::linear::add_scaled(&mut gravity, -1.0, push);
        let hold = |((q, drive), load): ((&f64, &Drive), &f64)| {
            if drive.is_passive() {
                0.0
            } else if drive.elastic {
                drive.ripple.motor(q + drive.torsion(*load))
            } else {
                *q
            }
        };
        let theta = self.theta.unwrap_or_else(|| q.iter().zip(&robot.drives).zip(&gravity).map(hold).collect());
        let ratio = |(theta, drive): (&f64, &Drive)| drive.ripple.output(*theta).ratio;
        let ratios: Vec<_> = theta.iter().zip(&robot.drives).map(ratio).collect();
        let mut dtheta = self.dtheta.unwrap_or_else(|| dq.iter().zip(&ratios).map(|(dq, ratio)| dq / ratio).collect());
        for (dtheta, _) in dtheta.iter_mut().zip(&robot.drives).filter(|(_, drive)| drive.is_passive()) {
            *dtheta = 0.0;
        }
        let felt = || gravity.iter().zip(&ratios).map(|(load, ratio)| load * ratio).collect();
        let tau = self.tau.unwrap_or_else(felt);
        Ok((RobotState { q, dq, theta, dtheta }, tau))
    }
}

/// Puts links that nothing drives where their springs hold them, as near as this iteration settles.
fn hang(robot: &Robot, q: &mut [f64], push: &[f64], wrench: &[f64]) {
    if robot.drives.iter().all(|drive| !drive.is_passive()) {
        return;
    }
    for _ in 0..200 {
        let load = gravity(robot, q, wrench);
        let mut step: f64 = 0.0;
        for (j, drive) in robot.drives.iter().enumerate().filter(|(_, drive)| drive.is_passive()) {
            let rest = -drive.torsion(load[j] - push[j]);
            step = step.max((rest - q[j]).abs());
            q[j] = rest;
        }
        if step < 1e-15 || !step.is_finite() {
            break;
        }
    }
}

/// Torques that hold the links at rest at `q` under varying wrenches [N m].
fn gravity(robot: &Robot, q: &[f64], wrench: &[f64]) -> Vec<f64> {
    let (mut kinematics, zero) = (Kinematics::new(&robot.tree), vec![0.0; q.len()]);
    let mut out = zero.clone();
    kinematics.apply_wrenches(&robot.tree, wrench);
    kinematics.set(&robot.tree, q, &zero, &zero);
    Loads::new(&robot.tree).inverse_dynamics_into(&robot.tree, &kinematics, &mut out);
    out
}
