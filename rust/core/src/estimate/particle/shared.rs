//! One linearisation for all particles, where the cloud is narrow enough that each has the same.

use super::cloud::{Cloud, Scratch, WIDE, Wide};
use super::sample::ParticleSample;
use crate::estimate::kalman::{JerkModel, Linearised};
use crate::linear;
use crate::scalar::{Lanes, ln};
use crate::simd::Kernel;

/// What a linearisation may miss, in standard deviations. Weights are exact whatever it misses: a larger one only costs
/// effective particles.
const SLACK: f64 = 0.1;

/// The linearised proposal N(ŵ, Λ⁻¹) of the links' noise (w, 3n numbers) as a function of the particle's state x: ŵ = ŵ₀ − M (x − x₀).
///
/// Set once a sample, at the cost of one particle; then a particle's own share is a product with M.
#[derive(Clone, Debug)]
pub(super) struct Shared {
    /// x₀, where the cloud is expected (states).
    centre: Vec<f64>,
    /// ŵ₀ (3n).
    mode: Vec<f64>,
    /// M (3n × states).
    gain: Vec<f64>,
    /// L with Λ = L Lᵀ, by rows (3n × 3n), and one over its diagonal.
    factor: Vec<f64>,
    inverse: Vec<f64>,
    /// −ln det L.
    pub(super) constant: f64,
    /// ∂h/∂w of each reading in units of its standard deviation (channels × 3n).
    rows: Vec<f64>,
    /// Where it is tried.
    scratch: Scratch,
}

impl Shared {
    pub(super) fn new(model: &JerkModel) -> Self {
        let (n, d) = (3 * model.joints(), model.states());
        Self {
            centre: vec![0.0; d],
            mode: vec![0.0; n],
            gain: vec![0.0; n * d],
            factor: vec![0.0; n * n],
            inverse: vec![0.0; n],
            constant: 0.0,
            rows: vec![0.0; model.channels() * n],
            scratch: Scratch::new(model, n),
        }
    }

    /// Takes over readings linearised at `centre`.
    pub(super) fn set(&mut self, sample: &ParticleSample, linearised: Linearised<'_>, centre: &[f64]) {
        let Self { mode, gain, factor, inverse, rows, .. } = self;
        let (n, d) = (mode.len(), centre.len());
        self.centre.copy_from_slice(centre);
        mode.fill(0.0);
        gain.fill(0.0);
        factor.fill(0.0);
        factor.iter_mut().step_by(n + 1).for_each(|x| *x = 1.0);
        // Λ = 1 + AᵀS⁻¹A and ŵ₀ = Λ⁻¹AᵀS⁻¹ε as in `Scratch::propose`, and M = Λ⁻¹AᵀS⁻¹H: by how much ŵ follows x.
        for reading in &sample.readings {
            let jacobian = &linearised.jacobian[reading.channel * n..][..n];
            let deviation = reading.noise.variance.sqrt();
            let bias = reading.bias.map_or(0.0, |b| centre[b]);
            let error = (reading.value - linearised.prediction[reading.channel] - bias) / deviation;
            let row = &mut rows[reading.channel * n..][..n];
            sample.by_noise(jacobian, row);
            row.iter_mut().for_each(|slope| *slope /= deviation);
            for j in 0..n {
                mode[j] += row[j] * error;
                for k in 0..=j {
                    factor[j * n + k] += row[j] * row[k];
                }
                for (entry, slope) in gain[j * d..][..n].iter_mut().zip(jacobian) {
                    *entry += row[j] * slope / deviation;
                }
                if let Some(bias) = reading.bias {
                    gain[j * d + bias] += row[j] / deviation;
                }
            }
        }
        linear::factorise(factor, n);
        linear::solve(factor, n, mode, 1);
        linear::solve(factor, n, gain, d);
        linear::root(factor, n);
        for (inverse, root) in inverse.iter_mut().zip(factor.iter().step_by(n + 1)) {
            *inverse = 1.0 / root;
        }
        // The determinant enters p/q, the same for all particles now: it may not be left out, evidence needs it.
        self.constant = -factor.iter().step_by(n + 1).map(|&x| ln(x)).sum::<f64>();
    }
}

