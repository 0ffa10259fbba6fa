//! Motors that sit on links.

use super::Robot;
use crate::check::expect_of;
use crate::error::RobotError;
use crate::spatial::Vec3;

/// A motor whose rotor a link carries: the link's turning adds to the rotor's spin, in every posture as it should, so
/// that S depends on q (De Luca, Schröder and Thümmel 2007, Section II).
///
/// The rotor's spin inertia is the drive's motor inertia over `ratio`². The links' own inertias have the rotor's mass,
/// but not its spin inertia about its axis.
#[derive(Clone, Debug, PartialEq)]
pub struct Rotor {
    /// Which joint it drives.
    pub motor: usize,
    /// The body that carries it.
    pub body: usize,
    /// Unit axis of its spin, in the modeller's frame of that body.
    pub axis: Vec3<f64>,
    /// Turns of the rotor relative to its carrier for one of the link; negative where it turns the other way.
    pub ratio: f64,
}

impl Robot {
    /// The same robot with rotors on links, whose coupling follows from where they are.
    ///
    /// # Errors
    /// A joint or a body that does not exist, an axis that is not of length one, a ratio of zero; two rotors of one
    /// motor, or a rotor of a motor that has a constant coupling already.
    pub fn with_rotors(mut self, rotors: Vec<Rotor>) -> Result<Self, RobotError> {
        let n = self.len();
        for (i, rotor) in rotors.iter().enumerate() {
            let owner = || format!("rotor {i}");
            let Rotor { motor, body, axis, ratio } = rotor;
            expect_of(*motor < n, "motor", owner, *motor as f64, "a joint of the robot")?;
            expect_of(*body < self.tree.bodies.len(), "body", owner, *body as f64, "a body of the robot")?;
            expect_of((axis.norm() - 1.0).abs() < 1e-9, "length of the axis", owner, axis.norm(), "1")?;
            expect_of(ratio.is_finite() && *ratio != 0.0, "ratio", owner, *ratio, "a number other than 0")?;
            let free = rotors[..i].iter().all(|other| other.motor != *motor);
            expect_of(free, "motor", owner, *motor as f64, "a motor of its own")?;
            let coupling = (0..n).map(|k| self.coupling[k * n + motor]).find(|&s| s != 0.0).unwrap_or(0.0);
            expect_of(coupling == 0.0, "constant coupling of the motor", owner, coupling, "0: a rotor brings its own")?;
        }
        self.rotors = rotors;
        Ok(self)
    }
}
