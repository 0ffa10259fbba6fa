//! The acceleration-driven model: links moved by jerk, motor and sensors as measurements, readings with slow biases.

use super::channels::{Channel, Evaluation};
use super::gaussian::{Gaussian, Symmetric};
use super::model::{Linearised, Model};
use super::output::FilterOutput;
use super::recording::{KalmanRecording, KalmanSample, check_deviations, check_readings, expect_length};
use super::slope::Slope;
use crate::error::DesignError;
use crate::estimate::observer::link_position_at_rest;
use crate::robot::Robot;
use crate::scalar::Dual;
use std::sync::Arc;

/// State (q, q̇, q̈, biases) and the channels that measure it (Axelsson, Karlsson and Norrlöf 2012, eqs. (9)–(17)).
#[derive(Clone, Debug)]
pub struct JerkModel {
    pub(crate) robot: Arc<Robot>,
    pub(crate) channels: Vec<Channel>,
    /// The state that is each channel's bias.
    pub(crate) biases: Vec<Option<usize>>,
    states: usize,
}

/// Standard deviations of everything that is random.
#[derive(Clone, Debug)]
pub struct Noise {
    /// Density of each joint's jerk (n) [rad/s³/√Hz]: its acceleration wanders by this in one second.
    pub jerk: Vec<f64>,
    /// One reading's noise (channels) [the channel's unit].
    pub reading: Vec<f64>,
    /// Relative error of the predicted torsion, as of a stiffness that is not quite right.
    pub torsion: f64,
    /// By how much each channel's bias wanders in one second (channels) [unit/√s].
    pub bias_walk: Vec<f64>,
    /// Initial position, velocity and acceleration of each joint (3n) [rad, rad/s, rad/s²].
    pub initial: Vec<f64>,
    /// Initial bias (channels).
    pub initial_bias: Vec<f64>,
}

/// Channels that a log may have beside motor positions and accelerometers.
#[derive(Clone, Copy, Debug, Default)]
pub struct Further {
    /// Motor velocities of all joints.
    pub motor_velocities: bool,
    /// The robot's gyroscopes.
    pub rates: bool,
    /// Link positions of all joints.
    pub links: bool,
    /// Transmission torques of all joints.
    pub torques: bool,
}

impl Further {
    /// All channels: motor positions, accelerometer axes, motor velocities, gyroscope axes, link positions, torques.
    pub(super) fn channels(self, robot: &Robot) -> Vec<Channel> {
        let joints = || 0..robot.len();
        let mut channels: Vec<_> = joints().map(Channel::Motor).collect();
        for (sensor, s) in robot.accelerometers.iter().enumerate() {
            channels.extend(s.axes.iter().map(|&axis| Channel::Acceleration { sensor, axis }));
        }
        channels.extend(joints().filter(|_| self.motor_velocities).map(Channel::MotorVelocity));
        for (sensor, s) in robot.gyroscopes.iter().enumerate().filter(|_| self.rates) {
            channels.extend(s.axes.iter().map(|&axis| Channel::Rate { sensor, axis }));
        }
        channels.extend(joints().filter(|_| self.links).map(Channel::Link));
        channels.extend(joints().filter(|_| self.torques).map(Channel::Torque));
        channels
    }
}

impl JerkModel {
    /// Motor positions and accelerometers, and `further` channels that the log has; each with a bias state where `biased`
    /// says so, in the same order.
    ///
    /// # Errors
    /// Lengths that differ.
    pub fn new(robot: Arc<Robot>, further: Further, biased: &[bool]) -> Result<Self, DesignError> {
        let channels = further.channels(&robot);
        expect_length("biased", biased.len(), channels.len())?;
        let mut states = 3 * robot.len();
        let mut number = |&biased: &bool| {
            states += usize::from(biased);
            biased.then(|| states - 1)
        };
        let biases = biased.iter().map(&mut number).collect();
        Ok(Self { robot, channels, biases, states })
    }

    /// Number of states.
    pub fn states(&self) -> usize {
        self.states
    }

    /// Number of joints.
    pub fn joints(&self) -> usize {
        self.robot.len()
    }

    /// Number of channels.
    pub fn channels(&self) -> usize {
        self.channels.len()
    }

    /// What is measured, in the order of the readings.
    pub fn channel_list(&self) -> &[Channel] {
        &self.channels
    }

    /// Number of accelerometer channels.
    pub fn acceleration_channels(&self) -> usize {
        self.robot.acceleration_channels()
    }

