//! How links respond to the motion of their motors: what sensors would read if nothing but the motors moved the links.
//!
//! M(q) q̈ + C q̇ + g + friction + S θ̈ = φ(θ − q) + D(θ̇ − q̇) is driven by the motors' motion as it was recorded. The motors'
//! positions have no density here, so that nothing but the other sensors' readings can tell a spring. Derivatives in the
//! parameters and in the initial state are those of the discrete solution, exact, and share one linearisation.

mod elements;
mod equation;
mod links;
mod motion;
mod sensors;

pub use motion::MotorMotion;

use super::parameters::{Parameter, Parameters};
use crate::check::expect_length;
use crate::error::{DesignError, RunError};
use crate::estimate::measurement::{Channel, Kind};
use crate::interrupt::Watch;
use crate::memory::filled;
use crate::robot::Robot;
use equation::Equation;
use links::Links;
use sensors::Sensors;
use std::sync::Arc;

/// What sensors would have read.
#[derive(Clone, Debug, Default)]
pub struct Responded {
    /// One row a sample, one column a channel.
    pub prediction: Vec<f64>,
    /// Its derivatives (channels × (p + 2n) a sample): in the parameters, in q and in q̇ of the first sample.
    pub slopes: Vec<f64>,
}

/// A robot whose motors moved as recorded.
///
/// ```
/// use linkside_core::estimate::likelihood::{MotorMotion, Parameter, Response};
/// use linkside_core::estimate::measurement::Kind;
///
/// // The motor turns at 0.2 rad/s without a jerk, and the link with it, whatever the spring between them.
/// let robot = std::sync::Arc::new(linkside_core::demo::arm()?);
/// let t: Vec<f64> = (0..50).map(|i| 1e-3 * f64::from(i)).collect();
/// let theta: Vec<f64> = t.iter().map(|t| 0.2 * t).collect();
/// let motion = MotorMotion { t, theta: theta.clone(), dtheta: vec![0.2; 50], ddtheta: vec![0.0; 50] };
/// let response = Response::new(robot, &[Kind::Link], vec![], motion)?;
/// let found = response.evaluate(&[Parameter::Stiffness(0)], &[1.2e4], &[0.0, 0.0])?;
/// assert!(found.prediction.iter().zip(&theta).all(|(q, theta)| (q - theta).abs() < 1e-12));
/// assert!(found.slopes[49 * 3].abs() < 1e-12); // by the stiffness
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct Response {
    /// Links, drives and sensors.
    robot: Arc<Robot>,
    /// What the motors did, and what is read of the links.
    motion: MotorMotion,
    channels: Vec<Channel>,
    /// Parameters that are not free, and not as the robot says.
    fixed: Vec<(Parameter, f64)>,
}

impl Response {
    /// Of sensors of `kinds`, parameters that are `fixed` not being as the robot says.
    ///
    /// # Errors
    /// Arrays that do not fit the robot or each other.
    pub fn new(
        robot: Arc<Robot>,
        kinds: &[Kind],
        fixed: Vec<(Parameter, f64)>,
        motion: MotorMotion,
    ) -> Result<Self, DesignError> {
        motion.check(robot.len())?;
        let channels = Kind::all_channels(kinds, &robot);
        Ok(Self { robot, motion, channels, fixed })
    }

    /// Number of samples.
    pub fn len(&self) -> usize {
        self.motion.t.len()
    }

    /// Whether there is no sample; never true.
    pub fn is_empty(&self) -> bool {
        self.motion.t.is_empty()
    }

    /// Number of channels.
    pub fn channels(&self) -> usize {
        self.channels.len()
    }

    /// Readings under `values` of the parameters `free`. The links start where the springs hold them, moving with their
    /// motors, but for `offset` = (q, q̇).
    ///
    /// The method of Gauss with two stages: fourth order, and stable however stiff a joint is.
    ///
    /// # Errors
    /// A parameter that the robot does not have; links that fly away.
    pub fn evaluate(&self, free: &[Parameter], values: &[f64], offset: &[f64]) -> Result<Responded, RunError> {
        let n = self.robot.len();
        expect_length("values", values.len(), free.len())?;
        expect_length("offset", offset.len(), 2 * n)?;
        let mut parameters = Parameters::<f64>::of(&self.robot);
        for (parameter, value) in self.fixed.iter().copied().chain(free.iter().copied().zip(values.iter().copied())) {
            let slot = parameters.slot(parameter);
            *slot.ok_or(DesignError::NoParameter { parameter: format!("{parameter:?}") })? = value;
        }
        let (count, channels, width) = (self.len(), self.channels(), free.len() + 2 * n);
        let mut sensors = Sensors::new(&parameters, free, &self.channels);
        let mut links = Links::new(Equation::new(&self.robot, parameters, free), offset);
        let mut out =
            Responded { prediction: filled(0.0, count, channels)?, slopes: filled(0.0, count, channels * width)? };
        let rows = out.prediction.chunks_exact_mut(channels).zip(out.slopes.chunks_exact_mut(channels * width));
        let watch = Watch::current();
        for (row, (prediction, slopes)) in rows.enumerate() {
            if row == 0 {
                // The first sample: where the springs hold the links, found together with its derivatives.
                links.start(&self.motion);
            } else {
                // Gauss's two stages from the sample before; derivatives by the matrix that Newton's method has
                // factorised last.
                links.step(&self.motion, row - 1);
            }
            // The sample's own accelerations, which accelerometers read: the stages' are those inside the step.
            links.accelerate(&self.motion, row);
            if !links.state.iter().all(|x| x.is_finite()) {
                return Err(RunError::NotFinite { sample: row });
            }
            if watch.stops() {
                return Err(RunError::Interrupted { sample: row });
            }
            sensors.read(&mut links, prediction, slopes);
        }
        Ok(out)
    }
}
