//! A Kalman filter that runs beside the cloud, with the same model and noise, and what it says of the cloud.
//!
//! A cloud that has lost its spread stays where it is, whatever the readings say, and its own standard deviations say
//! nothing of it. Beside a Kalman filter it shows: in the evidence, the sum of log p(yₖ | y₁ … yₖ₋₁), by which two filters of
//! the same readings compare as models do; and in spread and place.

use super::filter::ParticleFilter;
use super::output::{Summary, packed};
use super::past::Past;
use super::rao_blackwell;
use super::settings::{Collapse, Marginalised, ParticleSettings};
use crate::check::are_sound;
use crate::error::{DesignError, RunError};
use crate::estimate::Status;
use crate::estimate::kalman::{ExtendedKalmanFilter, FilterSettings, JerkDriven, KalmanSample};
use crate::random::Purpose;

/// Evidence by which one of two filters is taken to be right, odds of 150 to one. Where both are, the sum of what the
/// cloud is ahead exceeds a with a probability of at most e⁻ᵃ (Ville 1939).
const DECISIVE: f64 = 5.0;
/// Evidence by which the cloud is lost. A cloud of few particles is behind by chance a little at every sample.
const LOST: f64 = 30.0;
/// How much a cloud may be behind at a sample, by chance, for each reading.
const CHANCE: f64 = 0.25;
/// More evidence than this is not remembered.
const MOST: f64 = 50.0;
/// Part of the evidence that is left a sample later. A sum that may not fall below zero and forgets nothing comes to any
/// bound by chance.
const FADING: f64 = 1.0 - 1.0 / 64.0;
/// A cloud without evidence of its own should not be narrower than the first, nor further off than the second, both in
/// the Kalman filter's standard deviations. By chance a few hundred particles come to 0.6 and 0.2 of them.
const WORN: [f64; 2] = [0.3, 1.0];
/// Further off than this it is lost.
const ASTRAY: f64 = 5.0;
/// Narrower than this it has collapsed, whatever its evidence: a few copies of one particle may well be ahead by chance, or
/// where the model is wrong, but their standard deviations are those of no belief.
const COLLAPSED: f64 = 0.05;
/// An outlier to the Kalman filter, where readings are expected to have any.
const GATE: f64 = 5.0;

/// What the Kalman filter says of the cloud.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Verdict {
    Good,
    /// Narrower than it can be, or elsewhere, without explaining the readings any better.
    Worn,
    /// Does not explain the readings any more.
    Lost,
}

/// The Kalman filter, and how the cloud compares to it.
///
/// It costs a Kalman filter's step a sample, little beside a few hundred particles.
#[derive(Clone, Debug)]
pub(super) struct Guard {
    /// On the same model and noise, gated where the particles' noise has heavy tails.
    pub(super) kalman: ExtendedKalmanFilter<JerkDriven>,
    /// By how much the cloud's evidence is ahead, at least zero.
    ahead: f64,
    /// By how much it is behind, at least zero.
    behind: f64,
    /// Whether both know the same limits and starts.
    pub(super) comparable: bool,
    /// Whether their noise is the same as well, so that they differ by chance and linearisation only.
    alike: bool,
}

impl Guard {
    pub(super) fn new(model: &JerkDriven, settings: &ParticleSettings) -> Result<Self, DesignError> {
        let normal = settings.densities.iter().all(super::Density::is_normal);
        let free = settings.limits.iter().all(|&(low, high)| low == f64::NEG_INFINITY && high == f64::INFINITY);
        let comparable = free && settings.initial.is_empty();
        let own = FilterSettings { gate: (!normal).then_some(GATE), iterations: 1 };
        Ok(Self {
            kalman: ExtendedKalmanFilter::new(model.clone(), own)?,
            ahead: 0.0,
            behind: 0.0,
            comparable,
            alike: normal && comparable,
        })
    }

    /// Forgets the state, and what was held against the cloud.
    pub(super) fn reset(&mut self) {
        self.kalman.reset();
        (self.ahead, self.behind) = (0.0, 0.0);
    }

    /// Takes the sample that the cloud takes.
    #[inline(never)]
    pub(super) fn step(&mut self, sample: KalmanSample<'_>, past: &mut Past) -> Result<(), RunError> {
        self.kalman.step_with(sample, |model, belief| past.foretell(model, belief, sample.readings))
    }

    /// Whether there is a Kalman estimate to restart from.
    pub(super) fn is_finite(&self) -> bool {
        let (fit, belief) = (self.kalman.fit(), self.kalman.belief());
        fit.log_likelihood.is_finite() && are_sound(belief.mean.iter().chain(&belief.covariance.data))
    }

    /// Whether the cloud explains the readings better.
    pub(super) fn cloud_leads(&self) -> bool {
        self.ahead >= DECISIVE
    }

    /// Holds the cloud after a sample against the Kalman filter.
    fn judge(&mut self, summary: &Summary, joints: usize) -> Verdict {
        let (ours, fit) = (summary.log_likelihood, self.kalman.fit());
        if fit.used == summary.used && ours.is_finite() {
            // CUSUM of the log Bayes factor both ways (Page 1954): a cloud that was good for long gets no credit for
            // it.
            let ahead = (ours - fit.log_likelihood).clamp(-MOST, MOST);
            self.ahead = (self.ahead * FADING + ahead).clamp(0.0, MOST);
            self.behind = (self.behind * FADING - ahead - CHANCE * f64::from(fit.used)).clamp(0.0, MOST);
        }
        let (spread, distance) = self.compare(summary, joints);
        let [narrow, far] = WORN;
        match () {
            // By evidence first, then by place and spread; the latter only where both filters represent the same distribution.
            () if self.behind > LOST || (self.alike && spread < COLLAPSED) => Verdict::Lost,
            () if !self.alike || self.cloud_leads() => Verdict::Good,
            () if distance > ASTRAY => Verdict::Lost,
            () if spread < narrow || distance > far => Verdict::Worn,
            () => Verdict::Good,
        }
    }