    /// Links at `q`, at rest, with the initial uncertainty of `noise`.
    pub(crate) fn initial(&self, q: &[f64], noise: &Noise) -> Gaussian {
        let mut std = noise.initial.clone();
        for (bias, value) in self.biases.iter().zip(&noise.initial_bias) {
            std.extend(bias.map(|_| *value));
        }
        let mut belief = Gaussian::independent(&std);
        belief.mean[..q.len()].copy_from_slice(q);
        belief
    }

    /// Time update over `dt` [s] under a constant `jerk` (n): x ← F x + G u, P ← F P Fᵀ + Q.
    ///
    /// F is three blocks wide, so the product is a few row and column sums in place of two dense products. Process
    /// noise enters as in eq. (10): an increment of acceleration at the start of the interval.
    #[inline(always)]
    pub(crate) fn predict(&self, belief: &mut Gaussian, noise: &Noise, dt: f64, jerk: &[f64]) {
        let n = self.joints();
        let half = 0.5 * dt * dt;
        for j in 0..n {
            let (dq, ddq, u) = (belief.mean[n + j], belief.mean[2 * n + j], jerk[j]);
            belief.mean[j] += dt * dq + half * ddq + half * dt / 3.0 * u;
            belief.mean[n + j] += dt * ddq + half * u;
            belief.mean[2 * n + j] += dt * u;
        }
        let p = &mut belief.covariance;
        advance_rows(p, n, dt, half);
        for row in p.data.chunks_exact_mut(p.stride) {
            let (q, rest) = row.split_at_mut(n);
            let (dq, rest) = rest.split_at_mut(n);
            for j in 0..n {
                q[j] += dt * dq[j] + half * rest[j];
                dq[j] += dt * rest[j];
            }
        }
        self.add_process_noise(p, noise, dt, half);
        p.mirror();
    }

    #[inline(always)]
    fn add_process_noise(&self, p: &mut Symmetric, noise: &Noise, dt: f64, half: f64) {
        let (n, stride) = (self.joints(), p.stride);
        for j in 0..n {
            let variance = noise.jerk[j] * noise.jerk[j] * dt;
            let g = [half, dt, 1.0];
            for a in 0..3 {
                for b in a..3 {
                    p.data[(a * n + j) * stride + b * n + j] += g[a] * g[b] * variance;
                }
            }
        }
        for (bias, walk) in self.biases.iter().zip(&noise.bias_walk) {
            if let Some(b) = *bias {
                p.data[b * stride + b] += walk * walk * dt;
            }
        }
    }

    /// The adjoint of [`predict`](Self::predict): λ ← Fᵀ λ, Λ ← Fᵀ Λ F.
    #[inline(always)]
    pub(crate) fn retreat(&self, lambda: &mut [f64], big: &mut Symmetric, dt: f64) {
        let n = self.joints();
        let half = 0.5 * dt * dt;
        for j in 0..n {
            lambda[2 * n + j] += dt * lambda[n + j] + half * lambda[j];
            lambda[n + j] += dt * lambda[j];
        }
        let stride = big.stride;
        let (q, rest) = big.data.split_at_mut(n * stride);
        let (dq, rest) = rest.split_at_mut(n * stride);
        let ddq = &mut rest[..n * stride];
        for i in 0..n * stride {
            ddq[i] += dt * dq[i] + half * q[i];
            dq[i] += dt * q[i];
        }
        for row in big.data.chunks_exact_mut(stride) {
            for j in 0..n {
                row[2 * n + j] += dt * row[n + j] + half * row[j];
                row[n + j] += dt * row[j];
            }
        }
        big.mirror();
    }

    /// # Errors
    /// A length that does not fit the model, a standard deviation that is negative or not a number, and a reading
    /// without noise.
    pub(crate) fn check(&self, noise: &Noise) -> Result<(), DesignError> {
        let (n, m) = (self.joints(), self.channels());
        let Noise { jerk, reading, torsion, bias_walk, initial, initial_bias } = noise;
        let lengths = [
            ("jerk", jerk, n),
            ("reading", reading, m),
            ("bias_walk", bias_walk, m),
            ("initial", initial, 3 * n),
            ("initial_bias", initial_bias, m),
            ("torsion", &vec![*torsion], 1),
        ];
        lengths.iter().try_for_each(|(what, values, expected)| check_deviations(what, values, *expected))?;
        check_readings(reading)
    }
}

/// Rows of F P.
#[inline(always)]
fn advance_rows(p: &mut Symmetric, n: usize, dt: f64, half: f64) {
    let size = n * p.stride;
    let (q, rest) = p.data.split_at_mut(size);
    let (dq, rest) = rest.split_at_mut(size);
    let ddq = &rest[..size];
    for i in 0..size {
        q[i] += dt * dq[i] + half * ddq[i];
        dq[i] += dt * ddq[i];
    }
}

