//! The particle filter, a sample at a time.

use super::cloud::Cloud;
use super::guard::Guard;
use super::output::Summary;
use super::past::Past;
use super::process_noise::ProcessNoise;
use super::proposal::Propagate;
use super::rao_blackwell;
use super::regularise::Moments;
use super::sample::ParticleSample;
use super::settings::{Marginalised, ParticleSettings};
use super::shared::Shared;
use crate::check::{are_sound, expect};
use crate::error::{DesignError, RunError};
use crate::estimate::kalman::{FilterOutput, Gaussian, JerkDriven, KalmanSample, Model, Phases, Predict, Tool};
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
    pub(super) shared: Shared,
    /// Whether the shared linearisation is that of each particle.
    pub(super) sharing: bool,
    /// There where accelerations are marginalised.
    pub(super) motion: Option<ProcessNoise>,
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
    pub(super) start: Option<Gaussian>,
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
        let more = jerk.dense() - 3 * jerk.joints();
        expect(
            more == 0,
            "disturbances",
            more as f64,
            "0 torques and wrenches from outside in the state of a particle",
        )?;
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

    /// Resets the filter: the next sample starts from the beginning.
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
    /// [`RunError::NotFinite`]: readings so extreme that the state is not finite; the next sample restarts.
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
    pub(super) fn is_finite(&self) -> bool {
        are_sound(&self.summary.mean)
    }

    /// [`step`](Self::step) with a sample that has been checked.
    pub(super) fn take(&mut self, sample: KalmanSample<'_>) -> Result<(), RunError> {
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
}
