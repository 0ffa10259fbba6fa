//! Motor torques that move the elastic-joint model: sampled or held, and bridged where they are missing.

use super::elastic::ElasticNoise;
use super::gaussian::Gaussian;
use super::transition::{Torques, Transition};

/// The latest torques, and how they may have wandered since.
#[derive(Clone, Debug)]
pub(super) struct MotorTorques {
    /// One reading's noise (n) [N m], how far torques wander that nobody reads, and how far disturbances do (n) [N m/√s].
    noise: Vec<f64>,
    torque_walk: Vec<f64>,
    disturbance_walk: Vec<f64>,
    /// The latest torques that were read.
    tau: Vec<f64>,
    /// How long ago that was (n) [s].
    age: Vec<f64>,
    /// Torques at the beginning and at the end of a step.
    before: Vec<f64>,
    after: Vec<f64>,
    /// Mean and variance of each disturbance before its torque's readings were missing.
    outage: Vec<(f64, f64)>,
    /// Whether a sample's torque has acted since the sample before.
    held: bool,
}

impl MotorTorques {
    pub(super) fn new(noise: &ElasticNoise, held: bool) -> Self {
        let n = noise.torque.len();
        let none = || vec![0.0; n];
        Self {
            noise: noise.torque.clone(),
            torque_walk: noise.torque_walk.clone(),
            disturbance_walk: noise.disturbance_walk.clone(),
            tau: none(),
            age: none(),
            before: none(),
            after: none(),
            outage: vec![(0.0, 0.0); n],
            held,
        }
    }

    /// Takes over those of a first sample.
    pub(super) fn start(&mut self, read: &[f64]) -> &[f64] {
        self.tau.copy_from_slice(read);
        self.age.fill(0.0);
        &self.tau
    }

    /// Whether one was missing at the sample last moved to.
    pub(super) fn bridged(&self) -> bool {
        self.age.iter().any(|&age| age > 0.0)
    }

    /// Readies the step of `dt` [s] to torques `read`, NaN where missing.
    #[inline(always)]
    pub(super) fn take(&mut self, transition: &mut Transition, belief: &Gaussian, read: &[f64], dt: f64) {
        self.expect(transition, belief, read, dt);
        self.move_on(transition, read);
        self.doubt_between_samples(transition);
    }

    /// Those of the step.
    #[inline(always)]
    pub(super) fn over_step(&self) -> Torques<'_> {
        // A held torque is in the log at the end of the step in which it acted.
        (if self.held { &self.after } else { &self.before }, &self.after)
    }

    /// After the step: disturbances are what they were before an outage that has ended.
    #[inline(always)]
    pub(super) fn restore(&self, transition: &Transition, belief: &mut Gaussian) {
        let first = transition.layout.disturbance.unwrap_or(0);
        for &(state, _) in &transition.replaced {
            belief.mean[state] = self.outage[state - first].0;
        }
    }

    /// A torque that nobody reads is held, and the true one wanders from it: with the motor's disturbance, until the reading
    /// is back and the disturbance is again what it was before. Without disturbances the wandering is noise of the torque
    /// that is constant over each step, of a variance that gives velocity the right one.
    #[inline(always)]
    fn expect(&mut self, transition: &mut Transition, belief: &Gaussian, read: &[f64], dt: f64) {
        let Self { noise, torque_walk, disturbance_walk, age, outage, .. } = self;
        transition.replaced.clear();
        for (j, age) in age.iter_mut().enumerate() {
            let gone = read[j].is_nan();
            let wander = if gone || *age > 0.0 { torque_walk[j] } else { 0.0 };
            transition.torque[j] = noise[j] * noise[j];
            if let Some(first) = transition.layout.disturbance {
                let (state, walk) = (first + j, disturbance_walk[j]);
                // The disturbance carries the outage: it is a state, so that what it grew to is estimated while the
                // torque is gone.
                transition.exponential.noise.set_density(state, (walk * walk + wander * wander).sqrt());
                if gone && *age == 0.0 {
                    outage[j] = (belief.mean[state], belief.covariance.at(state, state));
                } else if !gone && *age > 0.0 && torque_walk[j] > 0.0 {
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
    fn move_on(&mut self, transition: &Transition, read: &[f64]) {
        for (j, read) in read.iter().enumerate() {
            let back = transition.layout.disturbance.is_some_and(|first| is_replaced(transition, first + j));
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
    fn doubt_between_samples(&self, transition: &mut Transition) {
        if !self.held {
            for (variance, (before, after)) in transition.torque.iter_mut().zip(self.before.iter().zip(&self.after)) {
                *variance += (after - before) * (after - before) / 12.0;
            }
        }
    }
}

/// Whether a disturbance is again what it was before its torque's outage.
#[inline(always)]
fn is_replaced(transition: &Transition, state: usize) -> bool {
    transition.replaced.iter().any(|(replaced, _)| *replaced == state)
}
