//! Observers, which are designed for one sampling period.

use super::tolerances::{Tolerance, tolerances};
use super::{BuildError, MOST_PARTS};
use linkside_core::estimate::observer::{
    self, AccelerationObserver, AccelerationSource, Complex, Form, ObserverSettings, Uncertainty,
};
use linkside_core::estimate::velocity::{GainMap, Gains, Logic, Schedule, VelocityObserver, VelocitySettings};
use linkside_core::robot::Robot;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// The acceleration-driven observer; see [`ObserverSettings`].
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs)]
pub struct Observer {
    pub period: f64,
    /// Real and imaginary part of the poles of each joint.
    pub poles: Vec<Vec<[f64; 2]>>,
    pub bias: bool,
    /// Whether the state is reported before a sample's motor positions are used.
    pub predictor: bool,
    /// Whether accelerations are those of joints, not of sensors.
    pub joint_accelerations: bool,
    pub worst_acceleration_std: f64,
    /// Whether it starts from rest, not as its first samples say.
    pub rest: bool,
    /// A state from which it starts instead.
    #[serde(default)]
    pub start: Option<ObserverStart>,
    /// What is not known exactly, where standard deviations are wanted.
    #[serde(default)]
    pub uncertainty: Option<ObserverUncertainty>,
}

/// What is not known exactly; see [`Uncertainty`].
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs)]
pub struct ObserverUncertainty {
    pub tolerances: Vec<Tolerance>,
    pub correlations: Vec<(usize, usize, f64)>,
    pub encoder: Vec<f64>,
    pub torque: Vec<f64>,
    pub bias: f64,
    pub scale: f64,
}

/// A state one period before the first sample.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs)]
pub struct ObserverStart {
    pub theta: Vec<f64>,
    pub q: Vec<f64>,
    pub dtheta: Vec<f64>,
    pub dq: Vec<f64>,
}

/// A velocity observer; see [`VelocitySettings`].
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs)]
pub struct Velocity {
    pub period: f64,
    /// One a joint; empty beside `levels` or a `map`.
    pub gains: Vec<f64>,
    pub levels: Option<Levels>,
    pub map: Option<Map>,
    pub spring: Vec<f64>,
    pub motors: bool,
    pub wrap: Vec<f64>,
    pub rest: bool,
    /// The velocity at the first sample.
    #[serde(default)]
    pub start: Option<Vec<f64>>,
}

/// Gains by level; see [`Schedule`].
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs)]
pub struct Levels {
    pub gains: Vec<f64>,
    pub bound: f64,
    pub margin: f64,
    pub hysteresis: f64,
    pub start: usize,
    pub dwell: usize,
    /// `repaired`, `printed-sets` or `printed-map`.
    pub logic: String,
}

/// A gain that depends on the posture; see [`GainMap`].
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs)]
pub struct Map {
    pub linear: Vec<f64>,
    pub waves: Vec<f64>,
    pub sine: Vec<f64>,
    pub cosine: Vec<f64>,
}

impl Observer {
    /// The observer, with all checks.
    ///
    /// # Errors
    /// Settings that do not fit `robot`, or are out of range.
    pub fn build(&self, robot: &Arc<Robot>) -> Result<AccelerationObserver, BuildError> {
        let complex = |poles: &Vec<[f64; 2]>| poles.iter().map(|&[re, im]| Complex::new(re, im)).collect();
        let settings = ObserverSettings {
            period: self.period,
            poles: self.poles.iter().map(complex).collect(),
            bias: self.bias,
            form: if self.predictor { Form::Predictor } else { Form::Current },
            source: if self.joint_accelerations { AccelerationSource::Joints } else { AccelerationSource::Sensors },
            start: start(self.rest),
            worst_acceleration_std: self.worst_acceleration_std,
        };
        let mut observer = AccelerationObserver::new(Arc::clone(robot), settings)?;
        if let Some(uncertainty) = &self.uncertainty {
            observer = observer.with_uncertainty(&uncertainty.build(robot)?)?;
        }
        self.begin(&mut observer)?;
        Ok(observer)
    }

    /// Starts where it says.
    ///
    /// # Errors
    /// A state of another number of joints.
    pub(crate) fn begin(&self, observer: &mut AccelerationObserver) -> Result<(), BuildError> {
        if let Some(ObserverStart { theta, q, dtheta, dq }) = &self.start {
            observer.start(theta, q, dtheta, dq)?;
        }
        Ok(())
    }
}

impl ObserverUncertainty {
    /// # Errors
    /// Tolerances of what there is not.
    fn build(&self, robot: &Robot) -> Result<Uncertainty, BuildError> {
        let Self { encoder, torque, bias, scale, .. } = self;
        Ok(Uncertainty {
            tolerances: tolerances(robot, &self.tolerances, &self.correlations)?,
            encoder: encoder.clone(),
            torque: torque.clone(),
            bias: *bias,
            scale: *scale,
        })
    }
}

impl Velocity {
    /// The observer, with all checks.
    ///
    /// # Errors
    /// Settings that do not fit `robot`, or are out of range.
    pub fn build(&self, robot: &Arc<Robot>) -> Result<VelocityObserver, BuildError> {
        let gains = match (&self.levels, &self.map) {
            (Some(levels), _) => Gains::Scheduled(levels.build()?),
            (None, Some(Map { linear, waves, sine, cosine })) => Gains::Mapped(GainMap {
                linear: linear.clone(),
                waves: waves.clone(),
                sine: sine.clone(),
                cosine: cosine.clone(),
            }),
            (None, None) => Gains::Constant(self.gains.clone()),
        };
        let settings = VelocitySettings {
            period: self.period,
            gains,
            spring: self.spring.clone(),
            motors: self.motors,
            start: start(self.rest),
            wrap: self.wrap.clone(),
        };
        let mut observer = VelocityObserver::new(Arc::clone(robot), settings)?;
        self.begin(&mut observer)?;
        Ok(observer)
    }

    /// Starts where it says.
    ///
    /// # Errors
    /// A velocity of another number of joints.
    pub(crate) fn begin(&self, observer: &mut VelocityObserver) -> Result<(), BuildError> {
        if let Some(dq) = &self.start {
            // One lag a joint; a wrong number of velocities is refused before it matters.
            observer.start(dq, &[0.0; MOST_PARTS][..dq.len().min(MOST_PARTS)])?;
        }
        Ok(())
    }
}

impl Levels {
    fn build(&self) -> Result<Schedule, BuildError> {
        let logic = match self.logic.as_str() {
            "repaired" => Logic::Repaired,
            "printed-sets" => Logic::PrintedSets,
            "printed-map" => Logic::PrintedMap,
            other => return Err(BuildError::unknown("a logic of levels", other)),
        };
        let Self { ref gains, bound, margin, hysteresis, start, dwell, .. } = *self;
        Ok(Schedule { gains: gains.clone(), bound, margin, hysteresis, start, dwell, logic })
    }
}

fn start(rest: bool) -> observer::Start {
    if rest { observer::Start::Rest } else { observer::Start::Auto }
}
