//! The elastic-joint model: links and motors moved by motor torques, everything that is recorded as a measurement.

use super::gaussian::{Gaussian, Symmetric};
use super::model::{Linearised, Model};
use super::output::FilterOutput;
use super::recording::{KalmanRecording, KalmanSample, check_deviations, check_readings, expect_length};
use super::transition::Transition;
use crate::dynamics::ElasticLayout;
use crate::error::DesignError;
use crate::estimate::measurement::{Chained, Channel, Elastic, Kind, read_all};
use crate::estimate::observer::link_position_at_rest;
use crate::robot::Robot;
use std::sync::Arc;

/// Standard deviations of everything that is random in the elastic-joint model.
#[derive(Clone, Debug)]
pub struct ElasticNoise {
    /// Density of what the links' equations leave out (n): velocity wanders by this in one second [rad/s/√s].
    pub link: Vec<f64>,
    /// The same of the motors' equations (n).
    pub motor: Vec<f64>,
    /// One reading's noise of the motor torque (n) [N m].
    pub torque: Vec<f64>,
    /// By how much the disturbance torque of each motor wanders in one second (n) [N m/√s].
    pub disturbance_walk: Vec<f64>,
    /// One reading's noise (channels) [the channel's unit].
    pub reading: Vec<f64>,
    /// By how much each channel's bias wanders in one second (channels) [unit/√s].
    pub bias_walk: Vec<f64>,
    /// Initial position, velocity (of links and of motors) and disturbance torque of each joint (3n).
    pub initial: Vec<f64>,
    /// Initial bias (channels).
    pub initial_bias: Vec<f64>,
}

/// How the covariance is carried over a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Discretization {
    /// 1 + A h (Ulrich and Sasiadek 2011).
    FirstOrder,
    /// e^(A h), A taken in the middle of the step.
    Exact,
}

/// What the elastic-joint model consists of.
#[derive(Clone, Debug)]
pub struct ElasticSettings {
    /// What is measured; motor positions among them.
    pub kinds: Vec<Kind>,
    /// Whether each motor has a slowly changing torque of its own beside the measured one.
    pub disturbances: bool,
    /// Which channels have a bias state, in their order.
    pub biased: Vec<bool>,
    /// Whether a sample's torque is the one that has acted, unchanged, since the sample before; else torques are those at
    /// the samples and change linearly in between.
    pub held: bool,
    /// Of the covariance.
    pub discretization: Discretization,
}

/// State (q, q̇, θ, θ̇, disturbance torques, biases) of an elastic-joint robot under measured motor torques
/// (Ulrich and Sasiadek 2011, with every sensor that a log can have).
///
/// θ and θ̇ are those of the elastic joints: the motor of a rigid one moves as its link.
#[derive(Clone, Debug)]
pub struct ElasticModel {
    robot: Arc<Robot>,
    channels: Vec<Channel>,
    biases: Vec<Option<usize>>,
    states: usize,
    noise: ElasticNoise,
    transition: Transition,
    prediction: Vec<f64>,
    jacobian: Vec<f64>,
    tau: Vec<f64>,
    held: bool,
}

impl ElasticModel {
    /// `robot` with `noise`.
    ///
    /// # Errors
    /// Motors on links, noise or biases that do not fit the channels, a negative standard deviation, a reading without noise.
    pub fn new(robot: Arc<Robot>, settings: &ElasticSettings, noise: ElasticNoise) -> Result<Self, DesignError> {
        let channels = Kind::all_channels(&settings.kinds, &robot);
        expect_length("biased", settings.biased.len(), channels.len())?;
        let layout = ElasticLayout::new(&robot, settings.disturbances)?;
        let (n, m, d) = (robot.len(), channels.len(), layout.dense);
        check(&noise, n, m)?;
        let mut states = d;
        let mut number = |&biased: &bool| {
            states += usize::from(biased);
            biased.then(|| states - 1)
        };
        let biases = settings.biased.iter().map(&mut number).collect();
        Ok(Self {
            transition: Transition::new(&robot, layout, settings.discretization, states),
            prediction: vec![0.0; m],
            jacobian: vec![0.0; m * d],
            tau: vec![0.0; n],
            held: settings.held,
            robot,
            channels,
            biases,
            states,
            noise,
        })
    }

    /// What is measured, in the order of the readings.
    pub fn channel_list(&self) -> &[Channel] {
        &self.channels
    }

    fn initial(&self, q: &[f64], theta: &[f64]) -> Gaussian {
        let (n, layout) = (self.robot.len(), &self.transition.layout);
        let (position, rest) = self.noise.initial.split_at(n);
        let (velocity, disturbance) = rest.split_at(n);
        let mut std = vec![0.0; self.states];
        let mut mean = vec![0.0; self.states];
        for j in 0..n {
            for (k, s, x) in [(layout.theta[j], position[j], theta[j]), (layout.dtheta[j], velocity[j], 0.0)] {
                (std[k], mean[k]) = (s, x);
            }
            (std[j], mean[j]) = (position[j], q[j]);
            std[n + j] = velocity[j];
            if let Some(first) = layout.disturbance {
                std[first + j] = disturbance[j];
            }
        }
        for (bias, s) in self.biases.iter().zip(&self.noise.initial_bias) {
            if let Some(b) = *bias {
                std[b] = *s;
            }
        }
        let mut belief = Gaussian::independent(&std);
        belief.mean.copy_from_slice(&mean);
        belief
    }

