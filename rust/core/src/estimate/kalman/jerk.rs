//! The jerk-driven model: links moved by jerk, motor and sensors as measurements, readings with slow biases.
//!
//! Between samples each joint's q is integrated from white jerk about the commanded one, j:
//!
//! q ← q + q̇ h + q̈ h²/2 + j h³/6,  q̇ ← q̇ + q̈ h + j h²/2,  q̈ ← q̈ + j h,
//!
//! with the exact integral of the white noise over h for Q: σ² times h⁵/20, h⁴/8, h³/6; h³/3, h²/2; h. A density found at one rate
//! so holds at any other. Biases are Gauss–Markov processes, random walks where their time is infinite.

use super::disturbance::{Disturbances, LinkDisturbance, WrenchLaw};
use super::drift::Biases;
use super::gaussian::{Gaussian, Symmetric};
use crate::check::{check_deviations, check_readings, check_times, expect_length};
use crate::error::DesignError;
use crate::estimate::bias::{BiasStep, bias_step};
use crate::estimate::jerk_noise;
use crate::estimate::measurement::{Channel, Kind};
use crate::linear;
use crate::robot::Robot;
use std::sync::Arc;

/// State (q, q̇, q̈, disturbance torques of links and varying wrenches if any, biases) and the channels that measure it (Axelsson, Karlsson and Norrlöf 2012, eqs. (9)–(17)).
#[derive(Clone, Debug)]
pub struct JerkModel {
    /// Links, drives and sensors.
    pub(crate) robot: Arc<Robot>,
    /// What is measured, in the order of the readings.
    pub(crate) channels: Vec<Channel>,
    /// The state that is each channel's bias.
    pub(crate) biases: Vec<Option<usize>>,
    /// Torques and wrenches on links from outside, if they are in the state.
    pub(super) disturbances: Disturbances,
    /// 3n, one for each disturbance torque and number of a wrench, and one for each bias.
    states: usize,
}

/// Standard deviations of everything that is random.
///
/// Densities, not variances of a step: they hold at any rate. A zero is exact knowledge; readings may not have it.
/// `jerk` decides between lag and noise, and is the one to find from recordings; all others are what the sensors' data
/// sheets say.
#[derive(Clone, Debug)]
pub struct JerkNoise {
    /// Density of each joint's jerk (n) [rad/s³/√Hz]: its acceleration wanders by this in one second.
    pub jerk: Vec<f64>,
    /// By how much each joint's position, and each one's velocity, wanders in one second beside its acceleration (2n)
    /// [rad/√s, rad/s/√s].
    pub link_walk: Vec<f64>,
    /// One reading's noise (channels) [the channel's unit].
    pub reading: Vec<f64>,
    /// Relative error of the predicted torsion, as of a stiffness that is not quite right.
    pub torsion: f64,
    /// By how much each channel's bias wanders in one second (channels) [unit/√s].
    pub bias_walk: Vec<f64>,
    /// Over which time each channel's bias forgets (channels) [s], infinite for a random walk; its own standard deviation
    /// tends to `bias_walk` √(time/2).
    pub bias_time: Vec<f64>,
    /// Initial position, velocity and acceleration of each joint (3n) [rad, rad/s, rad/s²].
    pub initial: Vec<f64>,
    /// Initial bias (channels).
    pub initial_bias: Vec<f64>,
}

impl JerkNoise {
    /// How a channel's bias moves over `dt` [s].
    #[inline(always)]
    pub(crate) fn bias_step(&self, channel: usize, dt: f64) -> BiasStep<f64> {
        bias_step(self.bias_walk[channel], self.bias_time[channel], dt)
    }
}

