//! The row of each kind of channel.

use super::view::View;
use super::{Channel, Sensing, Wanted};
use crate::robot::Robot;
use crate::scalar::Scalar;

/// Reads `channel`, or from its first axis on all those of a sensor, into `row` and those after it; returns how many.
#[inline(always)]
pub(crate) fn read<T: Scalar>(
    robot: &Robot,
    channel: Channel,
    row: usize,
    view: &impl View<T>,
    wanted: &mut impl Wanted<T>,
) -> usize {
    match channel {
        Channel::Motor(j) => view.motor(robot, j, row, wanted),
        Channel::MotorVelocity(j) => view.motor_velocity(robot, j, row, wanted),
        Channel::Torque(j) => view.joint_torque(robot, j, row, wanted),
        // A link encoder reads q itself, a tachometer q̇: one entry of the row, whatever the model.
        Channel::Link(j) => {
            wanted.value(row, view.link(robot, j)[0]);
            wanted.add(row, j, [T::constant(1.0), T::default()]);
        }
        Channel::LinkVelocity(j) => {
            wanted.value(row, view.link(robot, j)[1]);
            wanted.add(row, j, [T::default(), T::constant(1.0)]);
        }
        // All axes of a sensor at once, as they share its kinematics; `read_all` skips the others.
        Channel::Acceleration { sensor, .. } => {
            view.links().specific_force(robot, sensor, row, wanted);
            return robot.accelerometers[sensor].axes.len();
        }
        Channel::Rate { sensor, .. } => {
            view.links().angular_rate(robot, sensor, row, wanted);
            return robot.gyroscopes[sensor].axes.len();
        }
    }
    1
}

/// Reads `channels`, a row each.
#[inline(always)]
pub(crate) fn read_all<T: Scalar>(
    robot: &Robot,
    channels: &[Channel],
    view: &impl View<T>,
    wanted: &mut impl Wanted<T>,
) {
    let mut row = 0;
    while row < channels.len() {
        row += read(robot, channels[row], row, view, wanted);
    }
}
