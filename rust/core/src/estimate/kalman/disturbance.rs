//! A torque on each link that the model lacks: a contact, a push, a payload, a counterbalance.
//!
//! What a transmission gives its link is the load less this torque, τ_e = M q̈ + C q̇ + g − d. A joint torque sensor reads
//! τ_e and with it d; a motor stands where τ_e twists the spring to, so that θ − φ⁻¹(τ_e) is the link whatever d is. Each
//! d is a process of Gauss and Markov, ḋ = −d/T + white noise.

use super::drift::Biases;
use super::gaussian::{Gaussian, Symmetric};
use crate::check::{check_deviations, expect};
use crate::dynamics::Kinematics;
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

/// How varying wrenches on links wander, six numbers each; random walks.
#[derive(Clone, Debug, Default)]
pub struct WrenchLaw {
    /// What each number may be at the first sample [N, N m].
    pub initial: Vec<f64>,
    /// By how much each wanders in one second [N/√s, N m/√s].
    pub walk: Vec<f64>,
}

impl WrenchLaw {
    /// # Errors
    /// Not one each of the robot's, a standard deviation that is negative or not finite.
    pub(super) fn check(&self, robot: &Robot) -> Result<(), DesignError> {
        let numbers = robot.wrench_states();
        check_deviations("wrench", &self.initial, numbers)?;
        check_deviations("wrench_walk", &self.walk, numbers)
    }
}

/// What acts on links from outside, as states of the acceleration-driven model: disturbance torques of the links, one each or
/// none, then the numbers of varying wrenches.
#[derive(Clone, Debug, Default)]
pub(super) struct Disturbances {
    states: Vec<Option<usize>>,
    torques: usize,
    initial: Vec<f64>,
    pub(super) walk: Vec<f64>,
    time: Vec<f64>,
}

impl Disturbances {
    /// Those that wander as the laws say, the first of them being state `first`.
    pub(super) fn new(torques: Option<LinkDisturbance>, wrenches: WrenchLaw, first: usize) -> Self {
        let none = LinkDisturbance { initial: Vec::new(), walk: Vec::new(), time: f64::INFINITY };
        let LinkDisturbance { mut initial, mut walk, time } = torques.unwrap_or(none);
        let torques = initial.len();
        initial.extend(wrenches.initial);
        walk.extend(wrenches.walk);
        let mut times = vec![time; torques];
        times.resize(initial.len(), f64::INFINITY);
        Self { states: (first..first + initial.len()).map(Some).collect(), torques, initial, walk, time: times }
    }

    /// How many.
    #[inline(always)]
    pub(super) fn len(&self) -> usize {
        self.states.len()
    }

    /// How many are torques, and how many numbers of wrenches.
    pub(super) fn parts(&self) -> [usize; 2] {
        [self.torques, self.len() - self.torques]
    }

    /// The first torque.
    pub(super) fn first(&self) -> Option<usize> {
        self.states.first().copied().flatten().filter(|_| self.torques > 0)
    }

    /// The first number of a wrench.
    pub(super) fn wrench(&self) -> Option<usize> {
        self.states.get(self.torques).copied().flatten()
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

/// The same of varying wrenches from state `first` on: several links depend on each of their numbers.
pub(super) fn hold_wrenches(robot: &Robot, theta: &[f64], first: usize, belief: &mut Gaussian) {
    let Gaussian { mean, covariance } = belief;
    let (n, numbers) = (robot.len(), robot.wrench_states());
    let (mut kinematics, mut by) = (Kinematics::new(&robot.tree), vec![0.0; n * numbers]);
    kinematics.set_position(&robot.tree, &mean[..n]);
    kinematics.wrench_map(&robot.tree, |number, joint, share| by[number * n + joint] += share);
    for (number, by) in by.chunks_exact_mut(n).enumerate() {
        for ((by, drive), (theta, q)) in by.iter_mut().zip(&robot.drives).zip(theta.iter().zip(&*mean)) {
            *by *= if drive.elastic { drive.compliance(drive.torsion_between(*theta, *q)) } else { 0.0 };
        }
        let variance = covariance.at(first + number, first + number);
        for i in 0..n {
            for j in i..n {
                covariance.put(i, j, covariance.at(i, j) + by[i] * by[j] * variance);
            }
            covariance.put(i, first + number, by[i] * variance);
        }
    }
}

/// Adds `factor` times state `d`, which nothing depended on, to state `j`.
pub(super) fn depend(p: &mut Symmetric, j: usize, d: usize, factor: f64) {
    let variance = p.at(d, d);
    p.put(j, j, p.at(j, j) + factor * factor * variance);
    p.put(j, d, factor * variance);
}
