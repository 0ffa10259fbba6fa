//! One sample through the filter: predicted to, linearised, used and judged.

use super::correction::{Correction, Readings};
use super::filter::ExtendedKalmanFilter;
use super::gaussian::Gaussian;
use super::output::FilterOutput;
use super::phases::{Judge, Linearise, Phases, Predict, Regress, Update, WeighReadings};
use super::recording::KalmanSample;
use crate::check::{LARGEST, are_sound, expect};
use crate::error::{DesignError, RunError};
use crate::estimate::Status;
use crate::linear;

/// The first samples of links with disturbance torques or varying wrenches are linearised so often: links stand far from where motors say.
const EARLY: (usize, usize) = (32, 5);

/// Links that are predicted no better than this [rad], as after a gap, are linearised so often: torques bend over it by more
/// than an encoder's step, and what one linearisation leaves looks like a fault.
const WIDE: (f64, usize) = (1e-2, 4);

/// A sample's readings are weighed so often where their noise has outliers.
const WEIGHINGS: usize = 4;

impl<M: Phases> ExtendedKalmanFilter<M> {
    /// Takes one sample: predicts to its time, then uses its readings.
    ///
    /// # Errors
    /// A sample that cannot be used, or a first one from which the model cannot [start](super::Model::start): the state stays as it
    /// was. [`RunError::NotFinite`]: readings so extreme that the state is not finite; the next sample restarts.
    pub fn step(&mut self, sample: KalmanSample<'_>) -> Result<(), RunError> {
        self.step_with(sample, |_, _| ())
    }

    /// [`step`](Self::step), showing `predicted` the belief before it uses the readings.
    pub(crate) fn step_with(
        &mut self,
        sample: KalmanSample<'_>,
        predicted: impl FnOnce(&M, &Gaussian),
    ) -> Result<(), RunError> {
        sample.check(&self.model)?;
        self.advance(&sample)?;
        predicted(&self.model, &self.belief);
        self.correct(&sample);
        let finite = self.is_finite(&sample);
        let sample = self.taken;
        if !finite {
            self.reset();
            return Err(RunError::NotFinite { sample });
        }
        self.taken += 1;
        Ok(())
    }

    /// Whether the sample left an estimate, of motors too, which are reported with their velocities as read. Of the covariance
    /// the variances are looked at: what spoils the rest spoils the next mean.
    #[inline(always)]
    pub(super) fn is_finite(&self, sample: &KalmanSample<'_>) -> bool {
        let Gaussian { mean, covariance } = &self.belief;
        let variances = covariance.data.iter().step_by(covariance.stride + 1).take(mean.len());
        self.correction.log_likelihood.is_finite()
            && are_sound(mean.iter().chain(variances))
            && sample.inputs.dtheta.iter().all(|x| x.is_nan() || x.abs() <= LARGEST)
    }

    /// The row of an estimate that belongs to the last sample, written into the first of `out`.
    pub fn report_into(&mut self, out: &mut FilterOutput) {
        self.report(0, out, false);
        out.write_fit(0, &self.correction);
    }

    /// To the sample's time; afterwards the belief is what was predicted.
    pub(super) fn advance(&mut self, sample: &KalmanSample<'_>) -> Result<(), DesignError> {
        if let Some(path) = &self.path {
            expect(self.taken < path.len(), "samples", (self.taken + 1) as f64, "no more than the trajectory has")?;
        }
        if self.started {
            // x⁻ = f(x), P⁻ = F P Fᵀ + Q, and Σ ← F Σ + ∂f/∂p of the parameters that are known to a tolerance.
            let Self { model, belief, prior: Gaussian { mean: beyond, .. }, path, .. } = self;
            if let Some(path) = &path {
                path.replace(self.taken - 1, belief, beyond);
            }
            M::predict_phase(Predict { model, sample, belief });
            if path.is_some() {
                // x⁻ = f(x₀) + F (x − x₀).
                model.carry_noise_free(beyond, 1, sample.dt);
                linear::add_scaled(&mut belief.mean, 1.0, beyond);
            }
            if let Some(consider) = &mut self.consider {
                consider.carry(&mut self.model, sample.dt);
            }
        } else {
            // A first sample: no time passes, and the belief is the prior that its readings then correct.
            match &self.start {
                Some(start) => {
                    self.belief.begin_with(start);
                    self.model.resume(sample, &mut self.belief);
                }
                None => self.model.start(sample, &mut self.belief)?,
            }
            // Links are where motors and torsions put them, so that the start depends on parameters too.
            self.linearise();
            if let Some(consider) = &mut self.consider {
                consider.start(&mut self.model);
            }
            self.started = true;
        }
        Ok(())
    }

