//! What an observer is made with.

use super::poles::Complex;
use crate::check::{expect, expect_length};
use crate::error::DesignError;
use crate::robot::Robot;

/// Where the link accelerations come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AccelerationSource {
    /// Measured for every joint, as Theorems 1 and 2 assume.
    Joints,
    /// From accelerometers on the links, by the inverse of their map at the estimate (eq. (12)).
    Sensors,
}

/// Which of the two estimates of a sample is reported.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// After the sample's own motor position is used.
    Current,
    /// Before: what was predicted for it.
    Predictor,
}

/// Where an observer begins.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Start {
    /// The first samples tell, whether the robot moves or not.
    #[default]
    Auto,
    /// At rest.
    Rest,
}

/// What an [`AccelerationObserver`] is made with.
#[derive(Clone, Debug)]
pub struct ObserverSettings {
    /// Sampling period [s].
    pub period: f64,
    /// Error poles [1/s] of each joint: four, five with a bias state, three for a rigid joint.
    pub poles: Vec<Vec<Complex>>,
    /// Whether each elastic joint has a state for the bias of its measured acceleration.
    pub bias: bool,
    /// Reported estimate.
    pub form: Form,
    /// Source of link accelerations.
    pub source: AccelerationSource,
    /// Where it begins, unless a state is given.
    pub start: Start,
    /// Combinations of accelerations known worse than this are damped [rad/s²].
    pub worst_acceleration_std: f64,
}

/// # Errors
/// A setting out of its range, or fewer accelerations than elastic joints.
pub(super) fn check(robot: &Robot, settings: &ObserverSettings) -> Result<(), DesignError> {
    let ObserverSettings { period, worst_acceleration_std: worst, .. } = *settings;
    for (what, value) in [("the sampling period", period), ("worst_acceleration_std", worst)] {
        expect(value > 0.0 && value.is_finite(), what, value, "a positive number")?;
    }
    expect_length("poles", settings.poles.len(), robot.len())?;
    let joints = robot.drives.iter().filter(|d| d.elastic).count();
    let channels = robot.acceleration_channels();
    if settings.source == AccelerationSource::Sensors && channels < joints {
        return Err(DesignError::TooFewAccelerations { joints, channels });
    }
    Ok(())
}
