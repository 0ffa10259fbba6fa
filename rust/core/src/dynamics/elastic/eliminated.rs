//! Motors that torques move: eliminated from the equation of the links, and found after it.

use super::ElasticDynamics;
use crate::robot::Robot;
use crate::scalar::Scalar;

impl<T: Scalar> ElasticDynamics<T> {
    /// What motors add to the links' inertia: that of rigid joints, and of others −S B⁻¹ Sᵀ, θ̈ being eliminated.
    #[inline(always)]
    pub(super) fn couple_inertia(&mut self, robot: &Robot) {
        let n = robot.len();
        let Self { coupling, mass, .. } = self;
        for (j, drive) in robot.drives.iter().enumerate() {
            if !drive.elastic {
                mass[j * n + j] += T::constant(drive.motor_inertia);
                for (i, s) in coupling.links(j) {
                    mass[i * n + j] += s;
                    mass[j * n + i] += s;
                }
                continue;
            }
            for (i, s) in coupling.coupled(j) {
                let share = s / T::constant(drive.motor_inertia);
                for (k, s) in coupling.links(j) {
                    mass[i * n + k] -= share * s;
                }
            }
        }
    }

    /// And to their torque: −S B⁻¹ (τ − f − (1 + ε′) τ_e).
    #[inline(always)]
    pub(super) fn couple_torques(&mut self, robot: &Robot) {
        let Self { coupling, ddq, drive: torque, spring, ratio, .. } = self;
        for (j, drive) in robot.drives.iter().enumerate().filter(|(_, drive)| drive.elastic) {
            for (i, s) in coupling.coupled(j) {
                let share = s / T::constant(drive.motor_inertia);
                ddq[i] -= share * (torque[j] - ratio[j] * spring[j]);
            }
        }
    }

    /// θ̈ from the motors' rows, once q̈ is known.
    #[inline(always)]
    pub(super) fn take_motors(&mut self, robot: &Robot) {
        for (j, drive) in robot.drives.iter().enumerate() {
            self.ddtheta[j] = if drive.elastic {
                // The motor's row once q̈ is known: B θ̈ = τ − f − (1 + ε′) τ_e − (Sᵀ q̈)ⱼ.
                let pull = self.coupling.pull(j, &self.ddq);
                (self.drive[j] - self.ratio[j] * self.spring[j] - pull) / T::constant(drive.motor_inertia)
            } else {
                self.ddq[j]
            };
        }
        if let Some(gearing) = &robot.gearing {
            gearing.share(&mut self.ddtheta, |j| j);
        }
    }
}
