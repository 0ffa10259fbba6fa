//! A torque on each link that the model lacks: a contact, a push, a payload, a counterbalance.
//!
//! What a transmission gives its link is the load less this torque, τ_e = M q̈ + C q̇ + g − d. A joint torque sensor reads
//! τ_e and with it d; a motor stands where τ_e twists the spring to, so that θ − φ⁻¹(τ_e) is the link whatever d is. Each
//! d is a process of Gauss and Markov, ḋ = −d/T + white noise.

use super::drift::Biases;
use super::gaussian::{Gaussian, Symmetric};
use crate::check::{check_deviations, expect};
use crate::error::DesignError;
use crate::robot::Robot;

/// How the links' disturbance torques wander.
#[derive(Clone, Debug)]
pub struct LinkDisturbance {
    /// What each may be at the first sample (n) [N m].
    pub initial: Vec<f64>,
    /// By how much each wanders in one second (n) [N m/√s].
    pub walk: Vec<f64>,
    /// Over which time each forgets where it was [s]; infinite for random walks.
    pub time: f64,
}

impl LinkDisturbance {
    /// # Errors
    /// Not one a joint, a standard deviation that is negative or not finite, a time that is not greater than 0.
    pub(super) fn check(&self, joints: usize) -> Result<(), DesignError> {
        check_deviations("link_disturbance", &self.initial, joints)?;
        check_deviations("link_disturbance_walk", &self.walk, joints)?;
        expect(self.time > 0.0, "link_disturbance_time", self.time, "a time greater than 0")
    }
}

/// The states of the links' disturbance torques in the acceleration-driven model, if it has any.
#[derive(Clone, Debug, Default)]
pub(super) struct Disturbances {
    states: Vec<Option<usize>>,
    initial: Vec<f64>,
    pub(super) walk: Vec<f64>,
    time: Vec<f64>,
}

impl Disturbances {
    /// Those that wander as `law` says, the first of them being state `first`.
    pub(super) fn new(law: LinkDisturbance, first: usize) -> Self {
        let LinkDisturbance { initial, walk, time } = law;
        let n = initial.len();
        Self { states: (first..first + n).map(Some).collect(), initial, walk, time: vec![time; n] }
    }

    /// How many.
    #[inline(always)]
    pub(super) fn len(&self) -> usize {
        self.states.len()
    }

    /// The first of them.
    pub(super) fn first(&self) -> Option<usize> {
        self.states.first().copied().flatten()
    }

    /// Standard deviations at the first sample.
    pub(super) fn initial(&self) -> &[f64] {
        &self.initial
    }

    /// ḋ of joint `j`'s, but for what is random.
    #[inline(always)]
    pub(super) fn rate(&self, j: usize, d: f64) -> f64 {
        -d / self.time[j]
    }

    /// 1/T of joint `j`'s.
    #[inline(always)]
    pub(super) fn forgetting(&self, j: usize) -> f64 {
        1.0 / self.time[j]
    }

    /// A step of time, which they pass like biases.
    #[inline(always)]
    pub(super) fn drift(&self) -> Biases<'_> {
        Biases { states: &self.states, walk: &self.walk, time: &self.time }
    }
}

/// Lets links at rest depend on the disturbances from state `first` on that hold them there: with the motor's position
/// known, q = θ − φ⁻¹(load − d).
pub(super) fn hold(robot: &Robot, theta: &[f64], first: usize, belief: &mut Gaussian) {
    let Gaussian { mean, covariance } = belief;
    for (j, drive) in robot.drives.iter().enumerate().filter(|(_, drive)| drive.elastic) {
        let compliance = drive.compliance(drive.torsion_between(theta[j], mean[j]));
        depend(covariance, j, first + j, compliance);
    }
}

/// Adds `factor` times state `d`, which nothing depended on, to state `j`.
pub(super) fn depend(p: &mut Symmetric, j: usize, d: usize, factor: f64) {
    let variance = p.at(d, d);
    p.put(j, j, p.at(j, j) + factor * factor * variance);
    p.put(j, d, factor * variance);
}