/// The acceleration-driven model with its noise, as a filter runs it.
#[derive(Clone, Debug)]
pub struct JerkDriven {
    model: JerkModel,
    noise: Noise,
    /// Whether the damping torque D(θ̇ − q̇) is predicted.
    damping: bool,
    evaluation: Evaluation<f64>,
    /// Motor positions and how they change in time; there when motor velocities are measured.
    motors: Option<Motors>,
    /// Where the channels are linearised.
    reference: Vec<f64>,
    /// Motor velocities for the damping torque.
    dtheta: Vec<f64>,
    slope: Slope,
    jerk: Vec<f64>,
    dt: f64,
}

impl JerkDriven {
    /// `model` with `noise`; `damping` says whether the damping torque D(θ̇ − q̇), which the paper drops, is predicted.
    ///
    /// # Errors
    /// Noise that does not fit the model.
    pub fn new(model: JerkModel, noise: Noise, damping: bool) -> Result<Self, DesignError> {
        model.check(&noise)?;
        let (n, m) = (model.joints(), model.channels());
        Ok(Self {
            evaluation: Evaluation::new(&model.robot, m),
            motors: model.channels.contains(&Channel::MotorVelocity(0)).then(|| Motors::new(&model.robot)),
            reference: vec![0.0; 3 * n],
            dtheta: vec![f64::NAN; n],
            slope: Slope::new(n),
            jerk: vec![0.0; n],
            dt: 0.0,
            model,
            noise,
            damping,
        })
    }

    /// Number of accelerometer channels.
    pub fn acceleration_channels(&self) -> usize {
        self.model.acceleration_channels()
    }

    /// The model without its noise.
    pub(crate) fn jerk_model(&self) -> &JerkModel {
        &self.model
    }

    /// The noise.
    pub(crate) fn noise(&self) -> &Noise {
        &self.noise
    }

    /// Motor velocities for the damping torque, and jerk, of the sample last predicted to.
    pub(crate) fn inputs(&self) -> (&[f64], &[f64]) {
        (&self.dtheta, &self.jerk)
    }

    #[inline(always)]
    fn take(&mut self, sample: &KalmanSample<'_>) {
        self.dt = sample.dt;
        self.jerk.copy_from_slice(sample.inputs.jerk);
        if self.damping {
            self.dtheta.copy_from_slice(sample.inputs.dtheta);
            self.slope.push(sample.dt, &sample.readings[..self.jerk.len()]);
            self.slope.fill(&mut self.dtheta);
        }
    }
}

impl Model for JerkDriven {
    fn robot(&self) -> &Robot {
        &self.model.robot
    }

    #[inline(always)]
    fn states(&self) -> usize {
        self.model.states
    }

    #[inline(always)]
    fn dense(&self) -> usize {
        self.reference.len()
    }

    #[inline(always)]
    fn biases(&self) -> &[Option<usize>] {
        &self.model.biases
    }

    fn check(&self, recording: &KalmanRecording<'_>) -> Result<(), DesignError> {
        let needed = [("dtheta", recording.inputs.dtheta), ("jerk", recording.inputs.jerk)];
        recording.expect(self.model.channels(), self.model.joints(), &needed)
    }

    fn start(&mut self, sample: &KalmanSample<'_>, belief: &mut Gaussian) -> Result<(), DesignError> {
        let theta = &sample.readings[..self.model.joints()];
        if let Some(joint) = theta.iter().position(|x| x.is_nan()) {
            return Err(DesignError::NoStart { joint });
        }
        let q = link_position_at_rest(&self.model.robot, theta)?;
        *belief = self.model.initial(&q, &self.noise);
        self.slope.reset();
        self.take(sample);
        Ok(())
    }

    #[inline(always)]
    fn predict(&mut self, sample: &KalmanSample<'_>, belief: &mut Gaussian) {
        self.model.predict(belief, &self.noise, sample.dt, sample.inputs.jerk);
        self.take(sample);
    }

    #[inline(always)]
    fn linearise(&mut self, reference: &[f64]) {
        self.reference.copy_from_slice(reference);
        let Self { model, evaluation, dtheta, jerk, motors, .. } = self;
        evaluation.evaluate(&model.robot, &model.channels, reference, dtheta);
        if let Some(motors) = motors {
            motors.evaluate(&model.robot, reference, dtheta, jerk);
            motors.write(&model.channels, evaluation);
        }
    }

