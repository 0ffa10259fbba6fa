//! Readings against their predictions, over a scalar: the channels of a robot whose numbers are parameters.

use super::instants::{Instant, SampledLag};
use super::parameters::Parameters;
use super::recording::LikelihoodRecording;
use crate::dynamics::Placed;
use crate::estimate::kalman::{JerkModel, JerkNoise};
use crate::estimate::measurement::{
    Channel, Driven, Jacobian, LinkMotion, Loading, OutsideColumns, Sensing, Springs, Wanted, read,
};
use crate::robot::{Drive, Friction, Robot};
use crate::scalar::Scalar;
use crate::spatial::Mat3;
use std::sync::Arc;

/// One reading against its prediction.
#[derive(Clone, Copy, Debug)]
pub(super) struct ParametricReading<T> {
    /// Which.
    pub(super) channel: usize,
    /// What was read, none where it is missing.
    pub(super) value: Option<f64>,
    /// What was to be read, without a bias that is a state, before any filter inside the sensor.
    pub(super) prediction: T,
    /// Variance of its noise.
    pub(super) variance: T,
}

/// Everything of a robot that does not change along a recording, and scratch.
#[derive(Clone, Debug)]
pub(super) struct ParametricMeasurement<T> {
    /// As robot.yaml has it.
    robot: Arc<Robot>,
    /// What is read, in the order of the readings.
    channels: Vec<Channel>,
    /// The robot's numbers, those under calibration with their derivatives.
    parameters: Parameters<T>,
    /// Standard deviations of readings before the parameters scale them.
    noise: JerkNoise,
    /// Filter and delay of each accelerometer.
    pub(super) lateness: Vec<SampledLag<T>>,
    /// Whether an accelerometer has instants of its own.
    late: Vec<bool>,
    /// How far each accelerometer is turned from where the robot says.
    turns: Vec<Mat3<T>>,
    /// Each joint's drive with a dry friction of one: the direction in which friction acts.
    directions: Vec<Drive>,
    /// Motion and loads of the links, by the parameters' masses.
    motion: LinkMotion<T>,
    /// Those of the instant last evaluated.
    pub(super) readings: Vec<ParametricReading<T>>,
    /// h (channels).
    prediction: Vec<T>,
    /// ∂h/∂(q, q̇, q̈) of each channel (channels × 3n); of those that were read.
    pub(super) jacobian: Vec<T>,
}

impl<T: Scalar> ParametricMeasurement<T> {
    /// `robot` has the values that `parameters` have of the springs.
    pub(super) fn new(
        model: &JerkModel,
        robot: Arc<Robot>,
        noise: JerkNoise,
        parameters: Parameters<T>,
        lateness: Vec<SampledLag<T>>,
        late: Vec<bool>,
    ) -> Self {
        let (n, m) = (model.joints(), model.channels.len());
        let mut motion = LinkMotion::new(&robot);
        motion.kinematics.set_masses(parameters.masses(&robot));
        let unit = |d: &Drive| Drive { motor_friction: Friction { coulomb: 1.0, ..Friction::default() }, ..d.clone() };
        Self {
            channels: model.channels.clone(),
            turns: parameters.sensors.iter().map(|s| s.turn()).collect(),
            directions: robot.drives.iter().map(unit).collect(),
            motion,
            readings: Vec::with_capacity(m),
            prediction: vec![T::default(); m],
            jacobian: vec![T::default(); m * 3 * n],
            robot,
            parameters,
            noise,
            lateness,
            late,
        }
    }

    /// The robot's numbers.
    pub(super) fn parameters(&self) -> &Parameters<T> {
        &self.parameters
    }

