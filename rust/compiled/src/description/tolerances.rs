//! Numbers of a robot that are known to a tolerance only.

use super::BuildError;
use linkside_core::error::DesignError;
use linkside_core::estimate::kalman::{self, Tolerances, Uncertain};
use linkside_core::robot::Robot;
use serde::{Deserialize, Serialize};

/// How many there may be: each costs a filter a column.
const MOST_TOLERANCES: usize = 1024;

/// A parameter's kind, its joint or sensor, its axis, and its standard deviation.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct Tolerance(pub String, pub usize, pub usize, pub f64);

/// Numbers of `robot` that are known to a tolerance only.
///
/// # Errors
/// One of a joint, a sensor or a kind that there is not; correlations that no errors have.
pub fn tolerances(
    robot: &Robot,
    each: &[Tolerance],
    correlations: &[(usize, usize, f64)],
) -> Result<Tolerances, BuildError> {
    BuildError::limit("tolerances", each.len(), MOST_TOLERANCES)?;
    let each: Result<_, _> = each.iter().map(|one| one.build(robot)).collect();
    Ok(Tolerances::correlated(each?, correlations.to_vec())?)
}

impl Tolerance {
    fn build(&self, robot: &Robot) -> Result<kalman::Tolerance, BuildError> {
        use Uncertain as U;
        let Self(ref kind, i, axis, std) = *self;
        let (parameter, parts) = match kind.as_str() {
            "stiffness" => (U::Stiffness(i), robot.len()),
            "cubic_stiffness" => (U::CubicStiffness(i), robot.len()),
            "damping" => (U::Damping(i), robot.len()),
            "yielding" => (U::Yielding(i), robot.len()),
            "hysteresis" => (U::Hysteresis(i), robot.len()),
            "mass" => (U::Mass(i), robot.len()),
            "link_friction" => (U::LinkFriction(i), robot.len()),
            "torque_constant" => (U::TorqueConstant(i), robot.len()),
            "motor_friction" => (U::MotorFriction(i), robot.len()),
            "motor_inertia" => (U::MotorInertia(i), robot.len()),
            "encoder_line" => (U::EncoderLine(i, axis), robot.len()),
            "encoder_zero" => (U::EncoderZero(i), robot.len()),
            "lost_motion" => (U::LostMotion(i), robot.len()),
            "rotation" => (U::Rotation(i, axis), robot.accelerometers.len()),
            "translation" => (U::Translation(i, axis), robot.accelerometers.len()),
            "scale" => (U::Scale(i, axis), robot.accelerometers.len()),
            _ => return Err(BuildError::unknown("a tolerance", kind)),
        };
        let axes = match parameter {
            U::EncoderLine(j, _) => robot.drives.get(j).map_or(0, |drive| 2 * drive.encoder_lines.len()),
            _ => 3,
        };
        if i >= parts || axis >= axes {
            return Err(BuildError::unknown("a tolerance of a part", &format!("{kind} {i} {axis}")));
        }
        if !(std >= 0.0 && std.is_finite()) {
            return Err(DesignError::Range { what: "a tolerance", value: std, expected: "at least 0" }.into());
        }
        Ok(kalman::Tolerance { parameter, std })
    }
}