    #[inline(always)]
    fn linearised(&self) -> Linearised<'_> {
        Linearised { prediction: &self.evaluation.prediction, jacobian: &self.evaluation.jacobian }
    }

    /// A motor position's has a part that grows with its predicted torsion; a motor velocity's, what the jerk that is not
    /// known does to the torsion's rate: with acceleration a random walk, that rate has no variance but over a step.
    #[inline(always)]
    fn variance(&self, i: usize) -> f64 {
        let square = |x: f64| x * x;
        let own = square(self.noise.reading[i]);
        match self.model.channels[i] {
            Channel::Motor(j) => own + square(self.noise.torsion * (self.evaluation.prediction[i] - self.reference[j])),
            Channel::MotorVelocity(j) => {
                let n = self.model.joints();
                let by_ddq = &self.evaluation.jacobian[j * 3 * n + 2 * n..][..n];
                let jolts: f64 = by_ddq.iter().zip(&self.noise.jerk).map(|(h, jerk)| square(h * jerk)).sum();
                own + jolts / self.dt
            }
            _ => own,
        }
    }

    fn memory(&self) -> usize {
        let n = self.model.joints();
        n * (3 * n + 5)
    }

    /// Where the motors' channels were linearised, and what came of it.
    #[inline(always)]
    fn remember(&self, memory: &mut Vec<f64>) {
        let n = self.model.joints();
        memory.extend_from_slice(&self.evaluation.jacobian[..n * 3 * n]);
        memory.extend_from_slice(&self.evaluation.prediction[..n]);
        memory.extend_from_slice(&self.reference);
        memory.extend_from_slice(&self.jerk);
    }

    #[inline(always)]
    fn retreat(&mut self, _: &[f64], dt: f64, lambda: &mut [f64], big: &mut Symmetric) {
        self.model.retreat(lambda, big, dt);
    }

    /// The first n channels are the motors': their positions by the linearisation, their velocities by its rate.
    #[inline(always)]
    fn report(&mut self, memory: &[f64], state: &[f64], i: usize, out: &mut FilterOutput) {
        let n = self.model.joints();
        let (jacobian, rest) = memory.split_at(n * 3 * n);
        let (prediction, rest) = rest.split_at(n);
        let (reference, jerk) = rest.split_at(3 * n);
        for (signal, values) in [&mut out.q, &mut out.dq, &mut out.ddq].into_iter().zip(state.chunks_exact(n)) {
            signal[i * n..][..n].copy_from_slice(values);
        }
        for (j, row) in jacobian.chunks_exact(3 * n).enumerate() {
            let (mut theta, mut dtheta) = (prediction[j], 0.0);
            for k in 0..3 * n {
                theta += row[k] * (state[k] - reference[k]);
                dtheta += row[k] * if k < 2 * n { state[n + k] } else { jerk[k - 2 * n] };
            }
            (out.theta[i * n + j], out.dtheta[i * n + j]) = (theta, dtheta);
        }
    }
}

/// Motor positions with their rates: numbers that carry the derivative along time.
#[derive(Clone, Debug)]
struct Motors {
    channels: Vec<Channel>,
    evaluation: Evaluation<Dual<1>>,
    state: Vec<Dual<1>>,
}

impl Motors {
    fn new(robot: &Robot) -> Self {
        let n = robot.len();
        Self {
            channels: (0..n).map(Channel::Motor).collect(),
            evaluation: Evaluation::new(robot, n),
            state: vec![Dual::default(); 3 * n],
        }
    }

    /// At a state that moves with `jerk`; the damping torque's `dtheta` is taken to stay.
    #[inline(always)]
    fn evaluate(&mut self, robot: &Robot, state: &[f64], dtheta: &[f64], jerk: &[f64]) {
        let rates = state[jerk.len()..].iter().chain(jerk);
        for ((x, &value), &rate) in self.state.iter_mut().zip(state).zip(rates) {
            *x = Dual { value, gradient: [rate] };
        }
        self.evaluation.evaluate(robot, &self.channels, &self.state, dtheta);
    }

    /// θ̇ = H ẋ and ∂θ̇/∂x = Ḣ + H ∂ẋ/∂x into the rows of the motor velocities.
    #[inline(always)]
    fn write(&self, channels: &[Channel], out: &mut Evaluation<f64>) {
        let n = self.channels.len();
        for (i, channel) in channels.iter().enumerate() {
            let Channel::MotorVelocity(j) = *channel else { continue };
            out.prediction[i] = self.evaluation.prediction[j].gradient[0];
            let row = &self.evaluation.jacobian[j * 3 * n..][..3 * n];
            for (k, out) in out.jacobian[i * 3 * n..][..3 * n].iter_mut().enumerate() {
                *out = row[k].gradient[0] + if k < n { 0.0 } else { row[k - n].value };
            }
        }
    }
}