impl JerkModel {
    /// The channels of `kinds`, motor positions among them; each with a bias state where `biased` says so, in the same order.
    ///
    /// # Errors
    /// Lengths that differ.
    pub fn new(robot: Arc<Robot>, kinds: &[Kind], biased: &[bool]) -> Result<Self, DesignError> {
        Kind::refuse_motor_torques(kinds, "none, as the model has no motors")?;
        let channels = Kind::all_channels(kinds, &robot);
        expect_length("biased", biased.len(), channels.len())?;
        let mut states = 3 * robot.len();
        let mut number = |&biased: &bool| {
            states += usize::from(biased);
            biased.then(|| states - 1)
        };
        let biases = biased.iter().map(&mut number).collect();
        Ok(Self { robot, channels, biases, disturbances: Disturbances::default(), states })
    }

    /// The same with what acts on links from outside: a disturbance torque of each, if any, and all varying wrenches.
    ///
    /// # Errors
    /// One that does not fit the robot.
    pub fn with_disturbances(
        mut self,
        torques: Option<LinkDisturbance>,
        wrenches: WrenchLaw,
    ) -> Result<Self, DesignError> {
        let n = self.joints();
        torques.iter().try_for_each(|law| law.check(n))?;
        wrenches.check(&self.robot)?;
        self.disturbances = Disturbances::new(torques, wrenches, 3 * n);
        let more = self.disturbances.len();
        self.biases.iter_mut().flatten().for_each(|bias| *bias += more);
        self.states += more;
        Ok(self)
    }

