//! The extended Kalman filter, sample by sample.

use super::consider::Consider;
use super::correction::Correction;
use super::driven::JerkDriven;
use super::effect::Step;
use super::findings::Finding;
use super::gaussian::{Gaussian, Symmetric};
use super::loss::{NoiseLoss, SensorLosses};
use super::monitor::Monitor;
use super::output::Tool;
use super::path::StatePath;
use super::phases::Phases;
use super::sigma_points::SigmaRule;
use crate::check::{expect, expect_length};
use crate::error::DesignError;
use crate::linear;
use crate::memory::filled;
use std::sync::Arc;

/// A sample's measurement is linearised no more often than this.
pub const MOST_ITERATIONS: usize = 100;

/// What a filter does beyond the textbook.
#[derive(Clone, Copy, Debug)]
pub struct FilterSettings {
    /// A channel whose innovation exceeds this many standard deviations is left out at that sample.
    pub gate: Option<f64>,
    /// How often the measurement is linearised, each time at the estimate of the time before; 1 is the plain update.
    pub iterations: usize,
}

/// How a sample's readings fitted what was predicted.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Fit {
    /// Readings used.
    pub(crate) used: u32,
    /// Logarithm of their probability density.
    pub(crate) log_likelihood: f64,
}

/// Kalman filter with exact derivatives; a step allocates nothing.
///
/// All readings of a sample are used by one factor, without a matrix inverse; one that is missing is a row of zeros.
///
/// ```
/// use linkside_core::estimate::kalman::{
///     ExtendedKalmanFilter, FilterSettings, Inputs, JerkDriven, JerkModel, JerkNoise, KalmanSample,
/// };
/// use linkside_core::estimate::measurement::Kind;
///
/// // The jerk-driven model: the state is (q, q̇, q̈), motor positions and accelerometers measure it.
/// let robot = std::sync::Arc::new(linkside_core::demo::arm()?);
/// let model = JerkModel::new(robot, &[Kind::Motor, Kind::Acceleration], &[false; 4])?;
/// let noise = JerkNoise {
///     jerk: vec![100.0],
///     link_walk: vec![0.0; 2],
///     reading: vec![1e-5, 0.05, 0.05, 0.05],
///     torsion: 1e-3,
///     bias_walk: vec![0.0; 4],
///     bias_time: vec![f64::INFINITY; 4],
///     initial: vec![1e-4, 1e-3, 0.1],
///     initial_bias: vec![0.0; 4],
/// };
/// let settings = FilterSettings { gate: None, iterations: 1 };
/// let mut filter = ExtendedKalmanFilter::new(JerkDriven::new(model, noise, false)?, settings)?;
///
/// // In a control loop: once a sample, NaN for a reading that is missing.
/// let inputs = Inputs { jerk: &[0.0], dtheta: &[f64::NAN], ..Inputs::default() };
/// for acceleration in [[0.0, 0.0, 9.81], [f64::NAN; 3], [0.0, 0.0, 9.81]] {
///     let [x, y, z] = acceleration;
///     filter.step(KalmanSample { dt: 1e-3, readings: &[0.1, x, y, z], inputs })?;
/// }
/// let belief = filter.belief();
/// assert!((belief.mean[0] - 0.1).abs() < 1e-9 && belief.covariance.at(0, 0).sqrt() < 1e-5);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct ExtendedKalmanFilter<M> {
    /// Process and measurement, with what they keep from one sample to the next.
    pub(super) model: M,
    /// Gate and number of iterations.
    pub(super) settings: FilterSettings,
    /// Mean and covariance: predicted between the two halves of a step, corrected after it.
    pub(super) belief: Gaussian,
    /// The belief before a sample's readings, for iterations to begin from.
    pub(super) prior: Gaussian,
    /// Scratch and outcome of the last measurement update.
    pub(super) correction: Correction,
    /// Sensitivities to parameters that are known to a tolerance; none where nothing is uncertain.
    pub(super) consider: Option<Consider>,
    /// The judge of innovations; none where it was switched off.
    pub(super) monitor: Option<Monitor>,
    /// Kinematics of the tool centre point, for its standard deviations.
    pub(super) tool: Tool,
    /// What the model remembers of the last sample, for the row of an estimate.
    pub(super) memory: Vec<f64>,
    /// Samples taken, for messages.
    pub(super) taken: usize,
    pub(super) started: bool,
    /// The belief at the first sample; none: at rest.
    pub(super) start: Option<Gaussian>,
    /// What errors of each sensor's readings cost.
    pub(super) sensors: SensorLosses,
    /// Where to linearise; none: at its own estimates.
    pub(super) path: Option<Arc<StatePath>>,
}

