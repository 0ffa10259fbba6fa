//! The elastic-joint model's process: links and motors moved by motor torques.
//!
//! Each joint has two equations (De Luca, Schröder and Thümmel 2007; Ulrich and Sasiadek 2011),
//!
//! M q̈ + C q̇ + g + friction = φ(θ − q) + D(θ̇ − q̇) + d + w_link,  B θ̈ + friction = τ + e − φ − D(θ̇ − q̇) + w_motor,
//!
//! with white accelerations w and, where they are asked for, disturbance torques e of motors and d of links that wander. Their
//! accelerations and derivatives are those of [`ElasticDynamics`](crate::dynamics::ElasticDynamics); a step of time is
//! `transition`, what sensors read is `elastic_measurement`, and what parameters do is `elastic_sensitivity`. A torque that
//! is missing wanders from its last reading until the next, as a disturbance of its own.

use super::disturbance::{LinkDisturbance, WrenchLaw, depend, hold, hold_wrenches};
use super::drift::Biases;
use super::elastic_measurement::ElasticMeasurement;
use super::elastic_sensitivity::ElasticSensitivity;
use super::gaussian::{Gaussian, Symmetric};
use super::model::{Paired, Process};
use super::recording::{KalmanRecording, KalmanSample};
use super::sigma_points::SigmaRule;
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
        let channels = Kind::all_channels(&settings.kinds, &robot);
        expect_length("biased", settings.biased.len(), channels.len())?;
        let mut layout = ElasticLayout::new(&robot, settings.disturbances);
        check(&noise, robot.len(), channels.len())?;
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
        let biases: Vec<_> = settings.biased.iter().map(&mut number).collect();
        let measurement = [&noise.reading[..], &noise.torque];
        let measurement =
            ElasticMeasurement::new(Arc::clone(&robot), layout.clone(), channels, biases.clone(), measurement);
        let mut sources = sources(&robot, &layout, &noise);
        if let (Some(first), Some(links)) = (layout.link_disturbance, &links) {
            sources.extend(links.walk.iter().enumerate().map(|(j, walk)| (first + j, *walk)));
        }
        if let Some(first) = layout.wrench {
            sources.extend(wrenches.walk.iter().enumerate().map(|(k, walk)| (first + k, *walk)));
        }
        let n = robot.len();
        let process = ElasticProcess {
            transition: Transition::new(&robot, layout, settings.discretization, states, sources),
            tau: vec![0.0; n],
            age: vec![0.0; n],
            before: vec![0.0; n],
            after: vec![0.0; n],
            outage: vec![(0.0, 0.0); n],
            held: settings.held,
            gone: if settings.relaxed { ElasticSettings::RELAXED } else { 1.0 },
            rest: Rest::new(&robot),
            robot,
            biases,
            states,
            noise,
            links: links.map_or_else(Vec::new, |links| links.initial),
            wrenches: wrenches.initial,
        };
        Ok(Self::of(process, measurement))
    }

    /// The model of a robot of which some numbers are known to a tolerance only.
    pub fn with_tolerances(mut self, tolerances: impl Into<Tolerances>) -> Self {
        let sensitivity = ElasticSensitivity::new(tolerances.into(), self.process.robot.len());
        self.process.transition.consider(sensitivity.clone());
        self.measurement.sensitivity = sensitivity;
        self
    }
}

/// Links and motors between samples.
#[derive(Clone, Debug)]
pub struct ElasticProcess {
    /// Links, drives and sensors.
    robot: Arc<Robot>,
    /// The state that is each channel's bias (channels).
    biases: Vec<Option<usize>>,
    /// Number of all states.
    states: usize,
    /// Densities, walks and initial uncertainties.
    noise: ElasticNoise,
    /// What the links' disturbance torques may be at the first sample (n); empty where there are none.
    links: Vec<f64>,
    /// The same of numbers of varying wrenches.
    wrenches: Vec<f64>,
    /// The step of time with its scratch.
    transition: Transition,
    /// The latest torques that were read.
    tau: Vec<f64>,
    /// How long ago that was (n) [s].
    age: Vec<f64>,
    /// Torques at the beginning and at the end of a step.
    before: Vec<f64>,
    after: Vec<f64>,
    /// Mean and variance of each disturbance before its torque's readings were missing.
    outage: Vec<(f64, f64)>,
    held: bool,
    /// Part of their way that friction elements may have gone at the first sample.
    gone: f64,
    /// Finds where links hang at a first sample.
    rest: Rest,
}

