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
    pub(super) centre: Vec<f64>,
    /// ŵ₀ (n).
    pub(super) mode: Vec<f64>,
    /// M (n × states).
    pub(super) gain: Vec<f64>,
    /// L with Λ = L Lᵀ, by rows (n × n).
    pub(super) factor: Vec<f64>,
    /// −ln det L.
    pub(super) constant: f64,
    /// ∂h/∂w of each reading in units of its standard deviation (channels × n).
    rows: Vec<f64>,
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
    pub(super) shared: &'a Shared,
    pub(super) linearised: Linearised<'a>,
    pub(super) cloud: &'a mut Cloud,
}

impl Kernel for Probe<'_> {
    type Output = bool;

    #[inline(always)]
    fn run(self) -> bool {
        let Self { model, sample, shared, linearised, cloud } = self;
        let count: usize = cloud.blocks.iter().map(|b| b.count).sum();
        let mut scratch = core::mem::take(&mut cloud.blocks[0].scratch);
        for (d, entry) in scratch.before.iter_mut().enumerate() {
            *entry = Lanes(core::array::from_fn(|l| cloud.at(l * count / WIDE, d)));
        }
        let agree = scratch.agrees(model, sample, shared, linearised);
        cloud.blocks[0].scratch = scratch;
        agree
    }
}

impl Scratch {
    #[inline(always)]
    fn agrees(&mut self, model: &JerkModel, sample: &Sample, shared: &Shared, linearised: Linearised<'_>) -> bool {
        let n = model.joints();
        self.coast(n, sample);
        self.sensed.linearise(model, &self.before, &sample.dtheta, reach(sample.dt));
        let mut agree = true;
        for l in 0..WIDE {
            let (mut missed, mut turned, mut whole) = (0.0, 0.0, 1.0);
            for reading in &sample.readings {
                let jacobian = &linearised.jacobian[reading.channel * 3 * n..][..3 * n];
                let mut expected = linearised.prediction[reading.channel];
                for (d, slope) in jacobian.iter().enumerate() {
                    expected += slope * (self.before[d].0[l] - shared.centre[d]);
                }
                let own = self.sensed.prediction[reading.channel].0[l];
                missed += (own - expected).powi(2) / reading.noise.variance;
                for j in 0..n {
                    let row = shared.rows[reading.channel * n + j];
                    let own = self.sensed.by_increment[reading.channel * n + j].0[l] * sample.increments[j];
                    turned += (own / reading.noise.variance.sqrt() - row).powi(2);
                    whole += row * row;
                }
            }
            agree &= missed < SLACK * SLACK && turned < SLACK * SLACK * whole;
        }
        agree
    }

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
mod tests {
    use super::super::{Collapse, Density, Marginalised, ParticleFilter, ParticleSettings, Proposal, Resampling};
    use crate::estimate::kalman::{Further, Inputs, JerkDriven, JerkModel, KalmanSample, Noise};
    use crate::robot::{BodySpec, Drive, JointKind, MotorFriction, Robot, Sensor, SoftWindup, Tree};
    use crate::spatial::{Mat3, Vec3};
    use std::sync::Arc;

    /// A pendulum behind a spring, with an accelerometer at its end.
    fn model() -> JerkDriven {
        let body = BodySpec {
            parent: None,
            joint: 0,
            kind: JointKind::Revolute,
            rotation: Mat3::IDENTITY,
            translation: Vec3([0.0; 3]),
            axis: Vec3([0.0, 1.0, 0.0]),
            mass: 20.0,
            com: Vec3([0.0, 0.0, 0.5]),
            inertia: Mat3::IDENTITY,
        };
        let tree = Tree::new(Vec3([0.0, 0.0, -9.81]), &[body]).unwrap();
        let frame = tree.frame("end", 0, &Mat3::IDENTITY, &Vec3([0.0, 0.0, 1.0])).unwrap();
        let drive = Drive {
            elastic: true,
            stiffness: 1e5,
            damping: 50.0,
            motor_inertia: 10.0,
            cubic_stiffness: 0.0,
            soft_windup: SoftWindup::default(),
            motor_friction: MotorFriction::default(),
            link_friction: [0.0; 6],
        };
        let sensor = Sensor { frame, axes: vec![0, 2], noise_std: 0.05 };
        let robot = Robot::new(tree, vec![drive], vec![0.0], vec![sensor], vec![], None).unwrap();
        let noise = Noise {
            jerk: vec![50.0],
            reading: vec![1e-5, 0.05, 0.05],
            torsion: 0.0,
            link_walk: vec![0.0; 2],
            bias_walk: vec![1e-6, 1e-3, 1e-3],
            initial: vec![1e-4, 1e-3, 0.1],
            initial_bias: vec![1e-5, 0.1, 0.1],
        };
        JerkDriven::new(JerkModel::new(Arc::new(robot), Further::default(), &[true; 3]).unwrap(), noise, true).unwrap()
    }

    /// Whether each of three steps at rest shared its linearisation, and the likelihood of the last.
    fn steps(initial: &[f64], iterations: usize) -> ([bool; 3], f64) {
        let settings = ParticleSettings {
            particles: 64,
            seed: 1,
            proposal: Proposal::Linearised { iterations, tail: None },
            resampling: Resampling::Systematic,
            threshold: 0.0, // whoever is far from the readings stays
            kernel: None,
            densities: vec![Density::Normal; 3],
            limits: vec![(f64::NEG_INFINITY, f64::INFINITY)],
            initial: initial.to_vec(),
            collapse: Collapse::Recover,
            quantiles: vec![],
        };
        let mut filter = ParticleFilter::new(model(), settings, Marginalised::Biases).unwrap();
        let inputs = Inputs { dtheta: &[0.0], jerk: &[0.0], tau: &[] };
        let shared = [(); 3].map(|()| {
            filter.step(KalmanSample { dt: 1e-3, readings: &[0.0, 0.0, 9.81], inputs }).unwrap();
            filter.sharing
        });
        (shared, filter.summary().log_likelihood)
    }

    #[test]
    fn a_narrow_cloud_shares_and_finds_what_each_particle_finds() {
        let ((shared, one), (never, own)) = (steps(&[], 1), steps(&[], 2));
        assert_eq!((shared, never), ([false, true, true], [false; 3]));
        assert!((one / own - 1.0).abs() < 1e-3, "{one} {own}");
    }

    #[test]
    fn a_wide_cloud_does_not() {
        assert_eq!(steps(&[-0.6, 0.6], 1).0, [false; 3]);
    }
}
