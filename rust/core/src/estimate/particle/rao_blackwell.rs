//! One step of particles of positions and velocities, each with a normal density of accelerations and biases.

use super::cloud::{Block, Cloud, ParticleRow, Scratch, WIDE, Wide};
use super::conditional::{Conditional, ReadingSlope};
use super::process_noise::ProcessNoise;
use super::proposal::{draw, load, store};
use super::sample::{ParticleReading, ParticleSample};
use super::settings::Proposal;
use super::sums::Weigh;
use crate::estimate::kalman::{Gaussian, JerkModel};
use crate::estimate::measurement::Evaluation;
use crate::linear;
use crate::random::{Purpose, Stream};
use crate::scalar::{Lanes, Scalar, ln};
use crate::simd::Kernel;
use core::f64::consts::TAU;

/// Room for the densities of [`WIDE`] particles.
///
/// Of both, the density of accelerations and biases is the Kalman filter's of linear measurements, given the path of
/// positions and velocities that the particle has taken: what is drawn is two numbers a joint, not three, and what is
/// not drawn cannot be missed by chance.
#[derive(Clone, Debug)]
pub(super) struct Densities {
    /// For the particle's path.
    path: Conditional<Wide>,
    /// The same with readings taken where they are linearised to find out where to draw.
    trial: Conditional<Wide>,
    /// h and its Jacobian at the mean.
    evaluation: Evaluation<Wide>,
    /// The mean at which the density is.
    mean: Vec<Wide>,
    /// How a reading changes with the numbers by which positions and velocities are drawn (2n).
    by_noise: Vec<Wide>,
}

impl Densities {
    pub(super) fn new(model: &JerkModel) -> Self {
        let (n, d) = (model.joints(), model.states());
        let path = Conditional::new(n, d - 2 * n);
        Self {
            trial: path.clone(),
            path,
            evaluation: Evaluation::new(&model.robot, model.channels()),
            mean: vec![Wide::default(); d],
            by_noise: vec![Wide::default(); 2 * n],
        }
    }
}

/// How many numbers a covariance of accelerations and biases is kept in.
pub(super) fn covariance_entries(model: &JerkModel) -> usize {
    let size = model.states() - 2 * model.joints();
    size * (size + 1) / 2
}

/// Gives all particles the covariance of `belief`, of a robot of `n` joints.
pub(super) fn start(cloud: &mut Cloud, belief: &Gaussian, n: usize) {
    let d = belief.mean.len();
    for block in &mut cloud.blocks {
        let mut rows = block.state[d..].iter_mut();
        for r in 2 * n..d {
            for (c, row) in (r..d).zip(&mut rows) {
                row.each_mut().fill(belief.covariance.at(r, c));
            }
        }
    }
}

/// Gives all particles the covariance of what follows `first` entries given these, of a belief of `d` entries with a lower
/// `factor`, of which only that is left which the first entries explain.
pub(super) fn condition(cloud: &mut Cloud, factor: &mut [f64], d: usize, first: usize) {
    let mut rows = d..;
    for r in first..d {
        for c in r..d {
            let own = (first..=r).map(|k| factor[r * d + k] * factor[c * d + k]).sum();
            let row = rows.next().unwrap_or_default();
            cloud.blocks.iter_mut().for_each(|block| block.state[row].each_mut().fill(own));
        }
    }
    for row in factor.chunks_exact_mut(d) {
        row[first..].fill(0.0);
    }
}

/// Moves a block by one sample.
///
/// Predict the density, draw positions and velocities (by the linearised readings if wanted), let the path teach it,
/// then weigh by the readings and let them teach it as well. About the cost of a Kalman filter's step a particle.
pub(super) struct PropagateMarginalised<'a> {
    /// Channels and biases.
    pub(super) model: &'a JerkModel,
    pub(super) sample: &'a ParticleSample,
    /// The process noise of this sample, the same for all particles.
    pub(super) motion: &'a ProcessNoise,
    pub(super) block: &'a mut Block,
}

