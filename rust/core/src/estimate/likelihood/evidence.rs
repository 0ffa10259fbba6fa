//! The likelihood of a recording, its gradient and its information.

use super::evaluation::ParametricMeasurement;
use super::filter::{Filter, SequentialInnovation};
use super::instants::{SampledLag, instants};
use super::parameters::{Parameter, Parameters};
use super::recording::LikelihoodRecording;
use crate::check::{expect, expect_length};
use crate::error::{DesignError, RunError};
use crate::estimate::kalman::{JerkModel, JerkNoise};
use crate::estimate::measurement::Kind;
use crate::interrupt::Watch;
use crate::memory::filled;
use crate::parallel;
use crate::robot::Robot;
use crate::scalar::{Dual, Scalar, log};
use std::sync::Arc;

/// Derivatives that one pass through a recording carries.
const DIRECTIONS: usize = 4;
/// Instants between two exchanges of derivatives: what bounds memory.
const STRETCH: usize = 1024;

/// How a recording is looked at.
#[derive(Clone, Debug)]
pub struct LikelihoodSettings {
    /// Standard deviations; channels are motor positions, accelerometer axes and, where they are used, motor torques.
    pub noise: JerkNoise,
    /// Which channels have a bias that is a state.
    pub biased: Vec<bool>,
    /// Whether motor torques are readings, too.
    pub torque: bool,
    /// Parameters that are not free, and not as the robot says.
    pub fixed: Vec<(Parameter, f64)>,
    /// Beyond this many standard deviations an innovation counts linearly (Huber 1964); infinite for the plain likelihood.
    pub huber: f64,
}

/// What a recording says about parameters.
#[derive(Clone, Debug, Default)]
pub struct Evidence {
    /// Logarithm of the recording's density, Huber's where asked for.
    pub log_likelihood: f64,
    /// Its derivatives (p).
    pub gradient: Vec<f64>,
    /// Σ ∂ν ∂νᵀ/s + ½ ∂ln s ∂ln sᵀ over innovations ν of variance s (p × p): Fisher's information along the recording.
    pub information: Vec<f64>,
    /// Each sample's part of the log-likelihood (count); empty unless asked for.
    pub densities: Vec<f64>,
    /// Each sample's part of the gradient (count × p); empty unless asked for.
    pub scores: Vec<f64>,
    /// Innovations over their standard deviations (count × channels), NaN where missing; empty unless asked for.
    pub innovations: Vec<f64>,
    /// Readings used.
    pub used: usize,
}

/// The likelihood of one recording of one robot.
///
/// ```
/// use linkside_core::estimate::kalman::JerkNoise;
/// use linkside_core::estimate::likelihood::{Likelihood, LikelihoodRecording, LikelihoodSettings, Parameter};
///
/// let robot = std::sync::Arc::new(linkside_core::demo::arm()?);
/// let settings = LikelihoodSettings {
///     noise: JerkNoise {
///         jerk: vec![100.0],
///         link_walk: vec![0.0; 2],
///         reading: vec![1e-5, 0.05, 0.05, 0.05],
///         torsion: 0.0,
///         bias_walk: vec![0.0; 4],
///         bias_time: vec![f64::INFINITY; 4],
///         initial: vec![1e-3, 1e-3, 1.0],
///         initial_bias: vec![0.0; 4],
///     },
///     biased: vec![false; 4],
///     torque: false,
///     fixed: vec![],
///     huber: f64::INFINITY,
/// };
/// // 0.2 s at rest, one row a sample.
/// let recording = LikelihoodRecording {
///     t: (0..200).map(|i| 1e-3 * f64::from(i)).collect(),
///     theta: vec![0.1; 200],
///     dtheta: vec![f64::NAN; 200],
///     ddtheta: vec![],
///     tau: vec![],
///     acceleration: [0.0, 0.0, 9.81].repeat(200),
///     jerk: vec![0.0; 200],
///     period: 1e-3,
/// };
/// let likelihood = Likelihood::new(robot, settings, recording)?;
/// let evidence = likelihood.evaluate(&[Parameter::SensorBias(0, 0)], &[0.01], false)?;
/// // The sensor reads zero where it would read its bias of 0.01: the gradient points back to zero.
/// assert!(evidence.gradient[0] < 0.0);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct Likelihood {
    /// Channels and biases.
    model: JerkModel,
    /// Noise, what is fixed, and Huber's limit.
    settings: LikelihoodSettings,
    recording: LikelihoodRecording,
}

