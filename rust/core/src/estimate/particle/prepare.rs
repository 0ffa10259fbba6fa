//! What all particles share at a sample: where they start, the noise that moves them, what each reading is to do.

use super::density::Density;
use super::filter::ParticleFilter;
use super::initialise::InitialCloud;
use super::rao_blackwell;
use super::sample::{ParticleReading, ParticleSample, Walk};
use super::settings::{Marginalised, Proposal};
use super::shared::Probe;
use crate::error::DesignError;
use crate::estimate::Status;
use crate::estimate::kalman::{JerkDriven, KalmanSample, Linearise, Model, Phases};
use crate::simd;

impl ParticleFilter {
    /// The belief at a first sample: given, or at rest; and what marginalised biases begin with.
    pub(super) fn start(&mut self, sample: &KalmanSample<'_>) -> Result<(), DesignError> {
        match &self.start {
            Some(start) => {
                self.belief.copy_from(start);
                self.model.resume(sample, &mut self.belief);
            }
            None => self.model.start(sample, &mut self.belief)?,
        }
        let jerk = self.model.jerk_model();
        for (variance, bias) in self.bias_variance.iter_mut().zip(&jerk.biases) {
            *variance = bias.filter(|_| self.motion.is_none()).map_or(0.0, |b| self.belief.covariance.at(b, b));
        }
        self.sample.offset = 0.0;
        Ok(())
    }

    /// The first particles.
    pub(super) fn initialise(&mut self) {
        let Self { model, settings, belief, sample, cloud, .. } = self;
        let n = model.jerk_model().joints();
        if self.motion.is_some() {
            InitialCloud::blind(belief, 0).draw_into(cloud, &settings.initial, n, settings.seed);
            rao_blackwell::start(cloud, belief, n);
            return;
        }
        let blind = settings.proposal == Proposal::Bootstrap || !settings.initial.is_empty();
        let start = if blind {
            InitialCloud::blind(belief, 3 * n)
        } else {
            InitialCloud::informed(belief, sample, model.linearised(), 3 * n)
        };
        start.draw_into(cloud, &settings.initial, n, settings.seed);
    }

    /// What all particles share at this sample; the belief's mean is where they are expected.
    pub(super) fn prepare(&mut self, sample: &KalmanSample<'_>) {
        let n = self.model.jerk_model().joints();
        let (dt, first) = (sample.dt, !self.started);
        let mut reference = core::mem::take(&mut self.summary.reference);
        reference.copy_from_slice(&self.belief.mean[..3 * n]);
        JerkDriven::linearise_phase(Linearise { model: &mut self.model, reference: &reference });
        self.summary.reference = reference;
        let Self { model, sample: shared, .. } = self;
        shared.step = self.taken as u32;
        shared.dt = if first { 0.0 } else { dt };
        let (dtheta, jerk) = model.inputs();
        shared.dtheta.copy_from_slice(dtheta);
        for j in 0..n {
            shared.jerk[j] = if first { 0.0 } else { jerk[j] };
        }
        shared.set_noise(model.noise());
        self.summary.status = 0;
        self.summary.used = 0;
        self.summary.reseeded = false;
        self.plan(sample.readings);
    }

    /// What each reading, and each bias, is to do.
    fn plan(&mut self, readings: &[f64]) {
        let first = !self.started;
        let Self { model, sample, bias_variance, settings, summary, marginalised, motion, belief, .. } = self;
        let closed = *marginalised == Marginalised::Biases;
        let late = |sample: &ParticleSample, channel| sample.past.found.iter().any(|late| late.channel == channel);
        sample.readings.clear();
        sample.walks.clear();
        sample.decays.clear();
        let jerk = model.jerk_model();
        sample.draws = 3 * jerk.joints();
        if let Some(motion) = motion {
            motion.prepare(jerk, model.noise(), sample.dt, first.then_some(&belief.covariance));
            sample.draws = 2 * jerk.joints();
        }
        for (channel, &value) in readings.iter().enumerate() {
            // A bias b ~ N(·, prior) with a reading y = h + b + v, in one of three ways:
            // marginalised (`closed`), never drawn: its variance goes into the reading's, each particle keeps its mean;
            // drawn late: y given the links, b integrated out, then b given y, N(gain · innovation, rest²);
            // drawn early, as a walk: where nothing is read, noise is not normal, or the proposal is the bootstrap's.
            let bias = jerk.biases[channel];
            let own = model.variance(channel);
            let drift = model.noise().bias_step(channel, sample.dt);
            if let Some(bias) = bias {
                sample.decays.push((bias, drift.decay));
            }
            let walk = bias.filter(|_| motion.is_none()).map_or(0.0, |_| drift.variance);
            let density = settings.densities[channel];
            let read = !value.is_nan();
            let past = late(sample, channel);
            let drawn_late =
                closed || (!past && read && settings.proposal != Proposal::Bootstrap && density.is_normal());
            // Where biases are drawn each particle knows its own: no variance is left from before, only the walk's.
            let before = if closed || first { bias_variance[channel] } else { 0.0 };
            let prior = before * drift.decay * drift.decay + walk;
            if let (false, Some(bias)) = (drawn_late || prior == 0.0, bias) {
                sample.walks.push(Walk { entry: bias, std: prior.sqrt(), draw: sample.draws });
                sample.draws += 1;
            }
            let extra = if drawn_late { prior } else { 0.0 };
            // The scalar Kalman update of the bias: y has variance own + prior, b takes prior/variance of its innovation.
            let variance = own + extra;
            let gain = extra / variance;
            if closed {
                bias_variance[channel] = if read { prior * (1.0 - gain) } else { prior };
            }
            if !read {
                summary.status |= Status::BRIDGED;
                continue;
            }
            summary.used += 1;
            if past {
                continue;
            }
            let rest = if closed { 0.0 } else { (extra * (1.0 - gain)).sqrt() };
            let noise = density.of_variance(variance);
            let draw = sample.draws;
            sample.draws += usize::from(rest > 0.0);
            sample.readings.push(ParticleReading { channel, value, bias, noise, gain, rest, draw });
        }
        for (late, variance) in sample.past.decorrelate(|channel| model.variance(channel)) {
            let noise = settings.densities[late.channel].of_variance(variance);
            let (channel, value) = (late.channel, late.value);
            sample.readings.push(ParticleReading { channel, value, bias: None, noise, gain: 0.0, rest: 0.0, draw: 0 });
        }
        if summary.used == 0 {
            summary.status |= Status::PREDICTED;
        }
    }

    /// Linearises once for all particles, if that is what each would find.
    pub(super) fn share(&mut self) {
        let Self { model, sample, shared, sharing, motion, cloud, settings, belief, .. } = self;
        // Shared only where particles could not tell the difference: one iteration, normal noise, nothing marginalised.
        let once = matches!(settings.proposal, Proposal::Linearised { iterations: 1, .. });
        *sharing = self.started
            && sample.past.found.is_empty()
            && motion.is_none()
            && once
            && settings.densities.iter().all(Density::is_normal);
        if *sharing {
            let linearised = model.linearised();
            shared.set(sample, linearised, &belief.mean);
            // The mean may be a fair place to linearise and the cloud's edge not: `Probe` tries particles far out.
            let probe = Probe { model: model.jerk_model(), sample, linearised, cloud, shared };
            *sharing = simd::dispatch_lanes(simd::level(), probe);
        }
    }
}
