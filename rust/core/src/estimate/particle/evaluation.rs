//! The channels of several particles at once: predictions, and how they change with an increment of acceleration.

use crate::dynamics::{Kinematics, Loads, NewtonEuler};
use crate::estimate::kalman::{Channel, JerkModel};
use crate::robot::{Drive, Sensor};
use crate::scalar::Scalar;
use crate::spatial::Vec3;

/// Scratch and results of an evaluation.
#[derive(Clone, Debug)]
pub(super) struct Sensed<T> {
    /// h (channels), without bias.
    pub(super) prediction: Vec<T>,
    /// ∂h/∂w (channels × n) for an increment w of acceleration that acts from the start of the interval.
    pub(super) by_increment: Vec<T>,
    motion: NewtonEuler<T>,
    kinematics: Kinematics<T>,
    loads: Loads<T>,
    tau: Vec<T>,
    by_q: Vec<T>,
    by_dq: Vec<T>,
    mass: Vec<T>,
}

/// How much an increment of acceleration moves position, velocity and acceleration: T²/2, T and 1.
pub(super) type Reach = [f64; 3];

impl<T: Scalar> Sensed<T> {
    pub(super) fn new(model: &JerkModel) -> Self {
        let (tree, n, m) = (&model.robot.tree, model.joints(), model.channels());
        let room = |size| vec![T::default(); size];
        Self {
            prediction: room(m),
            by_increment: room(m * n),
            motion: NewtonEuler::new(tree),
            kinematics: Kinematics::new(tree),
            loads: Loads::new(tree),
            tau: room(n),
            by_q: room(n * n),
            by_dq: room(n * n),
            mass: room(n * n),
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
            Channel::Motor(j) => state[j] + self.torsion(&robot.drives[j], j, state[n + j], dtheta[j]).0,
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

    /// Torsion of a drive, its compliance, and how its torque changes with the link's speed.
    #[inline(always)]
    fn torsion(&self, drive: &Drive, j: usize, dq: T, dtheta: f64) -> (T, T, T) {
        if !drive.elastic {
            return (T::default(), T::default(), T::default());
        }
        let (friction, slope) = drive.link_friction(dq);
        let (damping, rate) = if dtheta.is_nan() { (0.0, T::default()) } else { (drive.damping, -dq + dtheta) };
        let torsion = drive.torsion(self.tau[j] + friction - rate * damping);
        let compliance = if drive.is_linear() {
            T::constant(1.0 / drive.stiffness)
        } else {
            T::constant(1.0) / drive.tangent_stiffness(torsion)
        };
        (torsion, compliance, slope + damping)
    }

    /// Predictions, and their derivatives along increments of acceleration (Axelsson, Karlsson and Norrlöf 2012,
    /// eqs. (10) and (12)–(17)).
    #[inline(always)]
    pub(super) fn linearise(&mut self, model: &JerkModel, state: &[T], dtheta: &[f64], reach: Reach) {
        let (tree, n) = (&model.robot.tree, model.joints());
        let Self { kinematics, loads, tau, by_q, by_dq, mass, .. } = self;
        kinematics.set(tree, &state[..n], &state[n..2 * n], &state[2 * n..3 * n]);
        loads.inverse_dynamics_derivatives_into(tree, kinematics, tau, by_q, by_dq, mass);
        self.by_increment.fill(T::default());
        let mut row = 0;
        while row < model.channels.len() {
            row += match model.channels[row] {
                Channel::Motor(j) => self.motor(&model.robot.drives[j], row, j, state, dtheta[j], reach),
                Channel::Torque(j) => self.torque(&model.robot.drives[j], row, j, state[n + j], reach),
                Channel::Link(j) => {
                    self.prediction[row] = state[j];
                    self.by_increment[row * n + j] = T::constant(reach[0]);
                    1
                }
                Channel::MotorVelocity(_) => 1,
                Channel::Acceleration { sensor, .. } => {
                    self.acceleration(model, row, &model.robot.accelerometers[sensor], reach)
                }
                Channel::Rate { sensor, .. } => self.rate(model, row, &model.robot.gyroscopes[sensor], reach),
            };
        }
    }

    #[inline(always)]
    fn motor(&mut self, drive: &Drive, row: usize, j: usize, state: &[T], dtheta: f64, reach: Reach) -> usize {
        let n = self.tau.len();
        let (torsion, compliance, slope) = self.torsion(drive, j, state[n + j], dtheta);
        self.prediction[row] = state[j] + torsion;
        if drive.elastic {
            self.load_row(row, j, compliance, reach);
        }
        self.by_increment[row * n + j] += compliance * slope * reach[1] + reach[0];
        1
    }

    #[inline(always)]
    fn torque(&mut self, drive: &Drive, row: usize, j: usize, dq: T, reach: Reach) -> usize {
        let (friction, slope) = drive.link_friction(dq);
        self.prediction[row] = self.tau[j] + friction;
        self.load_row(row, j, T::constant(1.0), reach);
        self.by_increment[row * self.tau.len() + j] += slope * reach[1];
        1
    }

    /// Row `row` ← `factor` times how joint j's torque changes.
    #[inline(always)]
    fn load_row(&mut self, row: usize, j: usize, factor: T, reach: Reach) {
        let n = self.tau.len();
        for k in 0..n {
            let i = j * n + k;
            let change = self.by_q[i] * reach[0] + self.by_dq[i] * reach[1] + self.mass[i] * reach[2];
            self.by_increment[row * n + k] = factor * change;
        }
    }

    #[inline(always)]
    fn acceleration(&mut self, model: &JerkModel, row: usize, sensor: &Sensor, reach: Reach) -> usize {
        let Self { kinematics, prediction, by_increment, .. } = self;
        let count = sensor.record(&kinematics.specific_force(&sensor.frame), &mut prediction[row..]);
        kinematics.specific_force_derivatives(&model.robot.tree, &sensor.frame, |joint, [q, dq, ddq]| {
            let change = q * reach[0] + dq * reach[1] + ddq;
            put(sensor, row, model.joints(), joint, &change, by_increment);
        });
        count
    }

    #[inline(always)]
    fn rate(&mut self, model: &JerkModel, row: usize, sensor: &Sensor, reach: Reach) -> usize {
        let Self { kinematics, prediction, by_increment, .. } = self;
        let count = sensor.record(&kinematics.angular_rate(&sensor.frame), &mut prediction[row..]);
        kinematics.angular_rate_derivatives(&model.robot.tree, &sensor.frame, |joint, [q, dq]| {
            let change = q * reach[0] + dq * reach[1];
            put(sensor, row, model.joints(), joint, &change, by_increment);
        });
        count
    }
}

/// Writes one joint's column of a sensor's rows.
#[inline(always)]
fn put<T: Scalar>(sensor: &Sensor, row: usize, n: usize, joint: usize, column: &Vec3<T>, out: &mut [T]) {
    for (r, &axis) in sensor.axes.iter().enumerate() {
        out[(row + r) * n + joint] = column.0[axis];
    }
}