    /// Number of leading states that channels depend on by more than a bias.
    #[inline(always)]
    pub fn dense(&self) -> usize {
        3 * self.joints() + self.disturbances.len()
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
    pub(crate) fn begin(&self, q: &[f64], noise: &JerkNoise, belief: &mut Gaussian) {
        let biases = self.biases.iter().zip(&noise.initial_bias).filter_map(|(bias, std)| bias.map(|_| std));
        belief.clear();
        for (i, std) in noise.initial.iter().chain(self.disturbances.initial()).chain(biases).enumerate() {
            belief.covariance.put(i, i, std * std);
        }
        belief.mean[..q.len()].copy_from_slice(q);
    }

    /// What the biases do in time.
    pub(super) fn drift<'a>(&'a self, noise: &'a JerkNoise) -> Biases<'a> {
        Biases { states: &self.biases, walk: &noise.bias_walk, time: &noise.bias_time }
    }

    /// Time update over `dt` [s] under a constant `jerk` (n): x ← F x + G u, P ← F P Fᵀ + Q.
    ///
    /// F is three blocks wide, so the product is a few row and column sums in place of two dense products. Process
    /// noise is the integral of white jerk over the step, where eq. (10) has one kick at its start.
    #[inline(always)]
    pub(crate) fn predict(&self, belief: &mut Gaussian, noise: &JerkNoise, dt: f64, jerk: &[f64]) {
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
        // Above the diagonal, columns of accelerations and biases stay as they are.
        for (i, row) in p.data.chunks_exact_mut(p.stride).take(2 * n).enumerate() {
            let (q, rest) = row.split_at_mut(n);
            let (dq, ddq) = rest.split_at_mut(n);
            if i < n {
                for ((q, dq), ddq) in q.iter_mut().zip(&*dq).zip(&*ddq) {
                    *q += dt * dq + half * ddq;
                }
            }
            linear::add_scaled(dq, dt, ddq);
        }
        self.add_process_noise(p, noise, dt);
        p.mirror();
        self.drift(noise).predict(belief, dt);
        self.disturbances.drift().predict(belief, dt);
    }

    /// Q of white jerk over the step, joint by joint, and what positions and velocities wander beside.
    #[inline(always)]
    fn add_process_noise(&self, p: &mut Symmetric, noise: &JerkNoise, dt: f64) {
        let (n, stride, white_jerk) = (self.joints(), p.stride, jerk_noise::covariance(dt));
        for j in 0..n {
            let density = noise.jerk[j] * noise.jerk[j];
            for a in 0..3 {
                for b in a..3 {
                    p.data[(a * n + j) * stride + b * n + j] += density * white_jerk[a][b];
                }
            }
        }
        for (i, walk) in noise.link_walk.iter().enumerate() {
            p.data[i * stride + i] += walk * walk * dt;
        }
    }

    /// Rows Gᵀ with G Gᵀ = Q, what [`predict`](Self::predict) adds to P over `dt`, one a state; `rows` are zero.
    #[inline(always)]
    pub(super) fn noise_rows(&self, rows: &mut [f64], stride: usize, noise: &JerkNoise, dt: f64) {
        let (n, white_jerk) = (self.joints(), jerk_noise::covariance(dt));
        let rest = self.drift(noise).noise_rows(rows, stride, dt);
        let rest = self.disturbances.drift().noise_rows(rest, stride, dt);
        for (j, rows) in rest.chunks_exact_mut(3 * stride).take(n).enumerate() {
            let density = noise.jerk[j] * noise.jerk[j];
            // From the acceleration up, which all else follows.
            let mut block = [0.0; 9];
            for a in 0..3 {
                for b in 0..3 {
                    block[a * 3 + b] = density * white_jerk[2 - a][2 - b];
                }
            }
            block[4] += noise.link_walk[n + j] * noise.link_walk[n + j] * dt;
            block[8] += noise.link_walk[j] * noise.link_walk[j] * dt;
            linear::cholesky(&mut block, 3, 3);
            for (c, row) in rows.chunks_exact_mut(stride).enumerate() {
                for a in c..3 {
                    row[(2 - a) * n + j] = block[a * 3 + c];
                }
            }
        }
    }

    /// The adjoint of [`predict`](Self::predict): λ ← Fᵀ λ, Λ ← Fᵀ Λ F.
    #[inline(always)]
    pub(crate) fn retreat(&self, lambda: &mut [f64], big: &mut Symmetric, noise: &JerkNoise, dt: f64) {
        self.drift(noise).retreat(lambda, big, dt);
        self.disturbances.drift().retreat(lambda, big, dt);
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

    /// Adds to `p` what `noise` does over `dt` [s] to links and biases, and gives the number of random numbers in that.
    #[inline(always)]
    pub(super) fn add_noise(&self, noise: &JerkNoise, dt: f64, p: &mut Symmetric) -> f64 {
        self.add_process_noise(p, noise, dt);
        p.mirror();
        let moved = |all: &[f64]| all.iter().filter(|&&density| density > 0.0).count();
        let mut count = 3 * moved(&noise.jerk) + moved(&noise.link_walk);
        for (channel, state) in self.biases.iter().enumerate() {
            let Some(b) = state.filter(|_| noise.bias_walk[channel] > 0.0) else { continue };
            p.data[b * (p.stride + 1)] += noise.bias_step(channel, dt).variance;
            count += 1;
        }
        count as f64
    }

    /// # Errors
    /// As [`check_deviations`](Self::check_deviations), and a reading without noise.
    pub(crate) fn check(&self, noise: &JerkNoise) -> Result<(), DesignError> {
        self.check_deviations(noise)?;
        check_readings(&noise.reading)
    }

    /// # Errors
    /// A length that does not fit the model, a standard deviation that is negative or not a number.
    pub(super) fn check_deviations(&self, noise: &JerkNoise) -> Result<(), DesignError> {
        let (n, m) = (self.joints(), self.channels());
        let JerkNoise { jerk, link_walk, reading, torsion, bias_walk, bias_time, initial, initial_bias } = noise;
        let lengths = [
            ("jerk", jerk, n),
            ("link_walk", link_walk, 2 * n),
            ("reading", reading, m),
            ("bias_walk", bias_walk, m),
            ("initial", initial, 3 * n),
            ("initial_bias", initial_bias, m),
            ("torsion", &vec![*torsion], 1),
        ];
        lengths.iter().try_for_each(|(what, values, expected)| check_deviations(what, values, *expected))?;
        check_times(bias_time, m)
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
