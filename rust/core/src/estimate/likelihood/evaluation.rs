//! Predictions of the channels and their derivatives in the state, over a scalar.

use super::moments::{Lateness, Moment};
use super::parameters::Parameters;
use super::recording::LikelihoodRecording;
use super::spring::torsion;
use crate::dynamics::{Kinematics, Loads, Placed};
use crate::estimate::kalman::{Channel, JerkModel, Noise};
use crate::robot::{Drive, MotorFriction, Robot};
use crate::scalar::Scalar;
use crate::spatial::{Mat3, Vec3};
use std::sync::Arc;

/// One reading against its prediction.
#[derive(Clone, Copy, Debug)]
pub(super) struct Reading<T> {
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
pub(super) struct Evaluation<T> {
    robot: Arc<Robot>,
    channels: Vec<Channel>,
    parameters: Parameters<T>,
    noise: Noise,
    pub(super) lateness: Vec<Lateness<T>>,
    /// Whether an accelerometer has moments of its own.
    late: Vec<bool>,
    turns: Vec<Mat3<T>>,
    /// Each joint's drive with a dry friction of one: the direction in which friction acts.
    directions: Vec<Drive>,
    kinematics: Kinematics<T>,
    loads: Loads<T>,
    tau: Vec<T>,
    by_q: Vec<T>,
    by_dq: Vec<T>,
    mass: Vec<T>,
    pub(super) readings: Vec<Reading<T>>,
    /// ∂h/∂(q, q̇, q̈) of each reading (3n each).
    pub(super) jacobian: Vec<T>,
}

impl<T: Scalar> Evaluation<T> {
    pub(super) fn new(
        model: &JerkModel,
        noise: Noise,
        parameters: Parameters<T>,
        lateness: Vec<Lateness<T>>,
        late: Vec<bool>,
    ) -> Self {
        let (robot, n) = (model.robot.clone(), model.joints());
        let mut kinematics = Kinematics::new(&robot.tree);
        kinematics.set_masses(parameters.masses(&robot));
        let unit = |d: &Drive| Drive {
            motor_friction: MotorFriction { coulomb: 1.0, ..MotorFriction::default() },
            ..d.clone()
        };
        Self {
            channels: model.channels.clone(),
            turns: parameters.sensors.iter().map(|s| s.turn()).collect(),
            directions: robot.drives.iter().map(unit).collect(),
            kinematics,
            loads: Loads::new(&robot.tree),
            tau: vec![T::default(); n],
            by_q: vec![T::default(); n * n],
            by_dq: vec![T::default(); n * n],
            mass: vec![T::default(); n * n],
            readings: Vec::with_capacity(model.channels.len()),
            jacobian: Vec::with_capacity(model.channels.len() * 3 * n),
            robot,
            parameters,
            noise,
            lateness,
            late,
        }
    }

    pub(super) fn parameters(&self) -> &Parameters<T> {
        &self.parameters
    }

