//! The elastic-joint model: links behind their springs, and motors moved by torques.
//!
//! Each joint has two equations (De Luca, Schröder and Thümmel 2007; Ulrich and Sasiadek 2011),
//!
//! M q̈ + C q̇ + g + friction = φ(θ − q) + D(θ̇ − q̇) + d + w_link,  B θ̈ + friction = τ + e − φ − D(θ̇ − q̇) + w_motor,
//!
//! with white accelerations w and, where they are asked for, disturbance torques e of motors and d of links that wander. Their
//! accelerations and derivatives are those of [`ElasticDynamics`](crate::dynamics::ElasticDynamics); a step of time is
//! `transition`, what sensors read is `elastic_measurement`, and what parameters do is `elastic_sensitivity`. A torque that
//! is missing wanders from its last reading until the next, as a disturbance of its own. Motors that jerk moves are
//! `motor_jerk`.

use super::disturbance::{LinkDisturbance, WrenchLaw};
use super::elastic_measurement::ElasticMeasurement;
use super::elastic_process::{CommonNoise, ElasticProcess, MotorInput};
use super::elastic_sensitivity::ElasticSensitivity;
use super::motor_torques::MotorTorques;
use super::paired::Paired;
use super::tolerances::Tolerances;
use super::transition::Transition;
use crate::check::{check_deviations, check_readings, check_times, expect_length};
use crate::dynamics::ElasticLayout;
use crate::error::DesignError;
use crate::estimate::measurement::Kind;
use crate::estimate::observer::Rest;
use crate::robot::{Drive, Robot};
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
    /// By how much a motor torque whose reading is missing may wander from the last one in one second (n) [N m/√s].
    pub torque_walk: Vec<f64>,
    /// By how much each channel's bias wanders in one second (channels) [unit/√s].
    pub bias_walk: Vec<f64>,
    /// Over which time each channel's bias forgets (channels) [s], infinite for a random walk.
    pub bias_time: Vec<f64>,
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
    /// Whether friction elements start relaxed, but for a small part of their way: where nothing tells where links are, noise
    /// alone would move what is estimated of them. [`Uncertain::Hysteresis`](super::Uncertain::Hysteresis) has the rest.
    pub relaxed: bool,
}

impl ElasticSettings {
    /// Part of their way within which friction elements that start relaxed are.
    pub const RELAXED: f64 = 0.05;
}

/// State (q, q̇, θ, θ̇, deflections of friction elements, disturbance torques of motors, of links, varying wrenches, biases) of an elastic-joint robot under measured motor torques
/// (Ulrich and Sasiadek 2011, with every sensor that a log can have).
///
/// θ and θ̇ are those of the elastic joints: the motor of a rigid one moves as its link.
///
/// ```
/// use linkside_core::estimate::kalman::{
///     Discretization, ElasticModel, ElasticNoise, ElasticSettings, ExtendedKalmanFilter, FilterSettings, Inputs,
///     KalmanSample,
/// };
/// use linkside_core::estimate::measurement::Kind;
///
/// let robot = std::sync::Arc::new(linkside_core::demo::arm()?);
/// let settings = ElasticSettings {
///     kinds: vec![Kind::Motor],
///     disturbances: false,
///     biased: vec![false],
///     held: true, // the amplifier holds its torque between samples
///     discretization: Discretization::Exact,
///     relaxed: true,
/// };
/// let noise = ElasticNoise {
///     link: vec![3e-3],
///     motor: vec![1e-2],
///     torque: vec![1.0],
///     disturbance_walk: vec![0.0],
///     reading: vec![1e-5],
///     torque_walk: vec![1.0],
///     bias_walk: vec![0.0],
///     bias_time: vec![f64::INFINITY],
///     initial: vec![1e-4, 1e-3, 0.0],
///     initial_bias: vec![0.0],
/// };
/// let model = ElasticModel::new(robot, &settings, noise)?;
/// let mut filter = ExtendedKalmanFilter::new(model, FilterSettings { gate: None, iterations: 1 })?;
/// for _ in 0..20 {
///     let inputs = Inputs { tau: &[0.0], ..Inputs::default() };
///     filter.step(KalmanSample { dt: 1e-3, readings: &[0.1], inputs })?;
/// }
/// // (q, q̇, θ, θ̇): without torque the link stays where the motor is.
/// assert!((filter.belief().mean[0] - filter.belief().mean[2]).abs() < 1e-9);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub type ElasticModel = Paired<ElasticProcess, ElasticMeasurement>;

impl ElasticModel {
    /// `robot` with `noise`.
    ///
    /// # Errors
    /// Noise or biases that do not fit the channels, a negative standard deviation, a reading without noise.
    pub fn new(robot: Arc<Robot>, settings: &ElasticSettings, noise: ElasticNoise) -> Result<Self, DesignError> {
        Self::disturbed(robot, settings, noise, None, WrenchLaw::default())
    }

