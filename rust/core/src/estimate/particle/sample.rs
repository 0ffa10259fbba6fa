//! A sample as all particles see it.

use super::cloud::Wide;
use super::density::NoiseDensity;
use super::past::Past;
use super::settings::Proposal;
use crate::estimate::jerk_noise;
use crate::estimate::kalman;
use crate::scalar::Scalar;

/// What all particles share at a sample.
#[derive(Clone, Debug)]
pub(super) struct ParticleSample {
    /// Of all random numbers, and the step that they are of.
    pub(super) seed: u64,
    pub(super) step: u32,
    /// Time since the sample before [s]; zero at the first.
    pub(super) dt: f64,
    /// Commanded jerk (n), zero at the first sample.
    pub(super) jerk: Vec<f64>,
    /// Motor velocities for the damping torque (n), NaN to leave it out.
    pub(super) dtheta: Vec<f64>,
    /// How each joint's (q, q̇, q̈) follow from its three standard normal numbers, see [`jerk_noise::factor`].
    pub(super) factors: Vec<[[f64; 3]; 3]>,
    /// Those that were read; late ones come last, where there is a sample before.
    pub(super) readings: Vec<ParticleReading>,
    pub(super) past: Past,
    /// Biases that are drawn whatever is read.
    pub(super) walks: Vec<Walk>,
    /// What is left of each bias after the step, by entry of the state.
    pub(super) decays: Vec<(usize, f64)>,
    /// Normal numbers that a particle needs: of the links' noise first, then of biases.
    pub(super) draws: usize,
    /// Logarithm of the total weight before.
    pub(super) offset: f64,
    /// Where particles are drawn from.
    pub(super) proposal: Proposal,
    /// Least and largest position of each joint [rad].
    pub(super) limits: Vec<(f64, f64)>,
}

/// One channel's reading, and what its bias, if it has one, does with the innovation.
#[derive(Clone, Copy, Debug)]
pub(super) struct ParticleReading {
    /// Which, and what it read.
    pub(super) channel: usize,
    pub(super) value: f64,
    /// The entry of the state that is its bias.
    pub(super) bias: Option<usize>,
    /// Of the reading for a given path of the links: its own noise, and a marginalised or undrawn bias.
    pub(super) noise: NoiseDensity,
    /// By which part of the innovation the bias moves, and the standard deviation of what is then drawn around it.
    pub(super) gain: f64,
    pub(super) rest: f64,
    /// Which normal number that is.
    pub(super) draw: usize,
}

/// An entry of the state that is drawn before readings are looked at.
#[derive(Clone, Copy, Debug)]
pub(super) struct Walk {
    /// Which, and its standard deviation.
    pub(super) entry: usize,
    pub(super) std: f64,
    /// Which normal number it is drawn by.
    pub(super) draw: usize,
}

impl ParticleSample {
    /// The links' noise over `dt`, or none at a first sample.
    pub(super) fn set_noise(&mut self, noise: &kalman::JerkNoise) {
        let n = self.factors.len();
        for (j, factor) in self.factors.iter_mut().enumerate() {
            *factor = jerk_noise::factor(noise.jerk[j], [noise.link_walk[j], noise.link_walk[n + j]], self.dt);
        }
    }

    /// ∂h/∂(q, q̇, q̈) to ∂h/∂w of the standard normal numbers w: all first ones, all second ones, all third ones.
    #[inline(always)]
    pub(super) fn by_noise<T: Scalar>(&self, links: &[T], out: &mut [T]) {
        let n = self.factors.len();
        for (j, [q, dq, ddq]) in self.factors.iter().enumerate() {
            let [by_q, by_dq, by_ddq] = [links[j], links[n + j], links[2 * n + j]];
            out[j] = by_q * q[0] + by_dq * dq[0] + by_ddq * ddq[0];
            out[n + j] = by_q * q[1] + by_dq * dq[1];
            out[2 * n + j] = by_q * q[2];
        }
    }
}

impl ParticleReading {
    /// y − h(x) − b.
    #[inline(always)]
    pub(super) fn error(&self, state: &[Wide], prediction: &[Wide]) -> Wide {
        let error = -prediction[self.channel] + self.value;
        self.bias.map_or(error, |b| error - state[b])
    }
}
