//! What a particle filter gives back.

use super::cloud::{BLOCK, Cloud};
use super::filter::ParticleFilter;
use super::sums::dot;
use crate::error::DesignError;
use crate::estimate::kalman::{FilterOutput, Gaussian, JerkDriven, JerkModel, Keep, Linearise, Model, Phases};
use crate::memory::filled;
use crate::scalar::ln;

/// The cloud after a sample, in a few numbers.
#[derive(Clone, Debug)]
pub struct Summary {
    /// Weighted mean of the state: q, q̇, q̈, then biases.
    pub mean: Vec<f64>,
    /// Effective number of particles, 1/Σw².
    pub effective: f64,
    /// The particle of largest weight.
    pub best: usize,
    /// Logarithm of the readings' probability density.
    pub log_likelihood: f64,
    /// See [`Status`](crate::estimate::Status).
    pub status: u8,
    /// Readings used.
    pub used: u32,
    /// Whether the cloud was then drawn again.
    pub reseeded: bool,
    /// Upper triangle of the covariance, by rows: of the positions, or after a choice of particles of the whole state.
    pub(super) products: Vec<f64>,
    /// Where motors were linearised.
    pub(super) reference: Vec<f64>,
    /// Weight of each block's largest particle.
    shares: Vec<f64>,
    /// Scratch of quantiles: particles by position.
    order: Vec<u32>,
}

impl Summary {
    /// Room for a cloud of this many particles.
    pub(super) fn new(model: &JerkModel, particles: usize) -> Self {
        let d = model.states();
        Self {
            mean: vec![0.0; d],
            effective: 0.0,
            best: 0,
            log_likelihood: 0.0,
            status: 0,
            used: 0,
            reseeded: false,
            products: vec![0.0; d * (d + 1) / 2],
            reference: vec![0.0; 3 * model.joints()],
            shares: vec![0.0; particles.div_ceil(BLOCK)],
            order: Vec::with_capacity(particles),
        }
    }

    /// Mean, effective number and likelihood from the blocks' sums; returns the logarithm of the total weight.
    pub(super) fn weigh(&mut self, cloud: &Cloud, largest: f64) -> f64 {
        // Blocks have weights relative to their own largest: brought to one scale here, and summed in the order of the
        // blocks, so that the number of threads does not enter.
        let factor = |log: f64| if log.is_finite() { crate::scalar::Scalar::exp(log - largest) } else { 0.0 };
        let (mut total, mut square, mut most) = (0.0, 0.0, 0.0);
        self.mean.fill(0.0);
        for (share, block) in self.shares.iter_mut().zip(&cloud.blocks) {
            *share = factor(block.sums.largest);
            total += *share * block.sums.weight;
            square += *share * *share * block.sums.square;
            if *share > most {
                (most, self.best) = (*share, block.first + block.sums.best);
            }
            for (mean, sum) in self.mean.iter_mut().zip(&block.sums.state) {
                *mean += *share * sum;
            }
        }
        for value in self.mean.iter_mut().chain(&mut self.shares) {
            *value /= total;
        }
        // 1/Σ w̄² (Kong, Liu and Wong 1994).
        self.effective = total * total / square;
        self.log_likelihood = largest + ln(total);
        self.log_likelihood
    }

    /// Covariance from the blocks' products.
    pub(super) fn gather_covariance(&mut self, cloud: &Cloud) {
        self.products.fill(0.0);
        for (share, block) in self.shares.iter().zip(&cloud.blocks) {
            for (sum, product) in self.products.iter_mut().zip(&block.sums.products) {
                *sum += share * product;
            }
        }
    }

    /// Weighted mean of what row `d` of the blocks holds.
    pub(super) fn average(&self, cloud: &Cloud, d: usize) -> f64 {
        let one = |(share, block): (&f64, &super::cloud::Block)| share * dot(&block.weights.0, &block.state[d].0);
        self.shares.iter().zip(&cloud.blocks).map(one).sum()
    }

    /// Normalised weights of all particles, in order.
    pub(super) fn weights<'a>(&'a self, cloud: &'a Cloud) -> impl Iterator<Item = f64> + Clone + 'a {
        let one = |(share, block): (&'a f64, &'a super::cloud::Block)| {
            block.weights.each()[..block.count].iter().map(move |w| w * share)
        };
        self.shares.iter().zip(&cloud.blocks).flat_map(one)
    }