    /// The same with what acts on links from outside: a disturbance torque of each, if any, and all varying wrenches.
    ///
    /// # Errors
    /// As [`new`](Self::new), and one that does not fit the robot.
    pub fn disturbed(
        robot: Arc<Robot>,
        settings: &ElasticSettings,
        noise: ElasticNoise,
        links: Option<LinkDisturbance>,
        wrenches: WrenchLaw,
    ) -> Result<Self, DesignError> {
        Kind::refuse_motor_torques(&settings.kinds, "none, as torques move the motors")?;
        let channels = Kind::all_channels(&settings.kinds, &robot).len();
        check(&noise, robot.len(), channels)?;
        let layout = ElasticLayout::new(&robot, settings.disturbances);
        let motors = MotorInput::Torques(Box::new(MotorTorques::new(&noise, settings.held)));
        let ElasticNoise { torque, reading, bias_walk, bias_time, initial, initial_bias, .. } = noise.clone();
        let parts = Parts {
            sources: sources(&robot, &layout, &noise),
            layout,
            motors,
            discretization: settings.discretization,
            relaxed: settings.relaxed,
            torque,
            reading,
            bias_walk,
            bias_time,
            initial,
            initial_bias,
        };
        parts.join(robot, &settings.kinds, &settings.biased, links, wrenches)
    }

    /// The model of a robot of which some numbers are known to a tolerance only.
    pub fn with_tolerances(mut self, tolerances: impl Into<Tolerances>) -> Self {
        let sensitivity = ElasticSensitivity::new(tolerances.into(), self.process.robot.len());
        self.process.transition.consider(sensitivity.clone());
        self.measurement.sensitivity = sensitivity;
        self
    }
}

/// What a model is put together of, whatever moves its motors.
pub(super) struct Parts {
    pub(super) layout: ElasticLayout,
    pub(super) motors: MotorInput,
    /// States that white noise drives, and its densities.
    pub(super) sources: Vec<(usize, f64)>,
    pub(super) discretization: Discretization,
    pub(super) relaxed: bool,
    pub(super) torque: Vec<f64>,
    pub(super) reading: Vec<f64>,
    pub(super) bias_walk: Vec<f64>,
    pub(super) bias_time: Vec<f64>,
    pub(super) initial: Vec<f64>,
    pub(super) initial_bias: Vec<f64>,
}

impl Parts {
    /// The model with channels of these kinds, of which some have a bias, and with what acts on links from outside.
    ///
    /// # Errors
    /// Biases, disturbance torques or wrenches that do not fit the robot.
    pub(super) fn join(
        self,
        robot: Arc<Robot>,
        kinds: &[Kind],
        biased: &[bool],
        links: Option<LinkDisturbance>,
        wrenches: WrenchLaw,
    ) -> Result<ElasticModel, DesignError> {
        let Self { mut layout, mut sources, motors, .. } = self;
        let channels = Kind::all_channels(kinds, &robot);
        expect_length("biased", biased.len(), channels.len())?;
        if let Some(links) = &links {
            links.check(robot.len())?;
            layout = layout.with_link_disturbances(links.time);
        }
        wrenches.check(&robot)?;
        let mut states = layout.dense;
        let mut number = |&biased: &bool| {
            states += usize::from(biased);
            biased.then(|| states - 1)
        };
        let biases: Vec<_> = biased.iter().map(&mut number).collect();
        let noise = [&self.reading[..], &self.torque];
        let measurement = ElasticMeasurement::new(Arc::clone(&robot), layout.clone(), channels, biases.clone(), noise);
        if let (Some(first), Some(links)) = (layout.link_disturbance, &links) {
            sources.extend(links.walk.iter().enumerate().map(|(j, walk)| (first + j, *walk)));
        }
        if let Some(first) = layout.wrench {
            sources.extend(wrenches.walk.iter().enumerate().map(|(k, walk)| (first + k, *walk)));
        }
        let process = ElasticProcess {
            transition: Transition::new(&robot, layout, self.discretization, states, sources),
            motors,
            common: CommonNoise {
                bias_walk: self.bias_walk,
                bias_time: self.bias_time,
                initial_bias: self.initial_bias,
                initial: self.initial,
                links: links.map_or_else(Vec::new, |links| links.initial),
                wrenches: wrenches.initial,
            },
            gone: if self.relaxed { ElasticSettings::RELAXED } else { 1.0 },
            rest: Rest::new(&robot),
            robot,
            biases,
            states,
        };
        Ok(ElasticModel::of(process, measurement))
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
        ("torque_walk", &noise.torque_walk, n),
        ("reading", &noise.reading, m),
        ("bias_walk", &noise.bias_walk, m),
        ("initial", &noise.initial, 3 * n),
        ("initial_bias", &noise.initial_bias, m),
    ];
    lengths.iter().try_for_each(|(what, values, expected)| check_deviations(what, values, *expected))?;
    check_times(&noise.bias_time, m)?;
    check_readings(&noise.reading)
}

/// Whether a motor moves beside its link.
fn driven(drive: &Drive) -> bool {
    drive.elastic && !drive.is_passive()
}

/// The states that white noise drives, and its densities.
fn sources(robot: &Robot, layout: &ElasticLayout, noise: &ElasticNoise) -> Vec<(usize, f64)> {
    let n = robot.len();
    let links = (0..n).map(|j| (n + j, noise.link[j]));
    let motors = (0..n).filter(|&j| driven(&robot.drives[j])).map(|j| (layout.dtheta[j], noise.motor[j]));
    let disturbances = layout
        .disturbance
        .into_iter()
        .flat_map(|first| noise.disturbance_walk.iter().enumerate().map(move |(j, walk)| (first + j, *walk)));
    links.chain(motors).chain(disturbances).collect()
}
