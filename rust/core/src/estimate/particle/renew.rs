//! A new cloud in place of one of which few particles carry all weight.

use super::cloud::{BLOCK, Cloud, ParticleRow};
use super::filter::ParticleFilter;
use super::output::packed;
use super::regularise::Regularise;
use super::resample;
use super::settings::{Collapse, Marginalised};
use super::sums::{EqualWeights, Gather};
use crate::parallel;
use crate::random::{Purpose, Stream};
use crate::scalar::ln;
use crate::simd;

/// For how many particles the Kalman filter's belief counts, in multiples of the least number that has a covariance.
const PRIOR: f64 = 4.0;

impl ParticleFilter {
    /// Chooses particles when few carry all weight.
    pub(super) fn resample_if_due(&mut self) {
        let n = self.settings.particles as f64;
        if !self.started || self.summary.effective >= self.settings.threshold * n {
            return;
        }
        // Moments before are those of the weighted cloud, after those of the copies: the kernel takes the one back to
        // the other.
        let kernel = self.settings.kernel;
        if kernel.is_some() {
            self.take_moments(true);
            self.lean();
        }
        let stream = Stream::new(self.settings.seed, self.taken as u32, Purpose::Ancestors);
        let weights = self.summary.weights(&self.cloud);
        resample::choose(self.settings.resampling, &stream, weights, &mut self.ancestors);
        self.copy_ancestors();
        if let Some(kernel) = kernel {
            self.take_moments(false);
            self.regularise(Purpose::Regularise, kernel);
        }
    }

    /// Mean and covariance of the whole state.
    ///
    /// A weighted covariance about its own mean is too small by 1 − Σw² on average. That is little at a sample, but each
    /// choice hands it on to the next, until a cloud of many states has no spread left where readings say little.
    pub(super) fn take_moments(&mut self, before: bool) {
        if !before {
            self.summary.weigh(&self.cloud, self.cloud.blocks[0].sums.largest);
        }
        self.spread(self.belief.mean.len());
        let Self { cloud, summary, wanted, found, .. } = self;
        summary.gather_covariance(cloud);
        if before {
            let effective = summary.effective.max(2.0);
            summary.products.iter_mut().for_each(|product| *product *= effective / (effective - 1.0));
        }
        let moments = if before { wanted } else { found };
        moments.mean.copy_from_slice(&summary.mean);
        moments.factorise(&summary.products);
    }

    /// Leans the moments that are wanted on the Kalman filter's, as far as chance alone may have made the difference.
    ///
    /// Covariances of a few hundred particles are random, and each choice hands its own on to the next. So the belief of
    /// the Kalman filter counts as this many further particles, as the prior of a covariance does (inverse Wishart). The mean
    /// moves towards the belief's by James and Stein's rule (1961): all the way where it is no further off than chance
    /// takes it, hardly where it is much further.
    fn lean(&mut self) {
        let Self { guard, settings, .. } = &*self;
        if settings.collapse != Collapse::Reseed || !guard.comparable || guard.cloud_leads() || !guard.is_finite() {
            return;
        }
        let (d, effective) = (self.wanted.mean.len(), self.summary.effective);
        let prior = PRIOR * (d + 1) as f64;
        self.mix_belief(prior / (prior + effective));
        let Self { guard, wanted, found, .. } = self;
        let mean = &guard.kalman.belief().mean[..d];
        let apart = &mut found.mean;
        for (apart, (own, other)) in apart.iter_mut().zip(wanted.mean.iter().zip(mean)) {
            *apart = own - other;
        }
        let (square, rank) = wanted.measure(apart);
        let kept = if rank > 2 { (1.0 - (rank - 2) as f64 / (effective * square)).max(0.0) } else { 1.0 };
        for (own, other) in wanted.mean.iter_mut().zip(mean) {
            *own = other + kept * (*own - other);
        }
    }

    /// Makes the Kalman filter's belief a `share` of the covariance that is wanted, less what is known in closed form.
    fn mix_belief(&mut self, share: f64) {
        let Self { guard, summary, wanted, model, bias_variance, marginalised, cloud, .. } = self;
        let (d, n) = (wanted.mean.len(), model.jerk_model().joints());
        let covariance = &guard.kalman.belief().covariance;
        for r in 0..d {
            for c in r..d {
                let mut theirs = covariance.at(r, c);
                if *marginalised == Marginalised::Accelerations && r >= 2 * n {
                    theirs -= summary.average(cloud, d + packed(r - 2 * n, c - 2 * n, d - 2 * n));
                }
                let product = &mut summary.products[packed(r, c, d)];
                *product += share * (theirs - *product);
            }
        }
        for (bias, variance) in model.jerk_model().biases.iter().zip(bias_variance) {
            if let (Marginalised::Biases, Some(b)) = (*marginalised, *bias) {
                summary.products[packed(b, b, d)] -= share * variance.min(covariance.at(b, b));
            }
        }
        wanted.factorise(&summary.products);
    }

    /// New particles from their ancestors, all of one weight; blocks are gathered side by side.
    fn copy_ancestors(&mut self) {
        let Self { cloud: Cloud { blocks, next }, ancestors, threads, .. } = self;
        let (source, level) = (&*blocks, simd::level());
        let copy = |(next, ancestors): (&mut Vec<ParticleRow>, &[u32])| {
            simd::dispatch_lanes(level, Gather { source, ancestors, next })
        };
        let count = if *threads { next.len() } else { 1 };
        parallel::each_short(next.iter_mut().zip(ancestors.chunks(BLOCK)), count, copy);
        for (block, next) in blocks.iter_mut().zip(next) {
            core::mem::swap(&mut block.state, next);
        }
        self.equalise_weights();
    }

    /// Gives all particles the same weight.
    pub(super) fn equalise_weights(&mut self) {
        let Self { cloud, settings, sample, threads, .. } = self;
        let (log_weight, level) = (-ln(settings.particles as f64), simd::level());
        cloud.each(*threads, |block| simd::dispatch_lanes(level, EqualWeights { block, log_weight }));
        sample.offset = 0.0;
    }

    /// Moves the particles from the moments that were found to those that are wanted.
    pub(super) fn regularise(&mut self, purpose: Purpose, kernel: f64) {
        let Self { cloud, wanted, found, settings, threads, .. } = self;
        let stream = Stream::new(settings.seed, self.taken as u32, purpose);
        let (wanted, found, level) = (&*wanted, &*found, simd::level());
        cloud.each(*threads, |block| simd::dispatch(level, Regularise { block, wanted, found, kernel, stream }));
    }
}
