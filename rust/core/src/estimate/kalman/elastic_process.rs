//! The elastic-joint model between samples: links behind their springs, and motors moved by torques or by jerk.

use super::disturbance::{depend, hold, hold_wrenches};
use super::drift::Biases;
use super::gaussian::{Gaussian, Symmetric};
use super::model::Process;
use super::motor_torques::MotorTorques;
use super::recording::{KalmanRecording, KalmanSample};
use super::sigma_points::SigmaRule;
use super::transition::Transition;
use crate::error::DesignError;
use crate::estimate::observer::Rest;
use crate::robot::Robot;
use std::sync::Arc;

/// Links and motors between samples.
#[derive(Clone, Debug)]
pub struct ElasticProcess {
    /// Links, drives and sensors.
    pub(super) robot: Arc<Robot>,
    /// The state that is each channel's bias (channels).
    pub(super) biases: Vec<Option<usize>>,
    /// Number of all states.
    pub(super) states: usize,
    /// What of the noise belongs to neither.
    pub(super) common: CommonNoise,
    /// The step of time with its scratch.
    pub(super) transition: Transition,
    /// What moves motors.
    pub(super) motors: MotorInput,
    /// Part of their way that friction elements may have gone at the first sample.
    pub(super) gone: f64,
    /// Finds where links hang at a first sample.
    pub(super) rest: Rest,
}

/// What moves motors.
#[derive(Clone, Debug)]
pub(super) enum MotorInput {
    /// Torques that were read.
    Torques(Box<MotorTorques>),
    /// Commanded and random jerk.
    Jerk,
}

/// How biases wander, and what is uncertain at the first sample.
#[derive(Clone, Debug)]
pub(super) struct CommonNoise {
    /// Of each channel's bias (channels).
    pub(super) bias_walk: Vec<f64>,
    pub(super) bias_time: Vec<f64>,
    pub(super) initial_bias: Vec<f64>,
    /// Position, velocity, and disturbance torque or acceleration of each joint (3n).
    pub(super) initial: Vec<f64>,
    /// The links' disturbance torques (n), empty where there are none, and numbers of varying wrenches.
    pub(super) links: Vec<f64>,
    pub(super) wrenches: Vec<f64>,
}

/// Where nothing drives a joint, the fixed end of its spring is known so much better than a motor at the start.
const FIXED: f64 = 1e-6;

impl ElasticProcess {
    /// How biases wander over a step.
    fn drift(&self) -> Biases<'_> {
        Biases { states: &self.biases, walk: &self.common.bias_walk, time: &self.common.bias_time }
    }

    /// Links and motors at rest at these positions, everything independent.
    fn begin(&self, theta: &[f64], belief: &mut Gaussian) {
        let (n, layout, q) = (self.robot.len(), &self.transition.layout, self.rest.q());
        let (position, rest) = self.common.initial.split_at(n);
        let (velocity, third) = rest.split_at(n);
        belief.clear();
        let mut set = |state: usize, mean: f64, std: f64| {
            belief.mean[state] = mean;
            belief.covariance.put(state, state, std * std);
        };
        for j in 0..n {
            let fixed = if self.robot.drives[j].is_passive() { FIXED } else { 1.0 };
            set(layout.theta[j], theta[j], fixed * position[j]);
            set(layout.dtheta[j], 0.0, fixed * velocity[j]);
            set(j, q[j], position[j]);
            set(n + j, 0.0, velocity[j]);
            if let Some(first) = layout.disturbance {
                set(first + j, 0.0, third[j]);
            }
            if let Some(first) = layout.motor_acceleration {
                set(first + j, 0.0, fixed * third[j]);
            }
        }
        // A friction element may be anywhere between its limits, or near the middle if that is said.
        for (_, k, element) in layout.elements(&self.robot) {
            set(k, 0.0, self.gone * element.reach() / 3.0_f64.sqrt());
        }
        for (bias, s) in self.biases.iter().zip(&self.common.initial_bias) {
            if let Some(b) = *bias {
                set(b, 0.0, *s);
            }
        }
        if let Some(first) = layout.link_disturbance {
            self.common.links.iter().enumerate().for_each(|(j, s)| set(first + j, 0.0, *s));
        }
        if let Some(first) = layout.wrench {
            self.common.wrenches.iter().enumerate().for_each(|(k, s)| set(first + k, 0.0, *s));
        }
        for (j, k, element) in layout.elements(&self.robot) {
            // What it holds the spring need not: the link is nearer to its motor.
            let drive = &self.robot.drives[j];
            let compliance = drive.compliance(drive.torsion_between(theta[j], belief.mean[j]));
            depend(&mut belief.covariance, j, k, element.stiffness * compliance);
        }
        if let Some(first) = layout.link_disturbance {
            hold(&self.robot, theta, first, belief);
        }
        if let Some(first) = layout.wrench {
            hold_wrenches(&self.robot, theta, first, belief);
        }
    }
}