impl Kernel for PropagateMarginalised<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { model, sample, motion, block } = self;
        let Some(mut densities) = block.densities.take() else { return };
        let covariances = model.states();
        for group in 0..block.groups() {
            let items = block.items(group);
            load(block, group);
            densities.load(&block.state[covariances..], group);
            let change = densities.step(&mut block.scratch, model, sample, motion, items);
            if !change.0.iter().all(|x| x.is_finite()) {
                densities.bring_back(&block.scratch.after, &block.state[covariances..], group, motion);
                block.scratch.bring_back();
            }
            store(block, group, change, sample.offset);
            densities.store(&mut block.state[covariances..], group);
        }
        block.densities = Some(densities);
        block.log_weights.each_mut()[block.count..].fill(f64::NEG_INFINITY);
        Weigh { block }.run();
    }
}

impl Densities {
    /// The covariances of a group's particles, out of the block's rows.
    #[inline(always)]
    fn load(&mut self, rows: &[ParticleRow], group: usize) {
        for (entry, row) in self.path.covariance.iter_mut().zip(rows) {
            *entry = Lanes(row.0[group]);
        }
    }

    /// And back into them.
    #[inline(always)]
    fn store(&self, rows: &mut [ParticleRow], group: usize) {
        for (entry, row) in self.path.covariance.iter().zip(rows) {
            row.0[group] = entry.0;
        }
    }

    /// Particles that went out of the numbers have learnt nothing from the readings.
    fn bring_back(&mut self, after: &[Wide], rows: &[ParticleRow], group: usize, motion: &ProcessNoise) {
        self.trial.copy_from(&self.path);
        self.load(rows, group);
        self.path.follow(motion);
        for l in 0..WIDE {
            if after.iter().chain(&self.trial.covariance).all(|x| x.0[l].is_finite()) {
                for (entry, found) in self.path.covariance.iter_mut().zip(&self.trial.covariance) {
                    entry.0[l] = found.0[l];
                }
            }
        }
    }

    /// From `before` to `after`, densities with them; returns by how much the logarithms of the weights change.
    #[inline(always)]
    fn step(
        &mut self,
        scratch: &mut Scratch,
        model: &JerkModel,
        sample: &ParticleSample,
        motion: &ProcessNoise,
        items: [u32; WIDE],
    ) -> Wide {
        let stream = Stream::new(sample.seed, sample.step, Purpose::Process);
        draw(&stream, items, &mut scratch.normal[..sample.draws]);
        scratch.coast(model.joints(), sample);
        self.path.follow(motion);
        let (passes, tail) = match sample.proposal {
            Proposal::Bootstrap => (0, None),
            Proposal::Linearised { iterations, tail } => (iterations, tail),
        };
        if passes == 0 {
            scratch.noise.copy_from_slice(&scratch.normal[..sample.draws]);
        } else {
            scratch.noise.fill(Wide::default());
        }
        let mut change = Wide::default();
        // One text of the sensors for all passes: it is long, and compiled for each level.
        for pass in 0..=passes {
            // Where ζ puts positions and velocities, with the mean of accelerations and biases that goes with them.
            self.path.displace(motion, &scratch.before, &scratch.noise, &mut scratch.after);
            self.evaluation.evaluate(&model.robot, &model.channels, &scratch.after, &sample.dtheta);
            sample.past.mix(model, &mut self.evaluation, &scratch.after, true);
            // The last pass weighs, at what was drawn; those before find out where to draw.
            if pass == passes {
                change += self.weigh_and_learn(&mut scratch.after, model, sample);
            } else {
                self.gather_information(scratch, model, sample, motion);
                if pass + 1 == passes {
                    linear::root(&mut scratch.factor, scratch.mode.len());
                    change += scratch.draw_proposal(None, sample, items, tail);
                } else {
                    scratch.noise.copy_from_slice(&scratch.mode);
                }
            }
        }
        change + scratch.within_limits(sample)
    }

