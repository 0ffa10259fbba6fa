//! The channels of several particles at once: predictions alone.

use crate::dynamics::NewtonEuler;
use crate::estimate::kalman::{Channel, JerkModel};
use crate::robot::Drive;
use crate::scalar::Scalar;

/// Scratch and results of an evaluation.
#[derive(Clone, Debug)]
pub(super) struct Sensed<T> {
    /// h (channels), without bias.
    pub(super) prediction: Vec<T>,
    motion: NewtonEuler<T>,
    tau: Vec<T>,
}

impl<T: Scalar> Sensed<T> {
    pub(super) fn new(model: &JerkModel) -> Self {
        let (tree, n, m) = (&model.robot.tree, model.joints(), model.channels());
        let room = |size| vec![T::default(); size];
        Self {
            prediction: room(m),
            motion: NewtonEuler::new(tree),
            tau: room(n),
        }
    }

    /// Predictions alone at `state` = (q, q̇, q̈); `dtheta` (n) is each motor's velocity, NaN to leave its damping out.
    #[inline(always)]
    pub(super) fn predict(&mut self, model: &JerkModel, state: &[T], dtheta: &[f64]) {
        let (tree, n) = (&model.robot.tree, model.joints());
        self.motion.set(tree, &state[..n], &state[n..2 * n], &state[2 * n..3 * n]);
        self.motion.inverse_dynamics_into(tree, &mut self.tau);
        let mut row = 0;
        while row < model.channels.len() {
            row += self.read(model, row, state, dtheta);
        }
    }

    /// One channel, or all axes of a sensor; returns how many.
    #[inline(always)]
    fn read(&mut self, model: &JerkModel, row: usize, state: &[T], dtheta: &[f64]) -> usize {
        let (robot, n) = (&model.robot, model.joints());
        self.prediction[row] = match model.channels[row] {
            Channel::Motor(j) => state[j] + self.torsion(&robot.drives[j], j, state[n + j], dtheta[j]),
            Channel::Torque(j) => self.tau[j] + robot.drives[j].link_friction(state[n + j]).0,
            Channel::Link(j) => state[j],
            Channel::MotorVelocity(_) => T::default(),
            Channel::Acceleration { sensor, .. } => {
                let sensor = &robot.accelerometers[sensor];
                let force = self.motion.specific_force_of_body(&sensor.frame);
                return sensor.record_of_body(&force, &mut self.prediction[row..]);
            }
            Channel::Rate { sensor, .. } => {
                let sensor = &robot.gyroscopes[sensor];
                let rate = self.motion.angular_rate_of_body(&sensor.frame);
                return sensor.record_of_body(&rate, &mut self.prediction[row..]);
            }
        };
        1
    }

    /// Torsion of a drive.
    #[inline(always)]
    fn torsion(&self, drive: &Drive, j: usize, dq: T, dtheta: f64) -> T {
        if !drive.elastic {
            return T::default();
        }
        let (damping, rate) = if dtheta.is_nan() { (0.0, T::default()) } else { (drive.damping, -dq + dtheta) };
        drive.torsion(self.tau[j] + drive.link_friction(dq).0 - rate * damping)
    }
}
