//! A new cloud in place of one of which few particles carry all weight.

use super::cloud::{BLOCK, Cloud, ParticleRow};
use super::filter::ParticleFilter;
use super::regularise::Regularise;
use super::resample;
use super::sums::{EqualWeights, Gather};
use crate::parallel;
use crate::random::{Purpose, Stream};
use crate::scalar::ln;
use crate::simd;

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
        let d = self.belief.mean.len();
        let mut scale = 1.0;
        if before {
            let effective = self.summary.effective.max(2.0);
            scale = effective / (effective - 1.0);
        } else {
            self.summary.weigh(&self.cloud, self.cloud.blocks[0].sums.largest);
        }
        self.spread(d);
        let Self { cloud, summary, wanted, found, .. } = self;
        summary.gather_covariance(cloud);
        let moments = if before { wanted } else { found };
        moments.mean.copy_from_slice(&summary.mean);
        moments.factorise(&summary.products, scale);
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