    /// Uses the sample's readings.
    pub(super) fn correct(&mut self, sample: &KalmanSample<'_>) {
        // A channel stays shut out over all iterations of this sample: the gate judges the first innovation only.
        self.correction.gated.fill(false);
        let (linearisations, robust) = (self.linearisations(), self.path.is_none() && self.sensors.is_robust());
        let passes = linearisations.max(if robust { WEIGHINGS } else { 1 });
        if passes > 1 {
            self.prior.copy_from(&self.belief);
        }
        self.linearise();
        if robust {
            // First by what was predicted, or an outlier would hide itself in what it does to the estimate.
            self.weigh(sample.readings, false);
        }
        self.update(sample.readings, self.settings.gate);
        // Iterated update (Bell and Cathey 1993): Gauss–Newton on prior and readings together. Each pass begins from
        // the prior, not from the pass before, or the readings would count as often as there are passes.
        for pass in 1..passes {
            if pass < linearisations {
                self.linearise();
            }
            if robust {
                self.weigh(sample.readings, true);
            }
            self.belief.copy_from(&self.prior);
            self.update(sample.readings, None);
        }
        if robust || self.path.is_some() {
            self.correction.settle_weights();
        }
        // What innovations say beside the state: of parameters (their estimates, a NIS whitened of them), and of
        // faults.
        let Self { model, belief, correction, consider, monitor, .. } = self;
        let (consider, monitor) = (consider.as_mut(), monitor.as_mut());
        M::judge_phase(Judge { model, belief, correction, consider, monitor, sample });
        if self.model.bridged() {
            self.correction.status |= Status::BRIDGED;
        }
    }

    /// How often this sample's measurement is linearised.
    fn linearisations(&self) -> usize {
        if self.path.is_some() {
            return 1;
        }
        let ((samples, early), (wide, again)) = (EARLY, WIDE);
        let pushed = self.model.link_disturbance().is_some() || self.model.wrench().is_some();
        let early = if pushed && self.taken < samples { early } else { 1 };
        let is_wide = (0..self.model.robot().len()).any(|j| self.belief.covariance.at(j, j) > wide * wide);
        self.settings.iterations.max(early).max(if is_wide { again } else { 1 })
    }

    /// One measurement update of the present belief, channels linearised where they last were.
    fn update(&mut self, readings: &[f64], gate: Option<f64>) {
        let Self { model, correction, belief, .. } = self;
        M::update_phase(Update { model: &*model, correction, belief, readings, gate });
    }

    /// How much readings count by the present belief, which has `used` them or not.
    fn weigh(&mut self, values: &[f64], used: bool) {
        let Self { model, correction, belief, sensors, .. } = self;
        M::weigh_phase(WeighReadings {
            model: &*model,
            correction,
            belief,
            readings: Readings { values, used },
            sensors,
        });
    }

    /// At the present mean, or where the path says.
    pub(super) fn linearise(&mut self) {
        // Copied, for `update` moves the mean reading by reading while the channels stay linearised here.
        let Correction { reference, weights, .. } = &mut self.correction;
        let d = reference.len();
        if let Some(path) = &self.path {
            reference.copy_from_slice(&path.state(self.taken)[..d]);
            weights.copy_from_slice(path.weights(self.taken));
        } else {
            reference.copy_from_slice(&self.belief.mean[..d]);
        }
        let model = &mut self.model;
        if self.path.is_none() && model.has_points() {
            M::regress_phase(Regress { model, reference, covariance: &self.belief.covariance });
        } else {
            M::linearise_phase(Linearise { model, reference });
        }
    }
}