impl ElasticProcess {
    /// How biases wander over a step.
    fn drift(&self) -> Biases<'_> {
        Biases { states: &self.biases, walk: &self.noise.bias_walk, time: &self.noise.bias_time }
    }

    /// Readies the step of `dt` to motor torques `read`, NaN where missing.
    ///
    /// A torque that nobody reads is held, and the true one wanders from it: with the motor's disturbance, until the reading is
    /// back and the disturbance is again what it was before. Without disturbances the wandering is noise of the torque that
    /// is constant over each step, of a variance that gives velocity the right one.
    #[inline(always)]
    fn expect_torques(&mut self, belief: &Gaussian, read: &[f64], dt: f64) {
        let Self { noise, age, transition, outage, .. } = self;
        transition.replaced.clear();
        for (j, age) in age.iter_mut().enumerate() {
            let gone = read[j].is_nan();
            let wander = if gone || *age > 0.0 { noise.torque_walk[j] } else { 0.0 };
            transition.torque[j] = noise.torque[j] * noise.torque[j];
            if let Some(first) = transition.layout.disturbance {
                let (state, walk) = (first + j, noise.disturbance_walk[j]);
                // The disturbance carries the outage: it is a state, so that what it grew to is estimated while the
                // torque is gone.
                transition.noise.set_density(state, (walk * walk + wander * wander).sqrt());
                if gone && *age == 0.0 {
                    outage[j] = (belief.mean[state], belief.covariance.at(state, state));
                } else if !gone && *age > 0.0 && noise.torque_walk[j] > 0.0 {
                    transition.replaced.push((state, outage[j].1 + walk * walk * (*age + dt)));
                }
            } else {
                // A walk of density w has, integrated over the age a, the variance w² a³/3: what is added over this
                // step, spread over it as a constant torque of that effect on velocity.
                let grown = (*age + dt) * (*age + dt) * (*age + dt) - *age * *age * *age;
                transition.torque[j] += wander * wander * grown / (3.0 * dt * dt);
            }
            *age = if gone { *age + dt } else { 0.0 };
        }
    }

    /// The torques between the sample before and one of which `read` is read.
    #[inline(always)]
    fn take_torques(&mut self, read: &[f64]) {
        for (j, read) in read.iter().enumerate() {
            let back = self.transition.layout.disturbance.is_some_and(|first| self.is_replaced(first + j));
            self.before[j] = self.tau[j];
            // At the end of an outage it is the disturbance that has what the held torque lacks.
            self.after[j] = if back || read.is_nan() { self.tau[j] } else { *read };
            if !read.is_nan() {
                self.tau[j] = *read;
            }
        }
    }

    /// A sampled torque may have changed at any time between two samples: its mean is off by as much as a uniform time has it.
    #[inline(always)]
    fn doubt_between_samples(&mut self) {
        if !self.held {
            for (variance, (before, after)) in
                self.transition.torque.iter_mut().zip(self.before.iter().zip(&self.after))
            {
                *variance += (after - before) * (after - before) / 12.0;
            }
        }
    }

    /// Whether a disturbance is again what it was before its torque's outage.
    #[inline(always)]
    fn is_replaced(&self, state: usize) -> bool {
        self.transition.replaced.iter().any(|(replaced, _)| *replaced == state)
    }

    /// Links and motors at rest at these positions, everything independent.
    fn begin(&self, theta: &[f64], belief: &mut Gaussian) {
        let (n, layout, q) = (self.robot.len(), &self.transition.layout, self.rest.q());
        let (position, rest) = self.noise.initial.split_at(n);
        let (velocity, disturbance) = rest.split_at(n);
        belief.clear();
        let mut set = |state: usize, mean: f64, std: f64| {
            belief.mean[state] = mean;
            belief.covariance.put(state, state, std * std);
        };
        for j in 0..n {
            for (k, x, s) in [(layout.theta[j], theta[j], position[j]), (layout.dtheta[j], 0.0, velocity[j])] {
                set(k, x, if self.robot.drives[j].is_passive() { FIXED * s } else { s });
            }
            set(j, q[j], position[j]);
            set(n + j, 0.0, velocity[j]);
            if let Some(first) = layout.disturbance {
                set(first + j, 0.0, disturbance[j]);
            }
        }
        // A friction element may be anywhere between its limits, or near the middle if that is said.
        for (_, k, element) in layout.elements(&self.robot) {
            set(k, 0.0, self.gone * element.reach() / 3.0_f64.sqrt());
        }
        for (bias, s) in self.biases.iter().zip(&self.noise.initial_bias) {
            if let Some(b) = *bias {
                set(b, 0.0, *s);
            }
        }
        if let Some(first) = layout.link_disturbance {
            self.links.iter().enumerate().for_each(|(j, s)| set(first + j, 0.0, *s));
        }
        if let Some(first) = layout.wrench {
            self.wrenches.iter().enumerate().for_each(|(k, s)| set(first + k, 0.0, *s));
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
        recording.expect(self.biases.len(), self.robot.len(), &[("tau", recording.inputs.tau)])
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
        self.tau.copy_from_slice(sample.inputs.tau);
        self.age.fill(0.0);
        self.transition.start(&self.robot, &belief.mean, &self.tau);
    }

    #[inline(always)]
    fn predict(&mut self, sample: &KalmanSample<'_>, belief: &mut Gaussian) {
        self.expect_torques(belief, sample.inputs.tau, sample.dt);
        self.take_torques(sample.inputs.tau);
        self.doubt_between_samples();
        // A held torque is in the log at the end of the step in which it acted.
        let before = if self.held { &self.after } else { &self.before };
        self.transition.advance(&self.robot, belief, (before, &self.after), sample.dt);
        let first = self.transition.layout.disturbance.unwrap_or(0);
        for &(state, _) in &self.transition.replaced {
            belief.mean[state] = self.outage[state - first].0;
        }
        self.drift().predict(belief, sample.dt);
    }

    #[inline(always)]
    fn carry(&mut self, columns: &mut [f64], stride: usize, dt: f64) {
        self.transition.carry(columns, stride);
        self.drift().carry(columns, stride, dt);
    }

    #[inline(always)]
    fn drive(&mut self, columns: &mut [f64], stride: usize) {
        self.transition.drive(columns, stride);
    }

    #[inline(always)]
    fn carry_back(&mut self, memory: &[f64], columns: &mut [f64], stride: usize, dt: f64) {
        self.drift().carry(columns, stride, dt);
        self.transition.carry_back(memory, columns, stride);
    }

    fn memory(&self) -> usize {
        2 * self.transition.layout.dense.pow(2)
    }

    /// The transition to this sample with its noise.
    #[inline(always)]
    fn remember(&self, memory: &mut Vec<f64>) {
        self.transition.remember(memory);
    }

    #[inline(always)]
    fn noise_rows(&mut self, memory: &[f64], dt: f64, rows: &mut [f64], stride: usize) {
        let rest = self.drift().noise_rows(rows, stride, dt);
        self.transition.noise_rows(memory, rest, stride);
    }

    fn bridged(&self) -> bool {
        self.age.iter().any(|&age| age > 0.0)
    }

    #[inline(always)]
    fn retreat(&mut self, memory: &[f64], dt: f64, lambda: &mut [f64], big: &mut Symmetric) {
        self.drift().retreat(lambda, big, dt);
        self.transition.retreat(memory, lambda, big);
    }
}

/// Where nothing drives a joint, the fixed end of its spring is known so much better than a motor at the start.
const FIXED: f64 = 1e-6;

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