impl Likelihood {
    /// Of `recording`, whose accelerometers are those of `robot`.
    ///
    /// # Errors
    /// Noise or arrays that do not fit, a Huber limit that is not positive.
    pub fn new(
        robot: Arc<Robot>,
        settings: LikelihoodSettings,
        recording: LikelihoodRecording,
    ) -> Result<Self, DesignError> {
        expect(settings.huber > 0.0, "huber", settings.huber, "greater than 0")?;
        recording.check(&robot, settings.torque)?;
        let kinds: &[_] = if settings.torque {
            &[Kind::Motor, Kind::Acceleration, Kind::Torque]
        } else {
            &[Kind::Motor, Kind::Acceleration]
        };
        let model = JerkModel::new(robot, kinds, &settings.biased)?;
        model.check(&settings.noise)?;
        Ok(Self { model, settings, recording })
    }

    /// Number of samples.
    pub fn len(&self) -> usize {
        self.recording.len()
    }

    /// Whether there is no sample; never true.
    pub fn is_empty(&self) -> bool {
        self.recording.is_empty()
    }

    /// Number of channels.
    pub fn channels(&self) -> usize {
        self.model.channels()
    }

    /// At `values` of `parameters`, what is not among them being as the robot says; `detail` keeps scores and
    /// innovations.
    ///
    /// Forward mode, four parameters a pass, the passes on all cores: O(p) times the filter. The result does not
    /// depend on the number of threads.
    ///
    /// # Errors
    /// A parameter that the robot does not have; parameters under which the filter breaks down.
    pub fn evaluate(&self, parameters: &[Parameter], values: &[f64], detail: bool) -> Result<Evidence, RunError> {
        expect_length("values", values.len(), parameters.len())?;
        let chunks = parameters.len().div_ceil(DIRECTIONS).max(1);
        let filters: Result<Vec<Filter<Dual<DIRECTIONS>>>, _> =
            (0..chunks).map(|c| self.filter(parameters, values, c * DIRECTIONS)).collect();
        self.accumulate(filters?, parameters.len(), detail)
    }

    /// The log-likelihood alone.
    ///
    /// # Errors
    /// As of [`evaluate`](Self::evaluate).
    pub fn log_likelihood(&self, parameters: &[Parameter], values: &[f64]) -> Result<f64, RunError> {
        let filter: Filter<f64> = self.filter(parameters, values, parameters.len())?;
        Ok(self.accumulate(vec![filter], 0, false)?.log_likelihood)
    }

    /// The filter whose derivatives are those in the parameters from `first` on.
    fn filter<T: Seeded>(&self, free: &[Parameter], values: &[f64], first: usize) -> Result<Filter<T>, DesignError> {
        let mut robot = Robot::clone(&self.model.robot);
        let mut parameters = Parameters::<T>::of(&robot);
        let mut late = vec![false; robot.accelerometers.len()];
        let mut filtered = late.clone();
        let fixed = self.settings.fixed.iter().map(|&(parameter, value)| (parameter, value, usize::MAX));
        let free = free.iter().zip(values).enumerate().map(|(i, (&p, &value))| (p, value, i.wrapping_sub(first)));
        for (parameter, value, direction) in fixed.chain(free) {
            let slot = parameters.slot(parameter).filter(|_| !parameter.of_response());
            *slot.ok_or(DesignError::NoParameter { parameter: format!("{parameter:?}") })? =
                T::seeded(value, direction);
            match parameter {
                Parameter::Stiffness(j) => robot.drives[j].stiffness = value,
                Parameter::CubicStiffness(j) => robot.drives[j].cubic_stiffness = value,
                _ => {}
            }
            if let Parameter::TimeConstant(s) | Parameter::Delay(s) = parameter {
                late[s] = true;
                filtered[s] |= matches!(parameter, Parameter::TimeConstant(_));
            }
        }
        let period = self.recording.period;
        let lateness: Vec<_> =
            parameters.sensors.iter().zip(&filtered).map(|(s, &f)| SampledLag::of(s, period, f)).collect();
        let lags: Vec<_> = lateness.iter().zip(&late).map(|(l, &late)| late.then(|| l.lag.value())).collect();
        let instants = instants(&self.recording.t, &lags);
        let noise = &self.settings.noise;
        let evaluation =
            ParametricMeasurement::new(&self.model, Arc::new(robot), noise.clone(), parameters, lateness, late);
        Ok(Filter::new(&self.model, noise.clone(), evaluation, instants))
    }

