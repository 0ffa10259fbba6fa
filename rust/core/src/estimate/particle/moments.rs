//! Mean, covariance and likelihood of a cloud.

use super::filter::ParticleFilter;
use super::output::packed;
use super::settings::Marginalised;
use super::sums::Deviations;
use crate::estimate::kalman::FilterOutput;
use crate::linear;
use crate::simd;

impl ParticleFilter {
    /// Mean, spread, likelihood and effective number; false when no particle has a weight.
    pub(super) fn summarise(&mut self) -> bool {
        let Self { cloud, summary, sample, belief, .. } = self;
        // Weights are logarithms: relative to the largest, none overflows, and those that vanish may.
        let largest = cloud.blocks.iter().fold(f64::NEG_INFINITY, |l, b| l.max(b.sums.largest));
        if !largest.is_finite() {
            return false;
        }
        sample.offset = summary.weigh(cloud, largest);
        belief.mean.copy_from_slice(&summary.mean);
        self.spread(self.model.jerk_model().joints());
        let Self { cloud, summary, .. } = self;
        summary.gather_covariance(cloud);
        true
    }

    /// Weighted products of deviations from the mean, of the first `entries` of the state, in every block.
    pub(super) fn spread(&mut self, entries: usize) {
        let Self { cloud, summary, threads, .. } = self;
        let (mean, level) = (&summary.mean, simd::level());
        cloud.each(*threads, |block| simd::dispatch(level, Deviations { block, mean, entries }));
    }

    /// Covariance of the state after the last sample (states × states), with what tolerances add to it.
    pub fn covariance(&mut self) -> Vec<f64> {
        self.take_covariance();
        let mut covariance: Vec<f64> = self.belief.covariance.dense().collect();
        if let Some(more) = self.guard.kalman.considered(self.belief.mean.len()) {
            linear::add_scaled(&mut covariance, 1.0, more);
        }
        covariance
    }

    /// The whole state and its covariance into row `i`.
    pub(super) fn report_state(&mut self, i: usize, out: &mut FilterOutput) {
        self.take_covariance();
        let Self { summary, belief, guard, .. } = self;
        out.write_state(i, &summary.mean, &belief.covariance.data, belief.covariance.stride);
        if let Some(more) = guard.kalman.considered(summary.mean.len()) {
            out.add_covariance(i, more);
        }
    }

    /// Covariance of the whole state into the belief: the cloud's own, and what each particle leaves open.
    pub(super) fn take_covariance(&mut self) {
        let d = self.belief.mean.len();
        self.spread(d);
        let Self { cloud, summary, belief, model, bias_variance, .. } = self;
        summary.gather_covariance(cloud);
        let mut products = summary.products.iter();
        for r in 0..d {
            for (c, &product) in (r..d).zip(&mut products) {
                belief.covariance.put(r, c, product);
            }
        }
        // Law of total variance: what particles differ by, and the mean of what each does not know (biases, then
        // accelerations, where these are marginalised).
        for (bias, variance) in model.jerk_model().biases.iter().zip(bias_variance) {
            if let (Marginalised::Biases, Some(b)) = (self.marginalised, *bias) {
                belief.covariance.put(b, b, belief.covariance.at(b, b) + *variance);
            }
        }
        if self.motion.is_some() {
            let first = 2 * model.jerk_model().joints();
            for r in first..d {
                for c in r..d {
                    let own = summary.average(cloud, d + packed(r - first, c - first, d - first));
                    belief.covariance.put(r, c, belief.covariance.at(r, c) + own);
                }
            }
        }
    }
}