impl ExtendedKalmanFilter<JerkDriven> {
    /// Goes on from another belief of the model's own states, late sensors having settled.
    pub(crate) fn restart(&mut self, belief: &Gaussian) {
        self.reset();
        self.belief.begin_with(belief);
        self.model.settle(&mut self.belief);
        self.linearise();
        if let Some(consider) = &mut self.consider {
            consider.start(&mut self.model);
        }
        self.started = true;
    }
}

impl<M: Phases> ExtendedKalmanFilter<M> {
    /// A filter that starts from rest at its first sample.
    ///
    /// # Errors
    /// A gate or a number of iterations out of range.
    pub fn new(model: M, settings: FilterSettings) -> Result<Self, DesignError> {
        let gate = settings.gate.unwrap_or(f64::INFINITY);
        expect(gate > 0.0, "gate", gate, "a positive number of standard deviations")?;
        let iterations = settings.iterations;
        expect((1..=MOST_ITERATIONS).contains(&iterations), "iterations", iterations as f64, "1 to 100")?;
        let belief = Gaussian::independent(&vec![0.0; model.states()]);
        Ok(Self {
            prior: belief.clone(),
            correction: Correction::new(&model, belief.covariance.stride),
            consider: Consider::new(&model),
            monitor: Some(Monitor::new(&model)),
            tool: Tool::new(model.robot()),
            memory: Vec::with_capacity(model.memory()),
            taken: 0,
            started: false,
            start: None,
            sensors: SensorLosses::of_squares(&model),
            path: None,
            belief,
            model,
            settings,
        })
    }

    /// From now on a first sample finds this belief; none: the robot at rest.
    ///
    /// # Errors
    /// A belief of another number of states.
    pub fn set_start(&mut self, start: Option<Gaussian>) -> Result<(), DesignError> {
        if let Some(start) = &start {
            expect_length("start", start.mean.len(), self.model.own_states())?;
        }
        self.start = start;
        Ok(())
    }

    /// From now on goes by values at sigma points in place of derivatives: it is then the unscented or the cubature Kalman filter
    /// (S. J. Julier and J. K. Uhlmann 2004; I. Arasaratnam and S. Haykin 2009), and with several
    /// [`iterations`](FilterSettings::iterations) the iterated posterior linearisation (Á. F. García-Fernández et al. 2015). A
    /// [`Smoother`](super::Smoother) of it is the unscented or the cubature one (S. Särkkä 2008).
    ///
    /// None: by derivatives. Sensors that are late are predicted by derivatives in any case.
    pub fn set_points(&mut self, rule: Option<SigmaRule>) {
        self.model.set_points(rule);
    }

    /// From now on errors of readings cost this (channels); the sensor's first channel counts for all of its axes.
    ///
    /// A sensor's noise is then divided by how much its readings count, given the estimate that they lead to: the variational
    /// update (G. Agamennoni, J. I. Nieto and E. M. Nebot 2012), at a few times the cost of a plain one.
    ///
    /// # Errors
    /// Not one a channel.
    pub fn set_losses(&mut self, losses: &[NoiseLoss]) -> Result<(), DesignError> {
        self.sensors = SensorLosses::new(&self.model, losses)?;
        Ok(())
    }

    /// From now on linearises at these leading states, one row a sample, and not at its own estimates; further states are
    /// taken to be zero there.
    ///
    /// The covariance, which then depends on no reading's value, is the Cramér–Rao bound along that trajectory (P. Tichavský,
    /// C. H. Muravchik and A. Nehorai 1998); a [`Smoother`] of this filter has that by all readings.
    ///
    /// # Errors
    /// Rows of more states than the model has, or no whole number of rows.
    pub fn linearise_along(&mut self, leading: &[f64], width: usize) -> Result<(), DesignError> {
        let (states, channels) = (self.model.states(), self.model.channels());
        expect(
            (1..=states).contains(&width),
            "states of a trajectory",
            width as f64,
            "as many as the model has, or fewer",
        )?;
        expect_length("trajectory", leading.len(), leading.len() / width * width)?;
        let mut means = filled(0.0, leading.len() / width, states)?;
        for (own, row) in means.chunks_exact_mut(states).zip(leading.chunks_exact(width)) {
            own[..width].copy_from_slice(row);
        }
        let weights = filled(1.0, leading.len() / width, channels)?;
        self.path = Some(Arc::new(StatePath { states, channels, means, weights }));
        Ok(())
    }