    /// Link positions at rest for motor positions `theta` (n), by the iteration q ← θ − φ⁻¹(g(q)): once until it stands
    /// still, and as often again, because derivatives settle at the same rate.
    pub(super) fn rest(&mut self, theta: &[f64]) -> Vec<T> {
        let mut q: Vec<T> = theta.iter().map(|&x| T::constant(x)).collect();
        let (mut rounds, mut enough) = (0, 200);
        while rounds < enough {
            let load = self.motion.holding_torques(&self.robot, &q);
            let mut still = true;
            for (j, drive) in self.robot.drives.iter().enumerate().filter(|(_, d)| d.elastic) {
                let next = T::constant(theta[j]) - drive.twist(self.parameters.joints[j].spring, load[j]).0;
                still &= (next - q[j]).map(f64::abs) == (next - q[j]).map(|x| x.abs().min(1e-15));
                q[j] = next;
            }
            rounds += 1;
            if still {
                enough = enough.min(2 * rounds);
            }
        }
        q
    }

    /// Readings of an instant against their predictions at `state` = (q, q̇, q̈).
    #[inline(always)]
    pub(super) fn evaluate(&mut self, log: &LikelihoodRecording, instant: Instant, state: &[T]) {
        self.motion.set_kinematics(&self.robot, state);
        if instant.late.is_none() {
            self.motion.set_loads(&self.robot);
        }
        self.readings.clear();
        let mut channel = 0;
        while channel < self.channels.len() {
            channel += match self.channels[channel] {
                Channel::Motor(j) if instant.late.is_none() => self.motor(log, instant, channel, j, state),
                Channel::Torque(j) if instant.late.is_none() => self.motor_torque(log, instant, channel, j, state),
                Channel::Acceleration { sensor, .. } => self.acceleration(log, instant, channel, sensor, state),
                _ => 1,
            };
        }
    }

    /// Row of a channel, or rows of all axes of a sensor.
    #[inline(always)]
    fn row(&mut self, log: &LikelihoodRecording, instant: Instant, channel: usize, width: usize, state: &[T]) {
        let Self { robot, channels, motion, parameters, turns, prediction, jacobian, .. } = self;
        let n = robot.len();
        jacobian[channel * 3 * n..][..width * 3 * n].fill(T::default());
        let links = Calibrated { motion, parameters, turns };
        let dtheta = &log.dtheta[instant.row * n..][..n];
        let view = Driven { links: &links, state, wrench: 3 * n, dtheta, springs: &*parameters };
        let mut wanted = Jacobian {
            prediction,
            rows: jacobian,
            joints: n,
            width: 3 * n,
            by_torque: &mut [],
            outside: OutsideColumns::default(),
        };
        read(robot, channels[channel], channel, &view, &mut wanted);
    }

    /// A motor position; its noise grows with the torsion, as of a stiffness that is not quite constant.
    #[inline(always)]
    fn motor(&mut self, log: &LikelihoodRecording, instant: Instant, channel: usize, j: usize, state: &[T]) -> usize {
        let theta = log.theta[instant.row * self.robot.len() + j];
        if theta.is_nan() {
            return 1;
        }
        self.row(log, instant, channel, 1, state);
        let prediction = self.prediction[channel];
        let own = self.parameters.joints[j].motor_noise * self.noise.reading[channel];
        let relative = (prediction - state[j]) * self.noise.torsion;
        let variance = own * own + relative * relative;
        self.readings.push(ParametricReading { channel, value: Some(theta), prediction, variance });
        1
    }

    /// The motor's own equation of motion, De Luca, Schröder and Thümmel 2007, eq. (2), with friction:
    /// τ = B θ̈ + Sᵀ q̈ + what the transmission gives the link + friction(θ̇).
    #[inline(always)]
    fn motor_torque(
        &mut self,
        log: &LikelihoodRecording,
        instant: Instant,
        channel: usize,
        j: usize,
        state: &[T],
    ) -> usize {
        let n = self.robot.len();
        let row = instant.row * n..instant.row * n + n;
        let (tau, dtheta, ddtheta) = (log.tau[row.start + j], log.dtheta[row.start + j], &log.ddtheta[row]);
        if tau.is_nan() || dtheta.is_nan() || ddtheta.iter().any(|x| x.is_nan()) {
            return 1;
        }
        self.row(log, instant, channel, 1, state);
        let Self { parameters, jacobian, .. } = self;
        let joint = &parameters.joints[j];
        // Linear in the friction's size: dry friction acts in a direction that is known from the measured velocity.
        let direction = self.directions[j].dry_friction(dtheta);
        let motor = joint.motor_inertia * ddtheta[j] + joint.viscous_friction * dtheta;
        let mut prediction = self.prediction[channel] + motor + joint.coulomb_friction * direction;
        for k in 0..n {
            prediction += parameters.coupling[k * n + j] * state[2 * n + k];
            prediction += parameters.coupling[j * n + k] * ddtheta[k];
            jacobian[channel * 3 * n + 2 * n + k] += parameters.coupling[k * n + j];
        }
        let own = joint.torque_noise * self.noise.reading[channel];
        self.readings.push(ParametricReading { channel, value: Some(tau), prediction, variance: own * own });
        1
    }

