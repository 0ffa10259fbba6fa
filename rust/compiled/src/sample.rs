//! What an estimator is given.

use linkside_core::error::DesignError;
use linkside_core::estimate::measurement::Kind;

/// One sample of a robot's signals, on the link side of gears, in SI units; NaN where a reading is missing.
///
/// A signal that is not given is empty, and then missing as a whole. One that the estimator does not read may be there.
#[derive(Clone, Copy, Debug, Default)]
pub struct Sample<'a> {
    /// Time since the sample before [s]; filters need it, observers have the period that they were designed for.
    pub dt: f64,
    /// Motor positions (n) [rad].
    pub theta: &'a [f64],
    /// Motor velocities (n) [rad/s].
    pub dtheta: &'a [f64],
    /// Motor torques (n) [N m].
    pub tau: &'a [f64],
    /// Accelerometer channels [m/s²].
    pub acceleration: &'a [f64],
    /// Gyroscope channels [rad/s].
    pub rate: &'a [f64],
    /// Link positions (n) [rad].
    pub q: &'a [f64],
    /// Link velocities (n) [rad/s].
    pub dq: &'a [f64],
    /// Link accelerations (n) [rad/s²].
    pub ddq: &'a [f64],
    /// Torques of joint torque sensors (n) [N m].
    pub torque: &'a [f64],
    /// Commanded link accelerations (n) [rad/s²].
    pub ddqref: &'a [f64],
    /// Forces and moments from outside that sensors measure (6 each) [N, N m].
    pub wrench: &'a [f64],
    /// Channels of trackers [m].
    pub position: &'a [f64],
}

/// A signal of a [`Sample`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)] // as of `Sample`
pub enum Signal {
    Theta,
    Dtheta,
    Tau,
    Acceleration,
    Rate,
    Q,
    Dq,
    Ddq,
    Torque,
    Ddqref,
    Wrench,
    Position,
}

impl Signal {
    /// All of them.
    pub const ALL: [Self; 12] = [
        Self::Theta,
        Self::Dtheta,
        Self::Tau,
        Self::Acceleration,
        Self::Rate,
        Self::Q,
        Self::Dq,
        Self::Ddq,
        Self::Torque,
        Self::Ddqref,
        Self::Wrench,
        Self::Position,
    ];

    /// What columns of a log begin with.
    pub fn name(self) -> &'static str {
        match self {
            Self::Theta => "theta",
            Self::Dtheta => "dtheta",
            Self::Tau => "tau",
            Self::Acceleration => "acceleration",
            Self::Rate => "rate",
            Self::Q => "q",
            Self::Dq => "dq",
            Self::Ddq => "ddq",
            Self::Torque => "torque",
            Self::Ddqref => "ddqref",
            Self::Wrench => "wrench",
            Self::Position => "position",
        }
    }

    /// The signal of that name.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|signal| signal.name() == name)
    }

    /// The signal that channels of a kind read.
    pub(crate) fn of(kind: Kind) -> Self {
        match kind {
            Kind::Motor => Self::Theta,
            Kind::Acceleration => Self::Acceleration,
            Kind::MotorVelocity => Self::Dtheta,
            Kind::Rate => Self::Rate,
            Kind::Link => Self::Q,
            Kind::Torque => Self::Torque,
            Kind::LinkVelocity => Self::Dq,
            Kind::Wrench => Self::Wrench,
            Kind::Position => Self::Position,
            Kind::MotorTorque => Self::Tau,
        }
    }

    /// Its entries in a sample.
    pub(crate) fn values<'a>(self, sample: &Sample<'a>) -> &'a [f64] {
        match self {
            Self::Theta => sample.theta,
            Self::Dtheta => sample.dtheta,
            Self::Tau => sample.tau,
            Self::Acceleration => sample.acceleration,
            Self::Rate => sample.rate,
            Self::Q => sample.q,
            Self::Dq => sample.dq,
            Self::Ddq => sample.ddq,
            Self::Torque => sample.torque,
            Self::Ddqref => sample.ddqref,
            Self::Wrench => sample.wrench,
            Self::Position => sample.position,
        }
    }

    /// Its entries, `width` of them, or none where it is not given.
    ///
    /// # Errors
    /// Another number of entries, or one that is infinite.
    pub(crate) fn checked<'a>(self, sample: &Sample<'a>, width: usize) -> Result<&'a [f64], DesignError> {
        let (what, values) = (self.name(), self.values(sample));
        if values.is_empty() {
            return Ok(values);
        }
        if values.len() != width {
            return Err(DesignError::Length { what, found: values.len(), expected: width });
        }
        match values.iter().position(|x| x.is_infinite()) {
            Some(index) => Err(DesignError::Infinite { what, index, value: values[index] }),
            None => Ok(values),
        }
    }
}
