//! The likelihood of a recording.

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
use crate::robot::Robot;
use crate::scalar::log;
use std::sync::Arc;

/// Instants whose innovations are kept at a time: what bounds memory.
const STRETCH: usize = 1024;

/// How a recording is looked at.
#[derive(Clone, Debug)]
pub struct LikelihoodSettings {
    /// Standard deviations; channels are motor positions and accelerometer axes.
    pub noise: JerkNoise,
    /// Which channels have a bias that is a state.
    pub biased: Vec<bool>,
    /// Parameters that are not free, and not as the robot says.
    pub fixed: Vec<(Parameter, f64)>,
    /// Beyond this many standard deviations an innovation counts linearly (Huber 1964); infinite for the plain likelihood.
    pub huber: f64,
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
///     fixed: vec![],
///     huber: f64::INFINITY,
/// };
/// // 0.2 s at rest, one row a sample.
/// let recording = LikelihoodRecording {
///     t: (0..200).map(|i| 1e-3 * f64::from(i)).collect(),
///     theta: vec![0.1; 200],
///     dtheta: vec![f64::NAN; 200],
///     acceleration: [0.0, 0.0, 9.81].repeat(200),
///     jerk: vec![0.0; 200],
///     period: 1e-3,
/// };
/// let likelihood = Likelihood::new(robot, settings, recording)?;
/// let biased = |bias| likelihood.log_likelihood(&[Parameter::SensorBias(0, 0)], &[bias]);
/// // The sensor reads zero: a bias of 0.01 is less likely than none.
/// assert!(biased(0.01)? < biased(0.0)?);
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
        recording.check(&robot)?;
        let model = JerkModel::new(robot, &[Kind::Motor, Kind::Acceleration], &settings.biased)?;
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

    /// At `values` of `parameters`, what is not among them being as the robot says.
    ///
    /// # Errors
    /// A parameter that the robot does not have; parameters under which the filter breaks down.
    pub fn log_likelihood(&self, parameters: &[Parameter], values: &[f64]) -> Result<f64, RunError> {
        Ok(self.densities(parameters, values)?.iter().sum())
    }

    /// Each sample's part of the log-likelihood (count).
    ///
    /// # Errors
    /// As of [`log_likelihood`](Self::log_likelihood).
    pub fn densities(&self, parameters: &[Parameter], values: &[f64]) -> Result<Vec<f64>, RunError> {
        expect_length("values", values.len(), parameters.len())?;
        let mut filter = self.filter(parameters, values)?;
        let mut densities = filled(0.0, self.recording.len(), 1)?;
        let watch = Watch::current();
        for stretch in 0..filter.stretches(STRETCH) {
            filter.advance(&self.recording, STRETCH);
            if watch.stops() {
                return Err(RunError::Interrupted { sample: stretch * STRETCH });
            }
            for innovation in &filter.innovations {
                densities[innovation.row] += self.density(innovation)?;
            }
        }
        Ok(densities)
    }

    /// The filter of a robot with these parameters.
    fn filter(&self, free: &[Parameter], values: &[f64]) -> Result<Filter, DesignError> {
        let mut robot = Robot::clone(&self.model.robot);
        let mut parameters = Parameters::<f64>::of(&robot);
        let mut late = vec![false; robot.accelerometers.len()];
        let mut filtered = late.clone();
        let free = free.iter().copied().zip(values.iter().copied());
        for (parameter, value) in self.settings.fixed.iter().copied().chain(free) {
            let slot = parameters.slot(parameter).filter(|_| !parameter.of_response());
            *slot.ok_or(DesignError::NoParameter { parameter: format!("{parameter:?}") })? = value;
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
        let lags: Vec<_> = lateness.iter().zip(&late).map(|(l, &late)| late.then_some(l.lag)).collect();
        let instants = instants(&self.recording.t, &lags);
        let noise = &self.settings.noise;
        let evaluation =
            ParametricMeasurement::new(&self.model, Arc::new(robot), noise.clone(), parameters, lateness, late);
        Ok(Filter::new(&self.model, noise.clone(), evaluation, instants))
    }

    /// Of one innovation ν of variance s: −½ρ(ν²/s) − ½ ln 2πs.
    fn density(&self, innovation: &SequentialInnovation) -> Result<f64, RunError> {
        let SequentialInnovation { value, variance, row } = *innovation;
        let square = value * value / variance;
        if !(square.is_finite() && variance > 0.0) {
            return Err(RunError::NotFinite { sample: row });
        }
        let (limit, size) = (self.settings.huber, square.sqrt());
        let loss = if size > limit { limit * (2.0 * size - limit) } else { square };
        Ok(-0.5 * (loss + log(core::f64::consts::TAU * variance)))
    }
}