    /// All axes of an accelerometer, at its own instant where it is late.
    #[inline(always)]
    fn acceleration(
        &mut self,
        log: &LikelihoodRecording,
        instant: Instant,
        first: usize,
        s: usize,
        state: &[T],
    ) -> usize {
        let (n, width) = (self.robot.len(), self.robot.accelerometers[s].axes.len());
        if instant.late != self.late[s].then_some(s) {
            return width;
        }
        self.row(log, instant, first, width, state);
        let m = self.robot.acceleration_channels();
        for channel in first..first + width {
            let value = Some(log.acceleration[instant.row * m + channel - n]).filter(|y| !y.is_nan());
            let noise = self.parameters.sensors[s].noise * self.noise.reading[channel];
            let prediction = self.prediction[channel];
            self.readings.push(ParametricReading { channel, value, prediction, variance: noise * noise });
        }
        width
    }
}

/// Links that carry accelerometers which are not quite where and what the robot says.
struct Calibrated<'a, T> {
    motion: &'a LinkMotion<T>,
    parameters: &'a Parameters<T>,
    turns: &'a [Mat3<T>],
}

impl<T: Scalar> Sensing<T> for Calibrated<'_, T> {
    #[inline(always)]
    fn specific_force(&self, robot: &Robot, index: usize, row: usize, wanted: &mut impl Wanted<T>) {
        let (sensor, own) = (&robot.accelerometers[index], &self.parameters.sensors[index]);
        let kinematics = &self.motion.kinematics;
        let Placed { body, axes, point } = kinematics.place(&sensor.frame);
        let placed = Placed { body, axes: axes.mul(&self.turns[index]), point: point + axes.apply(&own.translation) };
        let force = kinematics.specific_force_at(&placed);
        for (r, &axis) in sensor.axes.iter().enumerate() {
            wanted.value(row + r, own.scale.0[axis] * force.0[axis] + own.bias.0[axis]);
        }
        kinematics.specific_force_derivatives_at(&robot.tree, &placed, |joint, by| {
            for (r, &axis) in sensor.axes.iter().enumerate() {
                wanted.scaled(row + r, joint, own.scale.0[axis], by.map(|column| column.0[axis]));
            }
        });
    }

    #[inline(always)]
    fn angular_rate(&self, robot: &Robot, index: usize, row: usize, wanted: &mut impl Wanted<T>) {
        self.motion.angular_rate(robot, index, row, wanted);
    }

    #[inline(always)]
    fn tracked_position(&self, robot: &Robot, index: usize, row: usize, wanted: &mut impl Wanted<T>) {
        self.motion.tracked_position(robot, index, row, wanted);
    }
}

impl<T: Scalar> Loading<T> for Calibrated<'_, T> {
    #[inline(always)]
    fn load(&self, j: usize) -> T {
        self.motion.load(j)
    }

    #[inline(always)]
    fn load_columns(&self, j: usize, factor: T, row: usize, wanted: &mut impl Wanted<T>) {
        self.motion.load_columns(j, factor, row, wanted);
    }
}

impl<T: Scalar> Springs<T> for Parameters<T> {
    #[inline(always)]
    fn twist(&self, drive: &Drive, j: usize, torque: T) -> (T, T) {
        drive.twist(self.joints[j].spring, torque)
    }

    #[inline(always)]
    fn damping(&self, _: &Drive, j: usize) -> T {
        self.joints[j].damping
    }
}