    #[inline(always)]
    fn add_process_noise(&mut self, p: &mut Symmetric, dt: f64) {
        let (layout, noise, n) = (&self.transition.layout, &self.noise, self.robot.len());
        let mut add = |i: usize, density: f64| p.data[i * p.stride + i] += density * density * dt;
        for j in 0..n {
            add(n + j, noise.link[j]);
            if self.robot.drives[j].elastic {
                add(layout.dtheta[j], noise.motor[j]);
            }
            if let Some(first) = layout.disturbance {
                add(first + j, noise.disturbance_walk[j]);
            }
        }
        for (bias, walk) in self.biases.iter().zip(&noise.bias_walk) {
            if let Some(b) = *bias {
                add(b, *walk);
            }
        }
        self.transition.add_torque_noise(&self.robot, p, &noise.torque, dt);
    }
}

impl Model for ElasticModel {
    fn robot(&self) -> &Robot {
        &self.robot
    }

    #[inline(always)]
    fn states(&self) -> usize {
        self.states
    }

    #[inline(always)]
    fn dense(&self) -> usize {
        self.transition.layout.dense
    }

    #[inline(always)]
    fn biases(&self) -> &[Option<usize>] {
        &self.biases
    }

    fn check(&self, recording: &KalmanRecording<'_>) -> Result<(), DesignError> {
        recording.expect(self.channels.len(), self.robot.len(), &[("tau", recording.inputs.tau)])
    }

    fn start(&mut self, sample: &KalmanSample<'_>, belief: &mut Gaussian) -> Result<(), DesignError> {
        let theta = &sample.readings[..self.robot.len()];
        if let Some(joint) = theta.iter().position(|x| x.is_nan()) {
            return Err(DesignError::NoStart { joint });
        }
        let q = link_position_at_rest(&self.robot, theta)?;
        *belief = self.initial(&q, theta);
        self.tau.copy_from_slice(sample.inputs.tau);
        self.transition.start(&self.robot, &belief.mean, &self.tau);
        Ok(())
    }

    #[inline(always)]
    fn predict(&mut self, sample: &KalmanSample<'_>, belief: &mut Gaussian) {
        let after = sample.inputs.tau;
        let before = if self.held { after } else { &self.tau };
        self.transition.advance(&self.robot, belief, (before, after), sample.dt);
        self.add_process_noise(&mut belief.covariance, sample.dt);
        self.tau.copy_from_slice(after);
    }

    #[inline(always)]
    fn linearise(&mut self, reference: &[f64]) {
        let Self { robot, channels, transition, tau, prediction, jacobian, .. } = self;
        let Transition { dynamics, layout, .. } = transition;
        dynamics.accelerate(robot, layout, reference, tau);
        dynamics.differentiate(robot, layout, reference);
        jacobian.fill(0.0);
        let view = Elastic { layout, dynamics, state: reference };
        let (joints, dense, ddq_by) = (robot.len(), layout.dense, &dynamics.ddq_by);
        read_all(robot, channels, &view, &mut Chained { prediction, rows: jacobian, joints, dense, ddq_by });
    }

    #[inline(always)]
    fn linearised(&self) -> Linearised<'_> {
        Linearised { prediction: &self.prediction, jacobian: &self.jacobian }
    }

    #[inline(always)]
    fn variance(&self, channel: usize) -> f64 {
        self.noise.reading[channel] * self.noise.reading[channel]
    }

    fn memory(&self) -> usize {
        self.transition.layout.dense.pow(2) + self.robot.len()
    }

    /// The transition to this sample, and the torques at it.
    #[inline(always)]
    fn remember(&self, memory: &mut Vec<f64>) {
        self.transition.remember(memory);
        memory.extend_from_slice(&self.tau);
    }

    #[inline(always)]
    fn retreat(&mut self, memory: &[f64], _: f64, lambda: &mut [f64], big: &mut Symmetric) {
        let size = memory.len() - self.robot.len();
        self.transition.retreat(&memory[..size], lambda, big);
    }

    #[inline(always)]
    fn report(&mut self, memory: &[f64], state: &[f64], i: usize, out: &mut FilterOutput) {
        let n = self.robot.len();
        let Transition { layout, dynamics, .. } = &mut self.transition;
        dynamics.accelerate(&self.robot, layout, &state[..layout.dense], &memory[memory.len() - n..]);
        let row = i * n..(i + 1) * n;
        out.q[row.clone()].copy_from_slice(&state[..n]);
        out.dq[row.clone()].copy_from_slice(&state[n..2 * n]);
        out.ddq[row].copy_from_slice(&dynamics.ddq);
        for j in 0..n {
            out.theta[i * n + j] = state[layout.theta[j]];
            out.dtheta[i * n + j] = state[layout.dtheta[j]];
        }
    }
}

/// # Errors
/// Noise of `n` joints and `m` channels with a length, or a value, that it must not have.
fn check(noise: &ElasticNoise, n: usize, m: usize) -> Result<(), DesignError> {
    let lengths = [
        ("link", &noise.link, n),
        ("motor", &noise.motor, n),
        ("torque", &noise.torque, n),
        ("disturbance_walk", &noise.disturbance_walk, n),
        ("reading", &noise.reading, m),
        ("bias_walk", &noise.bias_walk, m),
        ("initial", &noise.initial, 3 * n),
        ("initial_bias", &noise.initial_bias, m),
    ];
    lengths.iter().try_for_each(|(what, values, expected)| check_deviations(what, values, *expected))?;
    check_readings(&noise.reading)
}
