//! The particle filter: one step, and whole recordings.

use super::cloud::Cloud;
use super::density::Density;
use super::guard::Guard;
use super::initialise::InitialCloud;
use super::output::{ParticleOutput, Summary, packed};
use super::past::Past;
use super::process_noise::ProcessNoise;
use super::proposal::{ParticleReading, ParticleSample, Propagate, Walk};
use super::rao_blackwell;
use super::regularise::Moments;
use super::settings::{Marginalised, ParticleSettings, Proposal};
use super::shared::{Probe, Shared};
use super::sums::Deviations;
use crate::error::{DesignError, RunError};
use crate::estimate::Status;
use crate::estimate::kalman::{
    FilterOutput, Gaussian, JerkDriven, KalmanRecording, KalmanSample, Keep, Linearise, Model, Phases, Predict, Tool,
};
use crate::interrupt::Watch;
use crate::linear;
use crate::parallel;
use crate::simd;

/// Fewer particles than this are not worth a second thread.
const PARALLEL: usize = 2048;

/// Particle filter on the jerk-driven model; a step on one thread allocates nothing.
///
/// Plain, or with a part of the state [marginalised](Marginalised).
///
/// ```
/// use linkside_core::estimate::kalman::{Inputs, JerkDriven, JerkModel, JerkNoise, KalmanSample};
/// use linkside_core::estimate::measurement::Kind;
/// use linkside_core::estimate::particle::{
///     Collapse, Density, Marginalised, ParticleFilter, ParticleSettings, Proposal, Resampling,
/// };
///
/// let robot = std::sync::Arc::new(linkside_core::demo::arm()?);
/// let model = JerkModel::new(robot, &[Kind::Motor], &[false])?;
/// # let noise = JerkNoise {
/// #     jerk: vec![100.0], link_walk: vec![1e-5, 1e-3], reading: vec![1e-5], torsion: 1e-3, bias_walk: vec![0.0],
/// #     bias_time: vec![f64::INFINITY], initial: vec![1e-4, 1e-3, 0.1], initial_bias: vec![0.0],
/// # };
/// let settings = ParticleSettings {
///     particles: 500,
///     seed: 0, // the same seed gives the same bits, on any number of threads
///     proposal: Proposal::Linearised { iterations: 1, tail: None },
///     resampling: Resampling::Systematic,
///     threshold: 0.5,
///     kernel: None,
///     densities: vec![Density::Normal],
///     limits: vec![(-3.0, 3.0)],
///     initial: vec![],
///     collapse: Collapse::Reseed,
///     quantiles: vec![],
/// };
/// let mut filter = ParticleFilter::new(JerkDriven::new(model, noise, false)?, settings, Marginalised::Nothing)?;
/// for _ in 0..50 {
///     let inputs = Inputs { jerk: &[0.0], dtheta: &[f64::NAN], ..Inputs::default() };
///     filter.step(KalmanSample { dt: 1e-3, readings: &[0.1], inputs })?;
/// }
/// assert!((filter.summary().mean[0] - 0.1).abs() < 1e-4);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct ParticleFilter {
    /// The jerk-driven model with its noise.
    pub(super) model: JerkDriven,
    /// Number, proposal, resampling, densities and limits.
    pub(super) settings: ParticleSettings,
    /// Which part of the state each particle has a Gaussian of, in place of a number.
    pub(super) marginalised: Marginalised,
    /// The Kalman filter beside the cloud.
    pub(super) guard: Guard,
    /// The cloud's mean as it would move, and where motors and biases were last linearised.
    pub(super) belief: Gaussian,
    /// The particles with their weights, in blocks that threads take one by one.
    pub(super) cloud: Cloud,
    /// What all particles share at the present sample.
    pub(super) sample: ParticleSample,
    /// Scratch of the linearisation that all particles share.
    shared: Shared,
    /// Whether the shared linearisation is that of each particle.
    pub(super) sharing: bool,
    /// There where accelerations are marginalised.
    motion: Option<ProcessNoise>,
    /// Variance of each channel's bias for a given path of the links (channels), where biases alone are marginalised.
    pub(super) bias_variance: Vec<f64>,
    /// Mean, effective number and likelihood of the last sample.
    pub(super) summary: Summary,
    /// Moments of the weighted cloud before resampling, and of the cloud that chance made of it after.
    pub(super) wanted: Moments,
    pub(super) found: Moments,
    /// The particle that each new one copies.
    pub(super) ancestors: Vec<u32>,
    /// Kinematics of the tool centre point.
    pub(super) tool: Tool,
    /// How motors were linearised at the last sample, for the row of an estimate.
    pub(super) memory: Vec<f64>,
    /// Whether blocks go to all cores: below [`PARALLEL`] particles waking threads takes longer than the work.
    pub(super) threads: bool,
    /// Samples taken: the step of the random numbers, and what messages count.
    pub(super) taken: usize,
    pub(super) started: bool,
    /// The belief at the first sample; none: at rest.
    start: Option<Gaussian>,
    /// Whether entries of that are correlated.
    correlated: bool,
}

