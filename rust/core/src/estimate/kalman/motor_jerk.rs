//! The elastic-joint model with motors moved by jerk: it needs no motor torques.
//!
//! A motor's position is measured far better than anything is known of its torque. So its motion is taken as it is, a chain of
//! three integrators of commanded and random jerk, and links follow it through springs, dampers and their own dynamics:
//!
//! θ⃛ = u + w_motor,  M q̈ + C q̇ + g + S θ̈ + friction = φ(θ − q) + D(θ̇ − q̇) + d + w_link.
//!
//! Nothing of the links reaches the motors: what is believed of motor positions alone does not depend on springs or masses.
//! The link of a rigid joint moves as its motor. A step of time, its noise and all derivatives are those of the model with
//! torques ([`ElasticLayout::motor_acceleration`]).

use super::disturbance::{LinkDisturbance, WrenchLaw};
use super::elastic::{Discretization, ElasticModel, Parts};
use super::elastic_process::MotorInput;
use crate::check::{check_deviations, check_readings, check_times};
use crate::dynamics::ElasticLayout;
use crate::error::DesignError;
use crate::estimate::measurement::Kind;
use crate::robot::Robot;
use std::sync::Arc;

/// Standard deviations of everything that is random where jerk moves motors.
#[derive(Clone, Debug)]
pub struct MotorJerkNoise {
    /// Density of each motor's jerk (n) [rad/s³/√Hz]: its acceleration wanders by this in one second.
    pub jerk: Vec<f64>,
    /// Density of what the links' equations leave out (n), of elastic joints: velocity wanders by this in one second
    /// [rad/s/√s].
    pub link: Vec<f64>,
    /// One reading's noise (channels) [the channel's unit].
    pub reading: Vec<f64>,
    /// By how much each channel's bias wanders in one second (channels) [unit/√s].
    pub bias_walk: Vec<f64>,
    /// Over which time each channel's bias forgets (channels) [s], infinite for a random walk.
    pub bias_time: Vec<f64>,
    /// Initial position and velocity, of links and of motors, and acceleration of each motor (3n).
    pub initial: Vec<f64>,
    /// Initial bias (channels).
    pub initial_bias: Vec<f64>,
}

/// What the model with motors moved by jerk consists of; see [`ElasticSettings`](super::ElasticSettings).
#[derive(Clone, Debug)]
pub struct MotorJerkSettings {
    /// What is measured; motor positions among them.
    pub kinds: Vec<Kind>,
    /// Which channels have a bias state, in their order.
    pub biased: Vec<bool>,
    /// Whether friction elements start relaxed.
    pub relaxed: bool,
}

impl ElasticModel {
    /// `robot` with `noise`, its motors moved by the commanded jerk of [`Inputs`](super::Inputs) and by random jerk, and with
    /// what acts on links from outside. State (q, q̇, θ, θ̇ of the elastic joints, deflections of friction elements, θ̈, disturbance
    /// torques of links, varying wrenches, biases).
    ///
    /// ```
    /// use linkside_core::estimate::kalman::{
    ///     ElasticModel, ExtendedKalmanFilter, FilterSettings, Inputs, KalmanSample, MotorJerkNoise, MotorJerkSettings,
    ///     WrenchLaw,
    /// };
    /// use linkside_core::estimate::measurement::Kind;
    ///
    /// let robot = std::sync::Arc::new(linkside_core::demo::arm()?);
    /// let settings = MotorJerkSettings { kinds: vec![Kind::Motor], biased: vec![false], relaxed: true };
    /// let noise = MotorJerkNoise {
    ///     jerk: vec![100.0],
    ///     link: vec![3e-3],
    ///     reading: vec![1e-5],
    ///     bias_walk: vec![0.0],
    ///     bias_time: vec![f64::INFINITY],
    ///     initial: vec![1e-4, 1e-3, 0.1],
    ///     initial_bias: vec![0.0],
    /// };
    /// let model = ElasticModel::moved_by_jerk(robot, &settings, noise, None, WrenchLaw::default())?;
    /// let mut filter = ExtendedKalmanFilter::new(model, FilterSettings { gate: None, iterations: 1 })?;
    /// for _ in 0..20 {
    ///     let inputs = Inputs { jerk: &[0.0], ..Inputs::default() };
    ///     filter.step(KalmanSample { dt: 1e-3, readings: &[0.1], inputs })?;
    /// }
    /// // (q, q̇, θ, θ̇, θ̈): the link stays where its motor is.
    /// assert!((filter.belief().mean[0] - filter.belief().mean[2]).abs() < 1e-9);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// Noise or biases that do not fit the channels, a negative standard deviation, a reading without noise, something from
    /// outside that does not fit the robot.
    pub fn moved_by_jerk(
        robot: Arc<Robot>,
        settings: &MotorJerkSettings,
        noise: MotorJerkNoise,
        links: Option<LinkDisturbance>,
        wrenches: WrenchLaw,
    ) -> Result<Self, DesignError> {
        let MotorJerkSettings { kinds, biased, relaxed } = settings;
        noise.check(robot.len(), Kind::all_channels(kinds, &robot).len())?;
        let layout = ElasticLayout::moved_by_jerk(&robot);
        let MotorJerkNoise { reading, bias_walk, bias_time, initial, initial_bias, .. } = noise.clone();
        let parts = Parts {
            sources: noise.sources(&robot, &layout),
            layout,
            motors: MotorInput::Jerk,
            discretization: Discretization::Exact,
            relaxed: *relaxed,
            torque: vec![0.0; robot.len()],
            reading,
            bias_walk,
            bias_time,
            initial,
            initial_bias,
        };
        parts.join(robot, kinds, biased, links, wrenches)
    }

    /// Whether jerk moves motors, and not torques.
    pub fn is_moved_by_jerk(&self) -> bool {
        matches!(self.process.motors, MotorInput::Jerk)
    }
}

impl MotorJerkNoise {
    /// # Errors
    /// A length that does not fit `n` joints and `m` channels, or a value that none may have.
    fn check(&self, n: usize, m: usize) -> Result<(), DesignError> {
        let lengths = [
            ("jerk", &self.jerk, n),
            ("link", &self.link, n),
            ("reading", &self.reading, m),
            ("bias_walk", &self.bias_walk, m),
            ("initial", &self.initial, 3 * n),
            ("initial_bias", &self.initial_bias, m),
        ];
        lengths.iter().try_for_each(|(what, values, expected)| check_deviations(what, values, *expected))?;
        check_times(&self.bias_time, m)?;
        check_readings(&self.reading)
    }

    /// The states that white noise drives, and its densities: the rates of links behind springs, and accelerations of motors.
    fn sources(&self, robot: &Robot, layout: &ElasticLayout) -> Vec<(usize, f64)> {
        let n = robot.len();
        let links = (0..n).filter(|&j| robot.drives[j].elastic).map(|j| (n + j, self.link[j]));
        let moved = (0..n).filter(|&j| !robot.drives[j].is_passive());
        let motors = moved.filter_map(|j| Some((layout.motor_acceleration? + j, self.jerk[j])));
        links.chain(motors).collect()
    }
}
