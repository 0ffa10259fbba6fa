//! The first cloud.

use super::cloud::{Cloud, Wide};
use super::proposal::draw;
use super::sample::ParticleSample;
use crate::estimate::kalman::{Gaussian, Linearised};
use crate::linear;
use crate::random::{Purpose, Stream};
use crate::scalar::{Lanes, Scalar, ln};

/// Where the first particles come from: N(mode, (Λ⁻¹)) in units of the first belief's standard deviations.
///
/// Drawn blindly, the first belief's 3n independent entries would leave hardly one particle near the first readings.
pub(super) struct InitialCloud<'a> {
    /// The first belief: at rest, or given.
    belief: &'a Gaussian,
    /// Most probable state given the first readings, in those units.
    mode: Vec<f64>,
    /// Lower factor of Λ by rows.
    factor: Vec<f64>,
}

impl<'a> InitialCloud<'a> {
    /// The belief as it is.
    pub(super) fn blind(belief: &'a Gaussian, entries: usize) -> Self {
        let mut factor = vec![0.0; entries * entries];
        factor.iter_mut().step_by(entries + 1).for_each(|x| *x = 1.0);
        Self { belief, mode: vec![0.0; entries], factor }
    }

    /// The belief after the readings of `sample`, linearised at its mean.
    pub(super) fn informed(
        belief: &'a Gaussian,
        sample: &ParticleSample,
        linearised: Linearised<'_>,
        entries: usize,
    ) -> Self {
        let mut start = Self::blind(belief, entries);
        let std = |d: usize| belief.covariance.at(d, d).sqrt();
        for reading in &sample.readings {
            let row = &linearised.jacobian[reading.channel * entries..][..entries];
            let bias = reading.bias.map_or(0.0, |b| belief.mean[b]);
            let error = reading.value - linearised.prediction[reading.channel] - bias;
            for a in 0..entries {
                let weighted = row[a] * std(a) / reading.noise.variance;
                start.mode[a] += weighted * error;
                for b in 0..=a {
                    start.factor[a * entries + b] += weighted * row[b] * std(b);
                }
            }
        }
        linear::factorise(&mut start.factor, entries);
        linear::solve(&start.factor, entries, &mut start.mode, 1);
        linear::root(&mut start.factor, entries);
        start
    }

    /// Draws the cloud, with weights as if it came from the belief; the mean of its positions is `origins`' where there
    /// are any (rows of `joints`, one particle after the other), and entries of the state beyond are the belief's mean.
    pub(super) fn draw_into(&self, cloud: &mut Cloud, origins: &[f64], joints: usize, seed: u64) {
        let stream = Stream::new(seed, 0, Purpose::Initialise);
        let n = self.mode.len();
        let even = -ln(cloud.blocks.iter().map(|b| b.count).sum::<usize>() as f64);
        let determinant: f64 = (0..n).map(|i| ln(self.factor[i * n + i])).sum();
        for block in &mut cloud.blocks {
            for group in 0..block.groups() {
                let items = block.items(group);
                let normal = &mut block.scratch.normal[..n];
                draw(&stream, items, normal);
                let change = self.around_mode(normal) + (even - determinant);
                block.log_weights.0[group] = change.0;
                for (d, row) in block.state.iter_mut().take(self.belief.mean.len()).enumerate() {
                    let mut value = Wide::constant(self.belief.mean[d]);
                    if d < joints && !origins.is_empty() {
                        let rows = origins.len() / joints;
                        value = Lanes(items.map(|i| origins[i as usize % rows * joints + d]));
                    }
                    if d < n {
                        value += normal[d] * self.belief.covariance.at(d, d).sqrt();
                    }
                    row.0[group] = value.0;
                }
            }
        }
    }

    /// ζ to v = mode + L⁻ᵀζ; returns log p(v) − log q(v) but for log det L.
    fn around_mode(&self, v: &mut [Wide]) -> Wide {
        let n = v.len();
        let mut change = Wide::default();
        for i in (0..n).rev() {
            change += v[i] * v[i] * 0.5;
            let mut value = v[i];
            for k in i + 1..n {
                value -= v[k] * self.factor[k * n + i];
            }
            v[i] = value * (1.0 / self.factor[i * n + i]);
        }
        for i in 0..n {
            v[i] += Wide::constant(self.mode[i]);
            change -= v[i] * v[i] * 0.5;
        }
        change
    }
}