impl ParticleFilter {
    /// A filter that starts from rest at its first sample.
    ///
    /// # Errors
    /// Settings out of range or that do not fit the model.
    pub fn new(model: JerkDriven, settings: ParticleSettings, marginalised: Marginalised) -> Result<Self, DesignError> {
        let jerk = model.jerk_model();
        settings.check(jerk, marginalised)?;
        let (n, m, d) = (jerk.joints(), jerk.channels(), jerk.states());
        let past = Past::new(&model);
        // Where sensors are late, biases are not independent of each other given the path.
        let marginalised = match marginalised {
            Marginalised::Biases if !past.is_empty() => Marginalised::Nothing,
            other => other,
        };
        let guard = Guard::new(&model, &settings)?;
        let model = model.without_late();
        let jerk = model.jerk_model();
        let sample = ParticleSample {
            past,
            seed: settings.seed,
            step: 0,
            dt: 0.0,
            jerk: vec![0.0; n],
            dtheta: vec![f64::NAN; n],
            factors: vec![[[0.0; 3]; 3]; n],
            readings: Vec::with_capacity(m),
            walks: Vec::with_capacity(m),
            decays: Vec::with_capacity(m),
            draws: 3 * n,
            offset: 0.0,
            proposal: settings.proposal,
            limits: settings.limits.clone(),
        };
        Ok(Self {
            belief: Gaussian::independent(&vec![0.0; d]),
            cloud: Cloud::new(jerk, marginalised, settings.particles)?,
            sample,
            guard,
            shared: Shared::new(jerk),
            sharing: false,
            motion: (marginalised == Marginalised::Accelerations).then(|| ProcessNoise::new(jerk)),
            bias_variance: vec![0.0; m],
            summary: Summary::new(jerk, settings.particles),
            wanted: Moments::new(d),
            found: Moments::new(d),
            ancestors: vec![0; settings.particles],
            tool: Tool::new(model.robot()),
            memory: Vec::with_capacity(model.memory()),
            threads: settings.particles >= PARALLEL,
            taken: 0,
            started: false,
            start: None,
            correlated: false,
            marginalised,
            settings,
            model,
        })
    }

    /// From now on a first sample finds this belief; none: the robot at rest.
    ///
    /// # Errors
    /// A belief of another number of states.
    pub fn set_start(&mut self, start: Option<Gaussian>) -> Result<(), DesignError> {
        self.guard.kalman.set_start(start.clone())?;
        self.correlated = start.as_ref().is_some_and(|start| start.covariance.is_correlated());
        self.start = start;
        Ok(())
    }

    /// Forgets the state: the next sample starts anew.
    pub fn reset(&mut self) {
        (self.taken, self.started) = (0, false);
        self.guard.reset();
    }

    /// Whether it has taken a sample.
    pub fn is_started(&self) -> bool {
        self.started
    }

    /// The row of an estimate that belongs to the last sample, written into the first of `out`.
    pub fn report_into(&mut self, out: &mut FilterOutput) {
        out.write_cloud(0, self);
    }

    /// The model.
    pub fn model(&self) -> &JerkDriven {
        &self.model
    }

    /// What was found at the last sample.
    pub fn summary(&self) -> &Summary {
        &self.summary
    }

    /// Takes one sample: moves the particles, weighs them by its readings, and resamples where few carry all weight.
    ///
    /// # Errors
    /// A sample that cannot be used, or a first one from which the model cannot start: the state stays as it was. No particle
    /// that explains the readings, if that is to stop it: a next sample goes on as if they had been missing.
    /// [`RunError::NotFinite`]: readings so absurd that nothing is left; the next sample starts anew.
    pub fn step(&mut self, sample: KalmanSample<'_>) -> Result<(), RunError> {
        sample.check(&self.model)?;
        self.take(sample)?;
        let sample = self.taken - 1;
        if !self.is_finite() {
            self.reset();
            return Err(RunError::NotFinite { sample });
        }
        Ok(())
    }

    /// Whether the cloud still has a mean.
    fn is_finite(&self) -> bool {
        self.summary.mean.iter().all(|x| x.is_finite())
    }