/// Whether some particles from all over the cloud find what the shared linearisation says.
pub(super) struct Probe<'a> {
    /// Channels and biases.
    pub(super) model: &'a JerkModel,
    pub(super) sample: &'a ParticleSample,
    /// Channels at the cloud's mean.
    pub(super) linearised: Linearised<'a>,
    /// Particles to try it at.
    pub(super) cloud: &'a Cloud,
    pub(super) shared: &'a mut Shared,
}

impl Kernel for Probe<'_> {
    type Output = bool;

    #[inline(always)]
    fn run(self) -> bool {
        let Self { model, sample, linearised, cloud, shared } = self;
        let Shared { scratch, centre, rows, .. } = shared;
        let (joints, n) = (model.joints(), 3 * model.joints());
        let count: usize = cloud.blocks.iter().map(|b| b.count).sum();
        for (d, entry) in scratch.before.iter_mut().enumerate() {
            // Eight particles from all over the cloud, one a lane.
            *entry = Lanes(core::array::from_fn(|l| cloud.at(l * count / WIDE, d)));
        }
        scratch.coast(joints, sample);
        let Scratch { before, evaluation, row: by_noise, .. } = scratch;
        evaluation.evaluate(&model.robot, &model.channels, before, &sample.dtheta);
        let (mut missed, mut turned, mut whole) = ([0.0; WIDE], [0.0; WIDE], 1.0);
        for reading in &sample.readings {
            let jacobian = &linearised.jacobian[reading.channel * n..][..n];
            let shared = &rows[reading.channel * n..][..n];
            let deviation = reading.noise.variance.sqrt();
            sample.by_noise(&evaluation.jacobian[reading.channel * n..][..n], by_noise);
            // Missed: by how much the prediction is off the linear one. Turned: by how much the rows differ, both in
            // deviations.
            whole += shared.iter().map(|row| row * row).sum::<f64>();
            for l in 0..WIDE {
                let mut expected = linearised.prediction[reading.channel];
                for (d, slope) in jacobian.iter().enumerate() {
                    expected += slope * (before[d].0[l] - centre[d]);
                }
                let own = evaluation.prediction[reading.channel].0[l];
                missed[l] += ((own - expected) / deviation).powi(2);
                turned[l] +=
                    by_noise.iter().zip(shared).map(|(own, row)| (own.0[l] / deviation - row).powi(2)).sum::<f64>();
            }
        }
        (0..WIDE).all(|l| missed[l] < SLACK * SLACK && turned[l] < SLACK * SLACK * whole)
    }
}

impl Scratch {
    /// ŵ of the shared linearisation, into `mode`.
    #[inline(always)]
    pub(super) fn seek(&mut self, shared: &Shared) {
        let d = shared.centre.len();
        let Self { before, after, mode, .. } = self;
        for (deviation, (own, centre)) in after.iter_mut().zip(before.iter().zip(&shared.centre)) {
            *deviation = *own + -centre;
        }
        for (j, mode) in mode.iter_mut().enumerate() {
            let mut value = Lanes([shared.mode[j]; WIDE]);
            for (deviation, gain) in after.iter().zip(&shared.gain[j * d..][..d]) {
                value -= *deviation * *gain;
            }
            *mode = value;
        }
    }
}

impl Shared {
    /// ζ to L⁻ᵀζ.
    #[inline(always)]
    pub(super) fn unwind(&self, zeta: &mut [Wide]) {
        let n = zeta.len();
        for j in (0..n).rev() {
            let mut value = zeta[j];
            for k in j + 1..n {
                value -= zeta[k] * self.factor[k * n + j];
            }
            zeta[j] = value * self.inverse[j];
        }
    }
}

#[cfg(test)]
mod tests;