    /// Smallest position of joint `j` up to which particles have at least each share of the weight.
    fn quantiles(&mut self, cloud: &Cloud, j: usize, shares: &[f64], mut out: impl FnMut(usize, f64)) {
        let mut order = core::mem::take(&mut self.order);
        order.clear();
        order.extend(0..cloud.blocks.iter().map(|b| b.count as u32).sum::<u32>());
        let position = |&i: &u32| cloud.at(i as usize, j);
        order.sort_unstable_by(|a, b| position(a).total_cmp(&position(b)));
        for (k, &share) in shares.iter().enumerate() {
            let mut sum = 0.0;
            let reached = |&&i: &&u32| {
                let i = i as usize;
                sum += self.shares[i / BLOCK] * cloud.blocks[i / BLOCK].weights.each()[i % BLOCK];
                sum >= share
            };
            out(k, order.iter().find(reached).or(order.last()).map_or(f64::NAN, position));
        }
        self.order = order;
    }
}

/// Estimates of a recording, row-major, one row a sample.
#[derive(Clone, Debug, Default)]
pub struct ParticleOutput {
    /// Weighted means and their standard deviations, as a Kalman filter's; it has no innovations.
    pub links: FilterOutput,
    /// Effective number of particles.
    pub effective: Vec<f64>,
    /// Whether the cloud was drawn again after the sample.
    pub reseeded: Vec<bool>,
    /// Link positions of the particle of largest weight (n).
    pub best: Vec<f64>,
    /// Quantiles of each link position (quantiles × n).
    pub quantiles: Vec<f64>,
}

impl ParticleOutput {
    /// Room for `count` samples.
    pub(super) fn zeros(count: usize, filter: &ParticleFilter, keep: Keep) -> Result<Self, DesignError> {
        let n = filter.model.robot().len();
        Ok(Self {
            links: FilterOutput::zeros(count, &filter.model, Keep { innovations: false, ..keep })?,
            effective: filled(0.0, count, 1)?,
            reseeded: filled(false, count, 1)?,
            best: filled(0.0, count, n)?,
            quantiles: filled(0.0, count, n * filter.settings.quantiles.len())?,
        })
    }

    /// Writes what was found at the last sample into row `i`.
    pub(super) fn report(&mut self, i: usize, filter: &mut ParticleFilter, keep: Keep) {
        let n = filter.model.robot().len();
        self.links.write_cloud(i, filter);
        if keep.covariance {
            filter.report_state(i, &mut self.links);
        }
        let ParticleFilter { cloud, summary, settings, .. } = filter;
        self.effective[i] = summary.effective;
        self.reseeded[i] = summary.reseeded;
        for j in 0..n {
            self.best[i * n + j] = cloud.at(summary.best, j);
            let levels = settings.quantiles.len();
            if levels > 0 {
                let row = &mut self.quantiles[i * levels * n..][..levels * n];
                summary.quantiles(cloud, j, &settings.quantiles, |k, q| row[k * n + j] = q);
            }
        }
    }

    /// Writes `belief` into row `i`, its motors by what the model remembered of that sample.
    pub(super) fn report_belief(
        &mut self,
        i: usize,
        filter: &mut ParticleFilter,
        motors: &[f64],
        belief: &Gaussian,
        keep: Keep,
    ) {
        let ParticleFilter { model, tool, .. } = filter;
        let Gaussian { mean, covariance } = belief;
        model.report(motors, mean, i, &mut self.links);
        self.links.write_links(i, model.robot(), mean, |r, c| covariance.at(r, c), tool);
        if keep.covariance {
            self.links.write_state(i, mean, &covariance.data, covariance.stride);
        }
    }
}

impl FilterOutput {
    /// Writes links, motors and fit of the cloud after the last sample into row `i`.
    pub(super) fn write_cloud(&mut self, i: usize, filter: &mut ParticleFilter) {
        let n = filter.model.robot().len();
        let ParticleFilter { model, summary, tool, memory, guard, .. } = filter;
        JerkDriven::linearise_phase(Linearise { model, reference: &summary.mean[..3 * n] });
        memory.clear();
        model.remember(memory);
        model.report(memory, &summary.mean, i, self);
        // A cloud knows nothing of tolerances; what they do to its error is what they do to the Kalman filter's.
        let more = guard.kalman.considered(n);
        let tolerated = |r: usize, c: usize| more.map_or(0.0, |more| more[r * n + c]);
        let variance = |r: usize, c: usize| summary.products[packed(r.min(c), r.max(c), n)] + tolerated(r, c);
        self.write_links(i, model.robot(), &summary.mean, variance, tool);
        self.status[i] = summary.status;
        self.used[i] = summary.used;
        self.log_likelihood[i] = summary.log_likelihood;
    }
}

/// Where entry (r, c), r ≤ c, of a symmetric n × n matrix is in its upper triangle by rows.
pub(super) fn packed(r: usize, c: usize, n: usize) -> usize {
    r * n - r * (r + 1) / 2 + c
}
