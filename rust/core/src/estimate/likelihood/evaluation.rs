//! Readings against their predictions: the channels of a robot whose numbers are parameters.

use super::instants::{Instant, SampledLag};
use super::parameters::Parameters;
use super::recording::LikelihoodRecording;
use crate::dynamics::Placed;
use crate::estimate::kalman::{JerkModel, JerkNoise};
use crate::estimate::measurement::{
    Channel, Driven, Jacobian, LinkMotion, Loading, OutsideColumns, Sensing, Springs, Wanted, read,
};
use crate::robot::{Drive, Robot};
use crate::spatial::Mat3;
use std::sync::Arc;

/// One reading against its prediction.
#[derive(Clone, Copy, Debug)]
pub(super) struct ParametricReading {
    /// Which.
    pub(super) channel: usize,
    /// What was read, none where it is missing.
    pub(super) value: Option<f64>,
    /// What was to be read, without a bias that is a state, before any filter inside the sensor.
    pub(super) prediction: f64,
    /// Variance of its noise.
    pub(super) variance: f64,
}

/// Everything of a robot that does not change along a recording, and scratch.
#[derive(Clone, Debug)]
pub(super) struct ParametricMeasurement {
    /// As robot.yaml has it.
    robot: Arc<Robot>,
    /// What is read, in the order of the readings.
    channels: Vec<Channel>,
    /// The robot's numbers.
    parameters: Parameters<f64>,
    /// Standard deviations of readings before the parameters scale them.
    noise: JerkNoise,
    /// Filter and delay of each accelerometer.
    pub(super) lateness: Vec<SampledLag>,
    /// Whether an accelerometer has instants of its own.
    late: Vec<bool>,
    /// How far each accelerometer is turned from where the robot says.
    turns: Vec<Mat3<f64>>,
    /// Motion and loads of the links, by the parameters' masses.
    motion: LinkMotion<f64>,
    /// Those of the instant last evaluated.
    pub(super) readings: Vec<ParametricReading>,
    /// h (channels).
    prediction: Vec<f64>,
    /// ∂h/∂(q, q̇, q̈) of each channel (channels × 3n); of those that were read.
    pub(super) jacobian: Vec<f64>,
}

impl ParametricMeasurement {
    /// `robot` has the values that `parameters` have of the springs.
    pub(super) fn new(
        model: &JerkModel,
        robot: Arc<Robot>,
        noise: JerkNoise,
        parameters: Parameters<f64>,
        lateness: Vec<SampledLag>,
        late: Vec<bool>,
    ) -> Self {
        let (n, m) = (model.joints(), model.channels.len());
        let mut motion = LinkMotion::new(&robot);
        motion.kinematics.set_masses(parameters.masses(&robot));
        Self {
            channels: model.channels.clone(),
            turns: parameters.sensors.iter().map(|s| s.turn()).collect(),
            motion,
            readings: Vec::with_capacity(m),
            prediction: vec![0.0; m],
            jacobian: vec![0.0; m * 3 * n],
            robot,
            parameters,
            noise,
            lateness,
            late,
        }
    }

    /// Link positions at rest for motor positions `theta` (n), by the iteration q ← θ − φ⁻¹(g(q)) until it stands still.
    pub(super) fn rest(&mut self, theta: &[f64]) -> Vec<f64> {
        let mut q: Vec<f64> = theta.to_vec();
        for _ in 0..200 {
            let load = self.motion.holding_torques(&self.robot, &q);
            let mut still = true;
            for (j, drive) in self.robot.drives.iter().enumerate().filter(|(_, d)| d.elastic) {
                let next = theta[j] - drive.twist(self.parameters.joints[j].spring, load[j]).0;
                still &= (next - q[j]).abs() <= 1e-15;
                q[j] = next;
            }
            if still {
                break;
            }
        }
        q
    }

    /// Readings of an instant against their predictions at `state` = (q, q̇, q̈).
    #[inline(always)]
    pub(super) fn evaluate(&mut self, log: &LikelihoodRecording, instant: Instant, state: &[f64]) {
        self.motion.set_kinematics(&self.robot, state);
        if instant.late.is_none() {
            self.motion.set_loads(&self.robot);
        }
        self.readings.clear();
        let mut channel = 0;
        while channel < self.channels.len() {
            channel += match self.channels[channel] {
                Channel::Motor(j) if instant.late.is_none() => self.motor(log, instant, channel, j, state),
                Channel::Acceleration { sensor, .. } => self.acceleration(log, instant, channel, sensor, state),
                _ => 1,
            };
        }
    }

    /// Row of a channel, or rows of all axes of a sensor.
    #[inline(always)]
    fn row(&mut self, log: &LikelihoodRecording, instant: Instant, channel: usize, width: usize, state: &[f64]) {
        let Self { robot, channels, motion, parameters, turns, prediction, jacobian, .. } = self;
        let n = robot.len();
        jacobian[channel * 3 * n..][..width * 3 * n].fill(0.0);
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
    fn motor(&mut self, log: &LikelihoodRecording, instant: Instant, channel: usize, j: usize, state: &[f64]) -> usize {
        let theta = log.theta[instant.row * self.robot.len() + j];
        if theta.is_nan() {
            return 1;
        }
        self.row(log, instant, channel, 1, state);
        let prediction = self.prediction[channel];
        let own = self.noise.reading[channel];
        let relative = (prediction - state[j]) * self.noise.torsion;
        let variance = own * own + relative * relative;
        self.readings.push(ParametricReading { channel, value: Some(theta), prediction, variance });
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
        state: &[f64],
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
struct Calibrated<'a> {
    motion: &'a LinkMotion<f64>,
    parameters: &'a Parameters<f64>,
    turns: &'a [Mat3<f64>],
}

impl Sensing<f64> for Calibrated<'_> {
    #[inline(always)]
    fn specific_force(&self, robot: &Robot, index: usize, row: usize, wanted: &mut impl Wanted<f64>) {
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
    fn angular_rate(&self, robot: &Robot, index: usize, row: usize, wanted: &mut impl Wanted<f64>) {
        self.motion.angular_rate(robot, index, row, wanted);
    }

    #[inline(always)]
    fn tracked_position(&self, robot: &Robot, index: usize, row: usize, wanted: &mut impl Wanted<f64>) {
        self.motion.tracked_position(robot, index, row, wanted);
    }
}

impl Loading<f64> for Calibrated<'_> {
    #[inline(always)]
    fn load(&self, j: usize) -> f64 {
        self.motion.load(j)
    }

    #[inline(always)]
    fn load_columns(&self, j: usize, factor: f64, row: usize, wanted: &mut impl Wanted<f64>) {
        self.motion.load_columns(j, factor, row, wanted);
    }
}

impl Springs<f64> for Parameters<f64> {
    #[inline(always)]
    fn twist(&self, drive: &Drive, j: usize, torque: f64) -> (f64, f64) {
        drive.twist(self.joints[j].spring, torque)
    }

    #[inline(always)]
    fn damping(&self, _: &Drive, j: usize) -> f64 {
        self.joints[j].damping
    }
}