impl Process for ElasticProcess {
    fn robot(&self) -> &Robot {
        &self.robot
    }

    #[inline(always)]
    fn states(&self) -> usize {
        self.states
    }

    fn widen(&mut self, states: usize) {
        self.transition.widen(states);
    }

    fn set_points(&mut self, rule: Option<SigmaRule>) {
        self.transition.set_points(rule);
    }

    #[inline(always)]
    fn wrench(&self) -> Option<usize> {
        self.transition.layout.wrench
    }

    #[inline(always)]
    fn link_disturbance(&self) -> Option<usize> {
        self.transition.layout.link_disturbance
    }

    fn check(&self, recording: &KalmanRecording<'_>) -> Result<(), DesignError> {
        let needed = match self.motors {
            MotorInput::Torques(_) => ("tau", recording.inputs.tau),
            MotorInput::Jerk => ("jerk", recording.inputs.jerk),
        };
        recording.expect(self.biases.len(), self.robot.len(), &[needed])
    }

    fn start(&mut self, sample: &KalmanSample<'_>, belief: &mut Gaussian) -> Result<(), DesignError> {
        let theta = &sample.readings[..self.robot.len()];
        if let Some(joint) = theta.iter().position(|x| x.is_nan()) {
            return Err(DesignError::NoStart { joint });
        }
        // At rest θ is known by its reading and q hangs behind it, by the torsion that gravity asks for.
        self.rest.find(&self.robot, theta)?;
        self.begin(theta, belief);
        self.resume(sample, belief);
        Ok(())
    }

    fn resume(&mut self, sample: &KalmanSample<'_>, belief: &Gaussian) {
        let Self { robot, transition, motors, .. } = self;
        let inputs = match motors {
            MotorInput::Torques(torques) => torques.start(sample.inputs.tau),
            MotorInput::Jerk => sample.inputs.jerk,
        };
        transition.start(robot, &belief.mean, inputs);
    }

    #[inline(always)]
    fn predict(&mut self, sample: &KalmanSample<'_>, belief: &mut Gaussian) {
        let Self { robot, transition, motors, .. } = self;
        match motors {
            MotorInput::Torques(torques) => {
                torques.take(transition, belief, sample.inputs.tau, sample.dt);
                transition.advance(robot, belief, torques.over_step(), sample.dt);
                torques.restore(transition, belief);
            }
            // What was commanded since the sample before.
            MotorInput::Jerk => transition.advance(robot, belief, (sample.inputs.jerk, sample.inputs.jerk), sample.dt),
        }
        self.drift().predict(belief, sample.dt);
    }

    #[inline(always)]
    fn carry(&mut self, columns: &mut [f64], stride: usize, dt: f64) {
        self.transition.exponential.carry(columns, stride);
        self.drift().carry(columns, stride, dt);
    }

    #[inline(always)]
    fn carry_single(&mut self, columns: &mut [f32], stride: usize, dt: f64) {
        self.transition.exponential.carry_single(columns, stride);
        self.drift().carry(columns, stride, dt);
    }

    #[inline(always)]
    fn drive(&mut self, columns: &mut [f64], stride: usize) {
        self.transition.drive(columns, stride);
    }

    #[inline(always)]
    fn carry_back(&mut self, memory: &[f64], columns: &mut [f64], stride: usize, dt: f64) {
        self.drift().carry(columns, stride, dt);
        self.transition.exponential.carry_back(memory, columns, stride);
    }

    fn memory(&self) -> usize {
        2 * self.transition.layout.dense.pow(2)
    }

    /// The transition to this sample with its noise.
    #[inline(always)]
    fn remember(&self, memory: &mut Vec<f64>) {
        self.transition.exponential.remember(memory);
    }

    #[inline(always)]
    fn noise_rows(&mut self, memory: &[f64], dt: f64, rows: &mut [f64], stride: usize) {
        let rest = self.drift().noise_rows(rows, stride, dt);
        self.transition.exponential.noise_rows(memory, rest, stride);
    }

    fn bridged(&self) -> bool {
        match &self.motors {
            MotorInput::Torques(torques) => torques.bridged(),
            MotorInput::Jerk => false,
        }
    }

    #[inline(always)]
    fn retreat(&mut self, memory: &[f64], dt: f64, lambda: &mut [f64], big: &mut Symmetric) {
        self.drift().retreat(lambda, big, dt);
        self.transition.exponential.retreat(memory, lambda, big);
    }
}