    /// [`step`](Self::step) with a sample that has been checked.
    fn take(&mut self, sample: KalmanSample<'_>) -> Result<(), RunError> {
        // 1. Resample. At the start of a sample and not at its end, so that estimates come from the weighted cloud: a
        // choice at random only adds variance to them (Liu and Chen 1998). The Kalman filter is still at the same sample.
        self.resample_if_due();
        // Then it goes ahead: its likelihood is what the cloud's is held against at the end.
        self.guard.step(sample, &mut self.sample.past)?;
        if !self.started {
            self.sample.past.clear(); // sensors have settled: what they see and what they hold is the same
        }
        if self.started {
            // 2. Where the cloud is expected, which is where channels are linearised for all that particles share.
            JerkDriven::predict_phase(Predict { model: &mut self.model, sample: &sample, belief: &mut self.belief });
        } else {
            self.start(&sample)?;
        }
        // 3. What is the same for all particles: factors of the process noise, readings and their densities, biases.
        self.prepare(&sample);
        if !self.started {
            self.initialise();
        }
        // 4. Move and weigh: each particle draws its increment from the proposal, and its weight changes by
        //    p(y | x) p(x | x⁻) / q(x | x⁻, y) (Doucet, Godsill and Andrieu 2000).
        self.share();
        self.advance();
        // 5. Mean, covariance and likelihood; and judgement. A cloud without any weight left takes another way.
        if self.summarise() {
            self.guard()?;
        } else {
            self.recover()?;
        }
        if !self.started && self.correlated {
            self.correlate();
        }
        self.started = true;
        self.taken += 1;
        Ok(())
    }

    /// The belief at a first sample: given, or at rest; and what marginalised biases begin with.
    fn start(&mut self, sample: &KalmanSample<'_>) -> Result<(), DesignError> {
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
    fn initialise(&mut self) {
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
    fn prepare(&mut self, sample: &KalmanSample<'_>) {
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
    fn share(&mut self) {
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

    /// Every block to this sample, on all cores where that pays: [`Propagate`], or its sibling that marginalises
    /// accelerations.
    fn advance(&mut self) {
        let Self { model, sample, shared, sharing, motion, cloud, threads, .. } = self;
        let (model, sample, level) = (model.jerk_model(), &*sample, simd::level());
        // Accelerations marginalised: a Kalman filter in each particle, positions and velocities drawn.
        if let Some(motion) = &*motion {
            cloud.each(*threads, |block| {
                simd::dispatch_lanes(level, rao_blackwell::PropagateMarginalised { model, sample, motion, block });
            });
            return;
        }
        let shared = sharing.then_some(&*shared);
        cloud.each(*threads, |block| simd::dispatch_lanes(level, Propagate { model, sample, shared, block }));
    }

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

    /// Filters a recording, `count` rows; goes on from where it was, so that it may come in pieces.
    ///
    /// # Errors
    /// As [`step`](Self::step), wrong lengths, or a sample after which the estimate is not finite.
    pub fn run(&mut self, recording: KalmanRecording<'_>, keep: Keep) -> Result<ParticleOutput, RunError> {
        self.run_with(recording, keep, |_| {})
    }

    /// [`run`](Self::run), calling `after` at each sample.
    pub(super) fn run_with(
        &mut self,
        recording: KalmanRecording<'_>,
        keep: Keep,
        mut after: impl FnMut(&mut Self),
    ) -> Result<ParticleOutput, RunError> {
        self.model.check(&recording)?;
        let count = recording.dt.len();
        let mut out = ParticleOutput::zeros(count, self, keep)?;
        let watch = Watch::current();
        for i in 0..count {
            // Resample, move, weigh, judge: see `take`.
            let done = self.take(recording.sample(i, &self.model));
            // Blocks are left out once it is to stop, and then the sample is not a whole one.
            if watch.stops() {
                return Err(RunError::Interrupted { sample: i });
            }
            done?;
            if !self.is_finite() {
                return Err(RunError::NotFinite { sample: self.taken - 1 });
            }
            out.report(i, self, keep);
            after(self);
        }
        out.links.findings.extend_from_slice(self.guard.kalman.findings());
        Ok(out)
    }

    /// Runs each recording from a fresh start with the settings of its filter, on all cores.
    pub fn run_each(jobs: &[(&Self, KalmanRecording<'_>)], keep: Keep) -> Vec<Result<ParticleOutput, RunError>> {
        Self::each(jobs, |filter, recording| filter.run(recording, keep))
    }

    /// `one` with a new filter for each recording, on all cores.
    pub(super) fn each(
        jobs: &[(&Self, KalmanRecording<'_>)],
        one: impl Fn(&mut Self, KalmanRecording<'_>) -> Result<ParticleOutput, RunError> + Sync,
    ) -> Vec<Result<ParticleOutput, RunError>> {
        parallel::map(jobs, |&(like, recording)| {
            // New, not cloned: a cloud is large, and this one's particles are none of the recording's business.
            let model = like.guard.kalman.model().clone();
            let mut filter = Self::new(model, like.settings.clone(), like.marginalised)?;
            filter.set_start(like.start.clone())?;
            one(&mut filter, recording)
        })
    }
}