    /// The filters side by side, stretch by stretch, each with the derivatives in its own parameters; sums of all
    /// readings.
    fn accumulate<T: Seeded>(&self, mut filters: Vec<Filter<T>>, p: usize, detail: bool) -> Result<Evidence, RunError> {
        let (count, channels) = (self.recording.len(), self.model.channels());
        let mut evidence = Evidence {
            gradient: vec![0.0; p],
            information: vec![0.0; p * p],
            densities: filled(0.0, if detail { count } else { 0 }, 1)?,
            scores: filled(0.0, if detail { count } else { 0 }, p)?,
            innovations: filled(f64::NAN, if detail { count } else { 0 }, channels)?,
            ..Evidence::default()
        };
        let recording = &self.recording;
        let mut slopes = [vec![0.0; p], vec![0.0; p]];
        let watch = Watch::current();
        for stretch in 0..filters[0].stretches(STRETCH) {
            parallel::each(filters.iter_mut().collect(), |filter| filter.advance(recording, STRETCH));
            if watch.stops() {
                return Err(RunError::Interrupted { sample: stretch * STRETCH });
            }
            for i in 0..filters[0].innovations.len() {
                for (k, (value, variance)) in slopes_of(&filters, i).take(p).enumerate() {
                    (slopes[0][k], slopes[1][k]) = (value, variance);
                }
                self.add(&mut evidence, &filters[0].innovations[i], &slopes)?;
            }
        }
        Ok(evidence)
    }

    /// Adds one innovation ν of variance s, ½ρ(ν²/s) + ½ ln 2πs.
    fn add<T: Seeded>(
        &self,
        evidence: &mut Evidence,
        innovation: &SequentialInnovation<T>,
        [by_value, by_variance]: &[Vec<f64>; 2],
    ) -> Result<(), RunError> {
        let (value, variance) = (innovation.value.value(), innovation.variance.value());
        let square = value * value / variance;
        if !(square.is_finite() && variance > 0.0) {
            return Err(RunError::NotFinite { sample: innovation.row });
        }
        let (limit, size, p) = (self.settings.huber, square.sqrt(), by_value.len());
        let outlying = size > limit;
        let (loss, weight) = if outlying { (limit * (2.0 * size - limit), limit / size) } else { (square, 1.0) };
        let density = -0.5 * (loss + log(core::f64::consts::TAU * variance));
        evidence.log_likelihood += density;
        if let Some(slot) = evidence.densities.get_mut(innovation.row) {
            *slot += density;
        }
        evidence.used += 1;
        for k in 0..p {
            let relative = by_variance[k] / variance;
            let score = -0.5 * (weight * (2.0 * value * by_value[k] / variance - square * relative) + relative);
            evidence.gradient[k] += score;
            if let Some(slot) = evidence.scores.get_mut(innovation.row * p + k) {
                *slot += score;
            }
            for l in 0..=k {
                let mean = weight * by_value[k] * by_value[l] / variance;
                let spread = 0.5 * weight * relative * by_variance[l] / variance;
                evidence.information[k * p + l] += mean + spread;
                if l < k {
                    evidence.information[l * p + k] += mean + spread;
                }
            }
        }
        let at = innovation.row * self.model.channels() + innovation.channel;
        if let Some(slot) = evidence.innovations.get_mut(at) {
            *slot = value / variance.sqrt();
        }
        Ok(())
    }
}

/// The derivatives of innovation `i` and of its variance, over all passes.
fn slopes_of<T: Seeded>(filters: &[Filter<T>], i: usize) -> impl Iterator<Item = (f64, f64)> {
    filters.iter().flat_map(move |filter| {
        let SequentialInnovation { value, variance, .. } = &filter.innovations[i];
        value.slopes().iter().copied().zip(variance.slopes().iter().copied())
    })
}

/// A scalar that may carry derivatives.
trait Seeded: Scalar {
    /// `value`, varying along `direction` where there is such a direction.
    fn seeded(value: f64, direction: usize) -> Self;
    /// Its value.
    fn value(&self) -> f64;
    /// Its derivatives.
    fn slopes(&self) -> &[f64];
}

impl Seeded for f64 {
    fn seeded(value: f64, _: usize) -> Self {
        value
    }

    fn value(&self) -> f64 {
        *self
    }

    fn slopes(&self) -> &[f64] {
        &[]
    }
}

impl<const N: usize> Seeded for Dual<N> {
    fn seeded(value: f64, direction: usize) -> Self {
        if direction < N { Self::variable(value, direction) } else { Self::constant(value) }
    }

    fn value(&self) -> f64 {
        self.value
    }

    fn slopes(&self) -> &[f64] {
        &self.gradient
    }
}
