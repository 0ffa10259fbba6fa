//! A robot to try things on; the examples of this documentation run on it.

use crate::error::RobotError;
use crate::robot::{BodySpec, Drive, JointKind, Robot, Sensor, Tree};
use crate::spatial::{Mat3, Vec3};

/// An arm of one joint: 5 kg on a metre that turn about the vertical, so that gravity does nothing, behind a spring that
/// swings at 17 Hz with the motor let go. At its end are the tool and an accelerometer with three axes.
///
/// ```
/// let robot = linkside_core::demo::arm()?;
/// assert_eq!((robot.len(), robot.acceleration_channels()), (1, 3));
/// # Ok::<(), linkside_core::error::RobotError>(())
/// ```
///
/// # Errors
/// None that these numbers give.
pub fn arm() -> Result<Robot, RobotError> {
    let link = BodySpec {
        parent: None,
        joint: 0,
        kind: JointKind::Revolute,
        rotation: Mat3::IDENTITY,
        translation: Vec3([0.0; 3]),
        axis: Vec3([0.0, 0.0, 1.0]),
        mass: 5.0,
        com: Vec3([0.5, 0.0, 0.0]),
        inertia: Mat3::from_rows([[0.01, 0.0, 0.0], [0.0, 0.4, 0.0], [0.0, 0.0, 0.4]]),
    };
    let drive = Drive::spring(1.2e4, 20.0, 3.0);
    let tree = Tree::new(Vec3([0.0, 0.0, -9.81]), &[link])?;
    let tip = tree.frame("the tip", 0, &Mat3::IDENTITY, &Vec3([1.0, 0.0, 0.0]))?;
    let accelerometer = Sensor { frame: tip.clone(), axes: vec![0, 1, 2], noise_std: 0.05 };
    Robot::new(tree, vec![drive], vec![0.0], vec![accelerometer], vec![], Some(tip))
}
