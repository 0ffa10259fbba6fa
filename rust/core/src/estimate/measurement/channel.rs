//! What a robot's log can hold: names, channels, and the row of each.

use super::motion::Sensing;
use super::view::View;
use super::wanted::Wanted;
use crate::check::expect;
use crate::error::DesignError;
use crate::robot::Robot;
use crate::scalar::Scalar;

/// One scalar that a robot's log can hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Channel {
    /// Motor position of a joint [rad].
    Motor(usize),
    /// Motor velocity of a joint [rad/s].
    MotorVelocity(usize),
    /// One axis of an accelerometer [m/s²].
    Acceleration {
        /// Which accelerometer.
        sensor: usize,
        /// Which axis.
        axis: usize,
    },
    /// One axis of a gyroscope [rad/s].
    Rate {
        /// Which gyroscope.
        sensor: usize,
        /// Which axis.
        axis: usize,
    },
    /// One axis of a tracker [m].
    Position {
        /// Which tracker.
        sensor: usize,
        /// Which of its axes.
        axis: usize,
    },
    /// Link position of a joint [rad].
    Link(usize),
    /// Torque that the transmission gives a link [N m].
    Torque(usize),
    /// Link velocity of a joint [rad/s].
    LinkVelocity(usize),
    /// A number of a wrench from outside, counted over all that vary [N, N m].
    Wrench(usize),
    /// Torque of a joint's motor [N m], of a model that torques do not move.
    MotorTorque(usize),
}

/// What a sensor measures: all channels of a kind come together, joint by joint or axis by axis.
///
/// ```
/// use linkside_core::estimate::measurement::{Channel, Kind};
/// let robot = linkside_core::demo::arm()?;
/// let channels = Kind::all_channels(&[Kind::Link, Kind::Motor], &robot);
/// assert_eq!(channels, [Channel::Motor(0), Channel::Link(0)]); // always in the order of `ALL`
/// # Ok::<(), linkside_core::error::RobotError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    /// θ (n) [rad].
    Motor,
    /// Specific force, one number a recorded axis of the accelerometers [m/s²].
    Acceleration,
    /// θ̇ (n) [rad/s].
    MotorVelocity,
    /// Angular velocity, one number a recorded axis of the gyroscopes [rad/s].
    Rate,
    /// q (n) [rad].
    Link,
    /// What the transmission gives the link (n) [N m].
    Torque,
    /// q̇ (n), of tachometers on the links [rad/s].
    LinkVelocity,
    /// Forces and moments from outside, six numbers a sensor [N, N m].
    Wrench,
    /// Positions of points of links, one number a recorded axis of the trackers [m].
    Position,
    /// τ (n) [N m]; where torques move a model they are inputs and no readings.
    MotorTorque,
}

impl Kind {
    /// All, in the order in which their channels stand.
    pub const ALL: [Self; 10] = [
        Self::Motor,
        Self::Acceleration,
        Self::MotorVelocity,
        Self::Rate,
        Self::Link,
        Self::Torque,
        Self::LinkVelocity,
        Self::Wrench,
        Self::Position,
        Self::MotorTorque,
    ];

    /// Those of sensors, without what moves a robot, which stands last.
    pub const SENSORS: &[Self] = Self::ALL.split_at(Self::ALL.len() - 1).0;

    /// # Errors
    /// Motor torques among `kinds`, for the reason that is `expected` of a model that does not read them.
    pub(crate) fn refuse_motor_torques(kinds: &[Self], expected: &'static str) -> Result<(), DesignError> {
        let read = kinds.iter().filter(|kind| **kind == Self::MotorTorque).count();
        expect(read == 0, "kinds of channels that read motor torques", read as f64, expected)
    }

    /// As a log's columns begin.
    pub fn name(self) -> &'static str {
        match self {
            Self::Motor => "theta",
            Self::Acceleration => "acceleration",
            Self::MotorVelocity => "dtheta",
            Self::Rate => "rate",
            Self::Link => "q",
            Self::Torque => "torque",
            Self::LinkVelocity => "dq",
            Self::Wrench => "wrench",
            Self::Position => "position",
            Self::MotorTorque => "tau",
        }
    }

    /// The kind of that [`name`](Self::name).
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.name() == name)
    }

    /// Its channels on `robot`.
    pub fn channels(self, robot: &Robot) -> Vec<Channel> {
        let joints = |channel: fn(usize) -> Channel| (0..robot.len()).map(channel).collect();
        match self {
            Self::Motor => joints(Channel::Motor),
            Self::MotorVelocity => joints(Channel::MotorVelocity),
            Self::Link => joints(Channel::Link),
            Self::Torque => joints(Channel::Torque),
            Self::LinkVelocity => joints(Channel::LinkVelocity),
            Self::MotorTorque => joints(Channel::MotorTorque),
            Self::Acceleration => axes(robot.accelerometers.iter().map(|s| &s.axes), |sensor, axis| {
                Channel::Acceleration { sensor, axis }
            }),
            Self::Wrench => robot.wrench_channels().map(Channel::Wrench).collect(),
            Self::Position => {
                axes(robot.trackers.iter().map(|t| &t.target.axes), |sensor, axis| Channel::Position { sensor, axis })
            }
            Self::Rate => axes(robot.gyroscopes.iter().map(|s| &s.axes), |sensor, axis| Channel::Rate { sensor, axis }),
        }
    }

    /// Channels of several kinds, in the order of [`ALL`](Self::ALL) whatever that of `kinds`.
    pub fn all_channels(kinds: &[Self], robot: &Robot) -> Vec<Channel> {
        Self::ALL.iter().filter(|kind| kinds.contains(kind)).flat_map(|kind| kind.channels(robot)).collect()
    }
}

/// A channel for each recorded axis of each sensor.
fn axes<'a>(sensors: impl Iterator<Item = &'a Vec<usize>>, channel: impl Fn(usize, usize) -> Channel) -> Vec<Channel> {
    let of = |(sensor, axes): (usize, &'a Vec<usize>)| axes.iter().map(move |&axis| (sensor, axis));
    sensors.enumerate().flat_map(of).map(|(sensor, axis)| channel(sensor, axis)).collect()
}

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
        Channel::MotorTorque(j) => view.motor_torque(j, row, wanted),
        // A link encoder reads q itself, a tachometer q̇: one entry of the row, whatever the model.
        Channel::Link(j) => {
            wanted.value(row, view.link(robot, j)[0]);
            wanted.add(row, j, [T::constant(1.0), T::default()]);
        }
        Channel::LinkVelocity(j) => {
            wanted.value(row, view.link(robot, j)[1]);
            wanted.add(row, j, [T::default(), T::constant(1.0)]);
        }
        Channel::Wrench(number) => view.wrench(number, row, wanted),
        // All axes of a sensor at once, as they share its kinematics; `read_all` skips the others.
        Channel::Acceleration { sensor, .. } => {
            view.links().specific_force(robot, sensor, row, wanted);
            return robot.accelerometers[sensor].axes.len();
        }
        Channel::Rate { sensor, .. } => {
            view.links().angular_rate(robot, sensor, row, wanted);
            return robot.gyroscopes[sensor].axes.len();
        }
        Channel::Position { sensor, .. } => {
            view.links().tracked_position(robot, sensor, row, wanted);
            return robot.trackers[sensor].target.axes.len();
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
