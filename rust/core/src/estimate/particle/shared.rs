//! One linearisation for all particles, where the cloud is narrow enough that each has the same.

use super::cloud::{Cloud, Scratch, WIDE};
use super::proposal::{Sample, reach};
use crate::estimate::kalman::{JerkModel, Linearised};
use crate::linear;
use crate::scalar::{Lanes, ln};
use crate::simd::Kernel;

/// What a linearisation may miss, in standard deviations. Weights are exact whatever it misses: a larger one only costs
/// effective particles.
const SLACK: f64 = 0.1;

/// The linearised proposal N(ŵ, Λ⁻¹) of increments as a function of the particle's state x: ŵ = ŵ₀ − M (x − x₀).
#[derive(Clone, Debug)]
pub(super) struct Shared {
    /// x₀, where the cloud is expected (states).
    centre: Vec<f64>,
    /// ŵ₀ (n).
    mode: Vec<f64>,
    /// M (n × states).
    gain: Vec<f64>,
    /// L with Λ = L Lᵀ, by rows (n × n).
    pub(super) factor: Vec<f64>,
    /// −ln det L.
    pub(super) constant: f64,
    /// ∂h/∂w of each reading in units of its standard deviation (channels × n).
    rows: Vec<f64>,
    /// Where it is tried.
    scratch: Scratch,
}

impl Shared {
    pub(super) fn new(model: &JerkModel) -> Self {
        let (n, d) = (model.joints(), model.states());
        Self {
            centre: vec![0.0; d],
            mode: vec![0.0; n],
            gain: vec![0.0; n * d],
            factor: vec![0.0; n * n],
            constant: 0.0,
            rows: vec![0.0; model.channels() * n],
            scratch: Scratch::new(model, n),
        }
    }

    /// Takes over readings linearised at `centre`.
    pub(super) fn set(&mut self, sample: &Sample, linearised: Linearised<'_>, centre: &[f64]) {
        let Self { mode, gain, factor, rows, .. } = self;
        let (n, d) = (mode.len(), centre.len());
        self.centre.copy_from_slice(centre);
        mode.fill(0.0);
        gain.fill(0.0);
        factor.fill(0.0);
        factor.iter_mut().step_by(n + 1).for_each(|x| *x = 1.0);
        let reach = reach(sample.dt);
        for reading in &sample.readings {
            let jacobian = &linearised.jacobian[reading.channel * 3 * n..][..3 * n];
            let deviation = reading.noise.variance.sqrt();
            let bias = reading.bias.map_or(0.0, |b| centre[b]);
            let error = (reading.value - linearised.prediction[reading.channel] - bias) / deviation;
            let row = &mut rows[reading.channel * n..][..n];
            for j in 0..n {
                let along: f64 = (0..3).map(|k| jacobian[k * n + j] * reach[k]).sum();
                row[j] = along * sample.increments[j] / deviation;
            }
            for j in 0..n {
                mode[j] += row[j] * error;
                for k in 0..=j {
                    factor[j * n + k] += row[j] * row[k];
                }
                for (entry, slope) in gain[j * d..][..3 * n].iter_mut().zip(jacobian) {
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
        self.constant = -factor.iter().step_by(n + 1).map(|&x| ln(x)).sum::<f64>();
    }
}

/// Whether some particles from all over the cloud find what the shared linearisation says.
pub(super) struct Probe<'a> {
    pub(super) model: &'a JerkModel,
    pub(super) sample: &'a Sample,
    pub(super) linearised: Linearised<'a>,
    pub(super) cloud: &'a Cloud,
    pub(super) shared: &'a mut Shared,
}

impl Kernel for Probe<'_> {
    type Output = bool;

    #[inline(always)]
    fn run(self) -> bool {
        let Self { model, sample, linearised, cloud, shared } = self;
        let Shared { scratch, centre, rows, .. } = shared;
        let n = model.joints();
        let count: usize = cloud.blocks.iter().map(|b| b.count).sum();
        for (d, entry) in scratch.before.iter_mut().enumerate() {
            *entry = Lanes(core::array::from_fn(|l| cloud.at(l * count / WIDE, d)));
        }
        scratch.coast(n, sample);
        scratch.sensed.linearise(&model.robot, &model.channels, &scratch.before, &sample.dtheta, reach(sample.dt));
        let mut agree = true;
        for l in 0..WIDE {
            let (mut missed, mut turned, mut whole) = (0.0, 0.0, 1.0);
            for reading in &sample.readings {
                let jacobian = &linearised.jacobian[reading.channel * 3 * n..][..3 * n];
                let mut expected = linearised.prediction[reading.channel];
                for (d, slope) in jacobian.iter().enumerate() {
                    expected += slope * (scratch.before[d].0[l] - centre[d]);
                }
                let own = scratch.sensed.prediction[reading.channel].0[l];
                missed += (own - expected).powi(2) / reading.noise.variance;
                for j in 0..n {
                    let row = rows[reading.channel * n + j];
                    let own = scratch.sensed.by_increment[reading.channel * n + j].0[l] * sample.increments[j];
                    turned += (own / reading.noise.variance.sqrt() - row).powi(2);
                    whole += row * row;
                }
            }
            agree &= missed < SLACK * SLACK && turned < SLACK * SLACK * whole;
        }
        agree
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

#[cfg(test)]
mod tests;