    /// Link positions at rest for motor positions `theta` (n), by the iteration q ← θ − φ⁻¹(g(q)): once until it stands
    /// still, and as often again, because derivatives settle at the same rate.
    pub(super) fn rest(&mut self, theta: &[f64]) -> Vec<T> {
        let n = theta.len();
        let zero = vec![T::default(); n];
        let mut q: Vec<T> = theta.iter().map(|&x| T::constant(x)).collect();
        let (mut rounds, mut enough) = (0, 200);
        while rounds < enough {
            self.kinematics.set(&self.robot.tree, &q, &zero, &zero);
            self.loads.inverse_dynamics_into(&self.robot.tree, &self.kinematics, &mut self.tau);
            let mut still = true;
            for (j, drive) in self.robot.drives.iter().enumerate().filter(|(_, d)| d.elastic) {
                let next = T::constant(theta[j]) - torsion(&self.parameters.joints[j], drive, self.tau[j]).0;
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

    /// Readings of a moment against their predictions at `state` = (q, q̇, q̈).
    #[inline(always)]
    pub(super) fn evaluate(&mut self, recording: &LikelihoodRecording, moment: Moment, state: &[T]) {
        let n = self.tau.len();
        let (q, rest) = state.split_at(n);
        let (dq, rest) = rest.split_at(n);
        let ddq = &rest[..n];
        self.readings.clear();
        self.jacobian.clear();
        let robot = self.robot.clone();
        self.kinematics.set(&robot.tree, q, dq, ddq);
        if moment.late.is_none() {
            let Self { kinematics, loads, tau, by_q, by_dq, mass, .. } = self;
            loads.inverse_dynamics_derivatives_into(&robot.tree, kinematics, tau, by_q, by_dq, mass);
        }
        let mut channel = 0;
        while channel < self.channels.len() {
            channel += match self.channels[channel] {
                Channel::Motor(j) => self.motor(recording, moment, channel, j, q[j], dq[j]),
                Channel::Acceleration { sensor, .. } => self.acceleration(&robot, recording, moment, channel, sensor),
                Channel::Torque(j) => self.torque(recording, moment, channel, j, dq[j], ddq),
                _ => 1,
            };
        }
    }

    /// Axelsson, Karlsson and Norrlöf 2012, eqs. (12)–(13), with damping: θ = q + φ⁻¹(load − D(θ̇ − q̇)).
    #[inline(always)]
    fn motor(&mut self, log: &LikelihoodRecording, moment: Moment, channel: usize, j: usize, q: T, dq: T) -> usize {
        let n = self.tau.len();
        let theta = log.theta[moment.row * n + j];
        if moment.late.is_some() || theta.is_nan() {
            return 1;
        }
        let (joint, drive) = (&self.parameters.joints[j], &self.robot.drives[j]);
        let at = self.jacobian.len();
        self.jacobian.resize(at + 3 * n, T::default());
        let mut twist = T::default();
        if drive.elastic {
            let (friction, slope) = drive.link_friction(dq);
            let mut torque = self.tau[j] + friction;
            let mut damping = T::default();
            let dtheta = log.dtheta[moment.row * n + j];
            if !dtheta.is_nan() {
                damping = joint.damping;
                torque -= damping * (T::constant(dtheta) - dq);
            }
            let (torsion, compliance) = torsion(joint, drive, torque);
            twist = torsion;
            put_load(&mut self.jacobian[at..], [&self.by_q, &self.by_dq, &self.mass], j, compliance);
            self.jacobian[at + n + j] += compliance * (slope + damping);
        }
        self.jacobian[at + j] += T::constant(1.0);
        let own = joint.motor_noise * self.noise.reading[channel];
        let relative = twist * self.noise.torsion;
        self.readings.push(Reading {
            channel,
            value: Some(theta),
            prediction: q + twist,
            variance: own * own + relative * relative,
        });
        1
    }

    /// The motor's own equation of motion, De Luca, Schröder and Thümmel 2007, eq. (2), with friction:
    /// τ = B θ̈ + Sᵀ q̈ + what the transmission gives the link + friction(θ̇).
    #[inline(always)]
    fn torque(
        &mut self,
        log: &LikelihoodRecording,
        moment: Moment,
        channel: usize,
        j: usize,
        dq: T,
        ddq: &[T],
    ) -> usize {
        let n = self.tau.len();
        let row = moment.row * n..moment.row * n + n;
        let (tau, dtheta, ddtheta) = (log.tau[row.start + j], log.dtheta[row.start + j], &log.ddtheta[row]);
        if moment.late.is_some() || tau.is_nan() || dtheta.is_nan() || ddtheta.iter().any(|x| x.is_nan()) {
            return 1;
        }
        let joint = &self.parameters.joints[j];
        let (friction, slope) = self.robot.drives[j].link_friction(dq);
        let direction = self.directions[j].dry_friction(dtheta);
        let motor = joint.motor_inertia * ddtheta[j] + joint.viscous_friction * dtheta;
        let mut predicted = self.tau[j] + friction + motor + joint.coulomb_friction * direction;
        let at = self.jacobian.len();
        self.jacobian.resize(at + 3 * n, T::default());
        put_load(&mut self.jacobian[at..], [&self.by_q, &self.by_dq, &self.mass], j, T::constant(1.0));
        self.jacobian[at + n + j] += slope;
        for k in 0..n {
            predicted += self.parameters.coupling[k * n + j] * ddq[k];
            predicted += self.parameters.coupling[j * n + k] * ddtheta[k];
            self.jacobian[at + 2 * n + k] += self.parameters.coupling[k * n + j];
        }
        let own = joint.torque_noise * self.noise.reading[channel];
        self.readings.push(Reading { channel, value: Some(tau), prediction: predicted, variance: own * own });
        1
    }

    /// Eqs. (14)–(16), of an accelerometer that is not quite where and what the robot says.
    #[inline(always)]
    fn acceleration(
        &mut self,
        robot: &Robot,
        log: &LikelihoodRecording,
        moment: Moment,
        first: usize,
        s: usize,
    ) -> usize {
        let (n, sensor) = (self.tau.len(), &robot.accelerometers[s]);
        let width = sensor.axes.len();
        if moment.late != self.late[s].then_some(s) {
            return width;
        }
        let own = &self.parameters.sensors[s];
        let Placed { body, axes, point } = self.kinematics.place(&sensor.frame);
        let placed = Placed { body, axes: axes.mul(&self.turns[s]), point: point + axes.apply(&own.translation) };
        let force = self.kinematics.specific_force_at(&placed);
        let base = self.jacobian.len();
        let m = robot.acceleration_channels();
        for (r, &axis) in sensor.axes.iter().enumerate() {
            let value = Some(log.acceleration[moment.row * m + first - n + r]).filter(|y| !y.is_nan());
            let prediction = own.scale.0[axis] * force.0[axis] + own.bias.0[axis];
            let noise = own.noise * self.noise.reading[first + r];
            self.readings.push(Reading { channel: first + r, value, prediction, variance: noise * noise });
        }
        self.jacobian.resize(base + width * 3 * n, T::default());
        let jacobian = &mut self.jacobian[base..];
        self.kinematics.specific_force_derivatives_at(&robot.tree, &placed, |joint, columns: [Vec3<T>; 3]| {
            for (r, &axis) in sensor.axes.iter().enumerate() {
                for (part, column) in columns.iter().enumerate() {
                    jacobian[r * 3 * n + part * n + joint] = own.scale.0[axis] * column.0[axis];
                }
            }
        });
        width
    }
}

/// Writes `factor` times the derivatives of joint j's load.
#[inline(always)]
fn put_load<T: Scalar>(out: &mut [T], matrices: [&[T]; 3], j: usize, factor: T) {
    let n = out.len() / 3;
    for (part, matrix) in out.chunks_exact_mut(n).zip(matrices) {
        for (entry, value) in part.iter_mut().zip(&matrix[j * n..][..n]) {
            *entry = factor * *value;
        }
    }
}