    /// From now on linearises at this path, and weighs readings as it says.
    pub(super) fn set_path(&mut self, path: Option<Arc<StatePath>>) {
        self.path = path;
    }

    /// Resets the filter: the next sample starts from the beginning.
    pub fn reset(&mut self) {
        self.taken = 0;
        self.started = false;
        self.correction.reset_weights();
        if let Some(consider) = &mut self.consider {
            consider.reset();
        }
        if let Some(monitor) = &mut self.monitor {
            monitor.reset();
        }
    }

    /// Whether innovations are judged as they come; they are unless this says no.
    pub fn watch(&mut self, watch: bool) {
        self.monitor = watch.then(|| Monitor::new(&self.model));
    }

    /// Contradictions between readings and model since the start.
    pub fn findings(&self) -> &[Finding] {
        self.monitor.as_ref().map_or(&[], |monitor| &monitor.findings.list)
    }

    /// Goes by these faults from now on, and looks for no others.
    pub(super) fn follow(&mut self, steps: &[Step]) {
        if let Some(monitor) = &mut self.monitor {
            monitor.follow(steps);
        }
    }

    /// Samples taken.
    pub(super) fn taken(&self) -> u64 {
        self.taken as u64
    }

    /// Whether it has taken a sample.
    pub fn is_started(&self) -> bool {
        self.started
    }

    /// The model.
    pub fn model(&self) -> &M {
        &self.model
    }

    /// The belief after the last sample.
    pub fn belief(&self) -> &Gaussian {
        &self.belief
    }

    /// How the last sample's readings fitted.
    pub(crate) fn fit(&self) -> Fit {
        let Correction { used, log_likelihood, .. } = self.correction;
        Fit { used, log_likelihood }
    }

    /// Covariance of the state after the last sample, with what the parameters' tolerances add to it.
    pub fn covariance(&self) -> Symmetric {
        let mut covariance = self.belief.covariance.clone();
        if let Some(mut consider) = self.consider.clone() {
            let states = self.belief.mean.len();
            consider.sum_up(states);
            for (row, more) in covariance.data.chunks_exact_mut(covariance.stride).zip(consider.total.chunks(states)) {
                linear::add_scaled(row, 1.0, more);
            }
        }
        covariance
    }

    /// As [`covariance`](Self::covariance), row-major (states × states), into memory that is there.
    ///
    /// # Errors
    /// Another length.
    pub fn covariance_into(&mut self, out: &mut [f64]) -> Result<(), DesignError> {
        let states = self.belief.mean.len();
        expect_length("covariance", out.len(), states * states)?;
        for (own, row) in
            out.chunks_exact_mut(states).zip(self.belief.covariance.data.chunks_exact(self.belief.covariance.stride))
        {
            own.copy_from_slice(&row[..states]);
        }
        if let Some(consider) = &mut self.consider {
            consider.sum_up_apart(states);
            linear::add_scaled(out, 1.0, &consider.total[..states * states]);
        }
        Ok(())
    }

    /// This filter without what tolerances add.
    pub(crate) fn without_tolerances(&self) -> Self {
        Self { consider: None, ..self.clone() }
    }

    /// What the parameters' tolerances add to the covariance of the first `rows` states after the last sample.
    pub(crate) fn considered(&mut self, rows: usize) -> Option<&[f64]> {
        self.consider.as_mut().map(|consider| {
            consider.sum_up(rows);
            &consider.total[..rows * rows]
        })
    }

    /// What the readings so far say of the parameters: their errors, in the measure of their tolerances, and the
    /// standard deviations of these.
    pub fn parameters(&self) -> (Vec<f64>, Vec<f64>) {
        self.consider.as_ref().map(Consider::parameters).unwrap_or_default()
    }

    /// See [`Status`](crate::estimate::Status).
    pub fn status(&self) -> u8 {
        self.correction.status
    }
}
