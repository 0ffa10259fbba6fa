//! What is measured: each channel's prediction and its exact derivatives.

use crate::dynamics::{Kinematics, Loads};
use crate::robot::{Drive, Robot, Sensor};
use crate::scalar::Scalar;
use crate::spatial::Vec3;

/// One scalar that a robot's log can hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Channel {
    /// Motor position of a joint [rad].
    Motor(usize),
    /// Motor velocity of a joint [rad/s].
    MotorVelocity(usize),
    /// One axis of an accelerometer [m/s²].
    Acceleration {
        /// Which accelerometer.
        sensor: usize,
        /// Which axis.
        axis: usize,
    },
    /// One axis of a gyroscope [rad/s].
    Rate {
        /// Which gyroscope.
        sensor: usize,
        /// Which axis.
        axis: usize,
    },
    /// Link position of a joint [rad].
    Link(usize),
    /// Torque that the transmission gives a link [N m].
    Torque(usize),
}

/// Predictions of all channels at one state, with their derivatives in (q, q̇, q̈).
#[derive(Clone, Debug)]
pub struct Evaluation<T> {
    /// h (channels), without bias.
    pub prediction: Vec<T>,
    /// ∂h/∂(q, q̇, q̈), channels × 3n, row-major.
    pub jacobian: Vec<T>,
    pub(super) kinematics: Kinematics<T>,
    loads: Loads<T>,
    pub(super) tau: Vec<T>,
    by_q: Vec<T>,
    by_dq: Vec<T>,
    pub(super) mass: Vec<T>,
}

impl<T: Scalar> Evaluation<T> {
    /// Room for `channels` of `robot`.
    pub fn new(robot: &Robot, channels: usize) -> Self {
        let (tree, n) = (&robot.tree, robot.len());
        Self {
            prediction: vec![T::default(); channels],
            jacobian: vec![T::default(); channels * 3 * n],
            kinematics: Kinematics::new(tree),
            loads: Loads::new(tree),
            tau: vec![T::default(); n],
            by_q: vec![T::default(); n * n],
            by_dq: vec![T::default(); n * n],
            mass: vec![T::default(); n * n],
        }
    }

    /// Evaluates `channels` at `state` = (q, q̇, q̈); `dtheta` (n) is each motor's velocity for the damping torque, NaN to
    /// leave it out. Rows of motor velocities stay zero: they are the rate of the motor positions'.
    ///
    /// Motor position (eqs. (12)–(13), here with the damping that the paper drops, friction of the link and any spring
    /// φ): θ = q + φ⁻¹(M q̈ + C q̇ + g + friction − D(θ̇ − q̇)). Accelerometer: eqs. (14)–(16). Derivatives are exact.
    #[inline(always)]
    pub fn evaluate(&mut self, robot: &Robot, channels: &[Channel], state: &[T], dtheta: &[f64]) {
        let (tree, n) = (&robot.tree, robot.len());
        let (q, rest) = state.split_at(n);
        let (dq, rest) = rest.split_at(n);
        self.kinematics.set(tree, q, dq, &rest[..n]);
        let Self { kinematics, loads, tau, by_q, by_dq, mass, .. } = self;
        loads.inverse_dynamics_derivatives_into(tree, kinematics, tau, by_q, by_dq, mass);
        self.jacobian.fill(T::default());
        let mut i = 0;
        while i < channels.len() {
            i += match channels[i] {
                Channel::Motor(j) => self.motor(&robot.drives[j], i, j, q, dq[j], dtheta[j]),
                Channel::MotorVelocity(_) => 1,
                Channel::Torque(j) => self.torque(&robot.drives[j], i, j, dq[j]),
                Channel::Link(j) => {
                    self.prediction[i] = q[j];
                    self.jacobian[i * 3 * n + j] = T::constant(1.0);
                    1
                }
                Channel::Acceleration { sensor, .. } => self.acceleration(robot, i, &robot.accelerometers[sensor]),
                Channel::Rate { sensor, .. } => self.rate(robot, i, &robot.gyroscopes[sensor]),
            };
        }
    }

    #[inline(always)]
    fn motor(&mut self, drive: &Drive, row: usize, j: usize, q: &[T], dq: T, dtheta: f64) -> usize {
        let n = self.tau.len();
        self.prediction[row] = q[j];
        if drive.elastic {
            let (friction, slope) = drive.link_friction(dq);
            let (damping, rate) = if dtheta.is_nan() { (0.0, T::default()) } else { (drive.damping, -dq + dtheta) };
            let torque = self.tau[j] + friction - rate * damping;
            let torsion = drive.torsion(torque);
            let compliance = T::constant(1.0) / drive.tangent_stiffness(torsion);
            self.prediction[row] += torsion;
            self.load_row(row, j, compliance);
            self.jacobian[row * 3 * n + n + j] += compliance * (slope + damping);
        }
        self.jacobian[row * 3 * n + j] += T::constant(1.0);
        1
    }

    #[inline(always)]
    fn torque(&mut self, drive: &Drive, row: usize, j: usize, dq: T) -> usize {
        let n = self.tau.len();
        let (friction, slope) = drive.link_friction(dq);
        self.prediction[row] = self.tau[j] + friction;
        self.load_row(row, j, T::constant(1.0));
        self.jacobian[row * 3 * n + n + j] += slope;
        1
    }

    /// Row `row` ← `factor` times the derivatives of joint j's torque.
    #[inline(always)]
    fn load_row(&mut self, row: usize, j: usize, factor: T) {
        let n = self.tau.len();
        let out = &mut self.jacobian[row * 3 * n..][..3 * n];
        for (part, matrix) in out.chunks_exact_mut(n).zip([&self.by_q, &self.by_dq, &self.mass]) {
            for (entry, value) in part.iter_mut().zip(&matrix[j * n..][..n]) {
                *entry = factor * *value;
            }
        }
    }

    #[inline(always)]
    fn acceleration(&mut self, robot: &Robot, row: usize, sensor: &Sensor) -> usize {
        let Self { kinematics, prediction, jacobian, .. } = self;
        let n = robot.len();
        sensor.record(&kinematics.specific_force(&sensor.frame), &mut prediction[row..]);
        kinematics.specific_force_derivatives(&robot.tree, &sensor.frame, |joint, columns| {
            put(sensor, row, n, joint, &columns, jacobian);
        });
        sensor.axes.len()
    }

    #[inline(always)]
    fn rate(&mut self, robot: &Robot, row: usize, sensor: &Sensor) -> usize {
        let Self { kinematics, prediction, jacobian, .. } = self;
        let n = robot.len();
        sensor.record(&kinematics.angular_rate(&sensor.frame), &mut prediction[row..]);
        kinematics.angular_rate_derivatives(&robot.tree, &sensor.frame, |joint, columns| {
            put(sensor, row, n, joint, &columns, jacobian);
        });
        sensor.axes.len()
    }
}

/// Writes one joint's columns, in q, q̇ (and q̈), of a sensor's rows.
#[inline(always)]
fn put<T: Scalar>(sensor: &Sensor, row: usize, n: usize, joint: usize, columns: &[Vec3<T>], jacobian: &mut [T]) {
    for (r, &axis) in sensor.axes.iter().enumerate() {
        for (part, column) in columns.iter().enumerate() {
            jacobian[(row + r) * 3 * n + part * n + joint] = column.0[axis];
        }
    }
}
