//! What a robot and an estimator are made of, as plain numbers and names: what a file holds.
//!
//! A description is what the core's own constructors take. Building one goes through all of their checks, so that nothing
//! that comes out of a file can be wrong in a way that the core would not accept from a program.

mod filters;
mod noise;
mod observers;
mod robot;
mod tolerances;

pub use filters::{Belief, ElasticFilter, JerkFilter, Late, MotorJerkFilter, kinds, late};
pub use noise::{ElasticNoise, JerkNoise, LinkDisturbance, MotorJerkNoise};
pub use observers::{Levels, Map, Observer, ObserverStart, Velocity};
pub(crate) use robot::MOST_PARTS;
pub use robot::{Balance, Body, Drive, Place, Robot, Rotor, Sensor};
pub use tolerances::{Tolerance, tolerances};

use linkside_core::error::{DesignError, RobotError};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// All that is in a file.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Description {
    /// The program that wrote it, and its version.
    pub writer: String,
    /// Names of the joints, in the order of all signals.
    pub joints: Vec<String>,
    /// Names of the accelerometers' channels.
    pub accelerations: Vec<String>,
    /// Names of the gyroscopes' channels.
    pub rates: Vec<String>,
    /// The robot.
    pub robot: Robot,
    /// The estimator.
    pub estimator: Method,
}

/// An estimator and its settings.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// Driven by accelerometers.
    Observer(Observer),
    /// Kalman filter on the jerk-driven model.
    Ekf(JerkFilter),
    /// Kalman filter on the elastic-joint model.
    ElasticEkf(ElasticFilter),
    /// Velocities of a rigid robot.
    Velocity(Velocity),
}

/// A description of nothing that can be built.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum BuildError {
    /// Parts of a robot that do not fit.
    #[error(transparent)]
    Robot(#[from] RobotError),
    /// Settings that cannot be used.
    #[error(transparent)]
    Design(#[from] DesignError),
    /// A name or a part that there is not.
    #[error("{name:?} is not {what}")]
    Unknown {
        /// What it should be.
        what: &'static str,
        /// What it is called.
        name: String,
    },
    /// More of something than a controller has memory for.
    #[error("there are {found} {what}, expected at most {most}")]
    TooMany {
        /// Of what.
        what: &'static str,
        /// How many.
        found: usize,
        /// How many there may be.
        most: usize,
    },
    /// Names that do not belong to the robot.
    #[error("there are {found} names of {what}, expected {expected}")]
    Names {
        /// What they are names of.
        what: &'static str,
        /// How many.
        found: usize,
        /// How many there are of these.
        expected: usize,
    },
}

impl BuildError {
    fn unknown(what: &'static str, name: &str) -> Self {
        Self::Unknown { what, name: name.into() }
    }

    fn limit(what: &'static str, found: usize, most: usize) -> Result<(), Self> {
        if found <= most { Ok(()) } else { Err(Self::TooMany { what, found, most }) }
    }
}