    /// Λ = 1 + BᵀS⁻¹B, factorised, and ζ̂ = Λ⁻¹BᵀS⁻¹ε, with S the covariance of the readings given n, linearised at `after`.
    #[inline(always)]
    fn gather_information(
        &mut self,
        scratch: &mut Scratch,
        model: &JerkModel,
        sample: &ParticleSample,
        motion: &ProcessNoise,
    ) {
        let Scratch { before, after, mode, factor, .. } = scratch;
        let count = mode.len();
        self.trial.copy_from(&self.path);
        self.mean.copy_from_slice(before);
        factor.fill(Wide::default());
        mode.fill(Wide::default());
        factor.iter_mut().step_by(count + 1).for_each(|x| *x = Wide::constant(1.0));
        for (i, reading) in sample.readings.iter().enumerate() {
            let row = slope(&self.evaluation, model, sample, i);
            let error = self.error(reading, row, after);
            self.trial.by_noise(motion, row, &mut self.by_noise);
            let precision = Wide::constant(1.0) / self.trial.observe(row, reading.noise.variance);
            // The next reading is seen given this one: its slope by ζ changes with what this one taught.
            self.trial.tilt(&self.by_noise);
            learn(&mut self.mean[2 * model.joints()..], &self.trial.gain, error);
            for (j, b) in self.by_noise.iter().enumerate() {
                let weighted = *b * precision;
                mode[j] += weighted * error;
                for (entry, other) in factor[j * count..=j * count + j].iter_mut().zip(&self.by_noise) {
                    *entry += weighted * *other;
                }
            }
        }
        linear::factorise(factor, count);
        linear::solve(factor, count, mode, 1);
    }

    /// log p(y | path), and what accelerations and biases learn from y.
    #[inline(always)]
    fn weigh_and_learn(&mut self, after: &mut [Wide], model: &JerkModel, sample: &ParticleSample) -> Wide {
        self.mean.copy_from_slice(after);
        let mut change = Wide::default();
        for (i, reading) in sample.readings.iter().enumerate() {
            let row = slope(&self.evaluation, model, sample, i);
            let error = self.error(reading, row, after);
            let variance = self.path.observe(row, reading.noise.variance);
            learn(&mut self.mean[2 * model.joints()..], &self.path.gain, error);
            // p(y | path), accelerations and biases integrated out: a Kalman filter's innovation density.
            change -= (error * error / variance + (variance * TAU).map(ln)) * 0.5;
        }
        after.copy_from_slice(&self.mean);
        change
    }

    /// y − h at the density's mean, h linearised at `at`; its bias enters as it is.
    #[inline(always)]
    fn error(&self, reading: &ParticleReading, row: ReadingSlope<'_, Wide>, at: &[Wide]) -> Wide {
        let mut error = reading.error(&self.mean, &self.evaluation.prediction);
        for ((h, at), mean) in row.links.iter().zip(at).zip(&self.mean) {
            error += *h * (*at - *mean);
        }
        let links = row.links.len();
        for ((h, at), mean) in row.biases.iter().zip(&at[links..]).zip(&self.mean[links..]) {
            error += (*at - *mean) * *h;
        }
        error
    }
}

#[inline(always)]
fn slope<'a>(
    evaluation: &'a Evaluation<Wide>,
    model: &JerkModel,
    sample: &'a ParticleSample,
    i: usize,
) -> ReadingSlope<'a, Wide> {
    let (n, reading) = (model.joints(), &sample.readings[i]);
    let links = &evaluation.jacobian[reading.channel * 3 * n..][..3 * n];
    let prompt = sample.readings.len() - sample.past.found.len();
    let biases = if i < prompt { &[][..] } else { &sample.past.row(i - prompt)[3 * n..] };
    ReadingSlope { links, bias: reading.bias.map(|b| b - 2 * n), biases }
}

/// m ← m + K ε.
#[inline(always)]
fn learn(mean: &mut [Wide], gain: &[Wide], error: Wide) {
    for (mean, gain) in mean.iter_mut().zip(gain) {
        *mean += *gain * error;
    }
}