    /// Least spread of the cloud's positions in the Kalman filter's standard deviations, and largest distance in both's.
    fn compare(&self, summary: &Summary, joints: usize) -> (f64, f64) {
        let belief = self.kalman.belief();
        let (mut spread, mut distance) = (f64::INFINITY, 0.0_f64);
        for j in 0..joints {
            let (own, theirs) = (summary.products[packed(j, j, joints)], belief.covariance.at(j, j));
            let apart = summary.mean[j] - belief.mean[j];
            spread = spread.min(own / theirs);
            distance = distance.max(apart * apart / (own + theirs));
        }
        (spread.sqrt(), distance.sqrt())
    }
}

impl ParticleFilter {
    /// Action on a cloud after a sample: none, restart it, flag it, or stop.
    pub(super) fn guard(&mut self) -> Result<(), RunError> {
        if !self.guard.is_finite() {
            self.restart_guard();
            self.summary.status |= Status::CONTRADICTED;
        }
        let verdict = self.guard.judge(&self.summary, self.model.jerk_model().joints());
        self.summary.status |= self.guard.kalman.status() & (Status::CONTRADICTED | Status::FAULTY);
        if verdict == Verdict::Lost {
            self.summary.status |= Status::CONTRADICTED;
        }
        match self.settings.collapse {
            Collapse::Stop if verdict == Verdict::Lost => Err(RunError::Lost { sample: self.taken }),
            Collapse::Reseed if verdict != Verdict::Good => {
                self.reseed();
                Ok(())
            }
            _ => Ok(()),
        }
    }

    /// No particle is possible: restarts, goes on as if the readings were missing, or stops.
    pub(super) fn recover(&mut self) -> Result<(), RunError> {
        if self.settings.collapse == Collapse::Stop {
            return Err(RunError::Impossible { sample: self.taken });
        }
        for reading in self.sample.readings.iter().filter(|_| self.marginalised == Marginalised::Biases) {
            self.bias_variance[reading.channel] = reading.gain * reading.noise.variance;
        }
        self.equalise_weights();
        self.summarise();
        (self.summary.used, self.summary.log_likelihood) = (0, 0.0);
        self.summary.status |= Status::PREDICTED | Status::CONTRADICTED | self.guard.kalman.status() & Status::FAULTY;
        if self.settings.collapse == Collapse::Reseed {
            self.reseed();
        } else if !self.guard.is_finite() {
            self.restart_guard();
        }
        Ok(())
    }

    /// A first cloud, whose entries were drawn one by one, from the Kalman filter's belief.
    pub(super) fn correlate(&mut self) {
        let reseeded = self.summary.reseeded;
        self.reseed();
        self.summary.reseeded = reseeded;
    }

    /// The Kalman filter's belief from the cloud's, where it went out of the numbers.
    fn restart_guard(&mut self) {
        self.take_covariance();
        self.guard.kalman.restart(&self.belief);
    }

    /// Draws the cloud again from the Kalman filter's estimate, with its mean and covariance.
    fn reseed(&mut self) {
        (self.guard.ahead, self.guard.behind) = (0.0, 0.0);
        if !self.guard.is_finite() {
            return self.restart_guard();
        }
        let log_likelihood = self.summary.log_likelihood;
        self.want_belief();
        self.found.factor.fill(0.0); // of the cloud that is nothing is taken over, not even times zero
        // x = m + L ζ with fresh ζ: a kernel of width one is a draw from the belief, whatever the cloud was.
        self.regularise(Purpose::Reseed, 1.0);
        self.equalise_weights();
        // Moved once more to have exactly this mean and covariance, where there are enough particles to have one.
        if self.settings.particles > 2 * self.belief.mean.len() {
            self.take_moments(false);
            self.regularise(Purpose::Reseed, 0.0);
            self.equalise_weights();
        }
        self.summarise();
        self.summary.log_likelihood = log_likelihood;
        self.summary.reseeded = true;
    }

    /// The Kalman filter's belief as what the cloud is wanted to have, less what is known in closed form.
    fn want_belief(&mut self) {
        let Self { guard, summary, wanted, model, bias_variance, marginalised, cloud, .. } = self;
        let belief = guard.kalman.belief();
        let d = wanted.mean.len();
        wanted.mean.copy_from_slice(&belief.mean[..d]);
        for r in 0..d {
            for c in r..d {
                summary.products[packed(r, c, d)] = belief.covariance.at(r, c);
            }
        }
        for (bias, variance) in model.jerk_model().biases.iter().zip(bias_variance.iter_mut()) {
            if let (Marginalised::Biases, Some(b)) = (*marginalised, *bias) {
                *variance = variance.min(belief.covariance.at(b, b));
                summary.products[packed(b, b, d)] -= *variance;
            }
        }
        wanted.factorise(&summary.products);
        if *marginalised == Marginalised::Accelerations {
            rao_blackwell::condition(cloud, &mut wanted.factor, d, 2 * model.jerk_model().joints());
        }
    }
}
