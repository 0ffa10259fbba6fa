//! A robot as the kernels see it: tree, drives, sensors.

mod counterbalance;
mod drive;
mod gearing;
mod rotor;
mod tracker;
mod tree;
mod wrench;

pub use counterbalance::{Anchor, Counterbalance, GasSpring, Strut, TorqueHarmonic, TorqueSeries};
pub(crate) use counterbalance::{Linkage, Support, add_angles};
pub(crate) use drive::SpringRates;
pub use drive::{
    Backlash, Drive, Friction, FrictionElement, GearOutput, Harmonic, Hysteresis, Interpolation, LoadFriction, Loss,
    Moved, Ripple, SoftWindup, SpringCurve, Wound,
};
pub use gearing::Gearing;
pub use rotor::Rotor;
pub use tracker::Tracker;
pub use tree::{Body, BodySpec, Frame, JointKind, Tree};
pub use wrench::{Acting, WRENCH, Wrench};

use crate::check::{expect_of, expect_parts};
use crate::error::RobotError;
use crate::scalar::Scalar;
use crate::spatial::Vec3;

/// A three-axis sensor fixed to a body.
///
/// An accelerometer reads specific force: at rest 9.81 m/s² upwards, in free fall nothing. A gyroscope reads the
/// angular velocity of its body. Both in their own axes, of which some may not be recorded.
#[derive(Clone, Debug)]
pub struct Sensor {
    /// Where it is and how it is turned.
    pub frame: Frame,
    /// Which of its axes are recorded, 0 to 2 for x to z.
    pub axes: Vec<usize>,
    /// Standard deviation of one axis' noise.
    pub noise_std: f64,
}

impl Sensor {
    /// Writes the recorded axes of `value` into `out`; returns how many.
    #[inline(always)]
    pub(crate) fn record<T: Scalar>(&self, value: &Vec3<T>, out: &mut [T]) -> usize {
        for (slot, &axis) in out.iter_mut().zip(&self.axes) {
            *slot = value.0[axis];
        }
        self.axes.len()
    }

    /// # Errors
    /// Noise that is not positive, an axis that there is not.
    fn check(&self, owner: &str) -> Result<(), RobotError> {
        let (std, owner) = (self.noise_std, || owner.to_string());
        expect_of(std > 0.0 && std.is_finite(), "noise_std", owner, std, "greater than 0")?;
        let bad = self.axes.iter().find(|&&axis| axis > 2);
        expect_of(bad.is_none(), "axis", owner, bad.map_or(0.0, |&axis| axis as f64), "0, 1 or 2")
    }
}

/// An elastic-joint robot with its sensors. Joints are in the order of the log.
///
/// Everything is in SI units and reflected through the gears to the link side. A robot is made once, checked, and then
/// lent to all kernels; it does not change, so that threads share it.
///
/// ```
/// use linkside_core::robot::{BodySpec, Drive, JointKind, Robot, Tree};
/// use linkside_core::spatial::{Mat3, Vec3};
///
/// // A pendulum of 2 kg on half a metre, hanging behind a spring of 500 N m/rad.
/// let link = BodySpec {
///     parent: None, // carried by the base
///     joint: 0,     // moved by q[0]
///     kind: JointKind::Revolute,
///     rotation: Mat3::IDENTITY,
///     translation: Vec3([0.0; 3]),
///     axis: Vec3([0.0, 1.0, 0.0]),
///     mass: 2.0,
///     com: Vec3([0.0, 0.0, -0.5]),
///     inertia: Mat3::from_rows([[0.02, 0.0, 0.0], [0.0, 0.02, 0.0], [0.0, 0.0, 0.001]]),
/// };
/// let drive = Drive::spring(500.0, 1.0, 0.3); // the motor's inertia is the rotor's times the gear ratio squared
/// let tree = Tree::new(Vec3([0.0, 0.0, -9.81]), &[link])?;
/// let robot = Robot::new(tree, vec![drive], vec![0.0], vec![], vec![], None)?;
/// assert_eq!(robot.len(), 1);
/// # Ok::<(), linkside_core::error::RobotError>(())
/// ```
#[derive(Clone, Debug)]
pub struct Robot {
    /// Links.
    pub tree: Tree,
    /// One drive a joint.
    pub drives: Vec<Drive>,
    /// S [kg m²], row-major n × n, strictly upper triangular: the inertia that couples motor j to link i < j.
    pub coupling: Vec<f64>,
    /// Specific force [m/s²].
    pub accelerometers: Vec<Sensor>,
    /// Angular velocity [rad/s].
    pub gyroscopes: Vec<Sensor>,
    /// Positions of points of links, seen from beside the robot [m].
    pub trackers: Vec<Tracker>,
    /// Tool centre point.
    pub tool: Option<Frame>,
    /// Motors whose rotors links carry, one a motor at most.
    pub rotors: Vec<Rotor>,
    /// Gears that several motors share.
    pub gearing: Option<Gearing>,
}

impl Robot {
    /// Puts the parts together.
    ///
    /// # Errors
    /// Parts that do not fit, drives out of range, a coupling below the diagonal.
    pub fn new(
        tree: Tree,
        drives: Vec<Drive>,
        coupling: Vec<f64>,
        accelerometers: Vec<Sensor>,
        gyroscopes: Vec<Sensor>,
        tool: Option<Frame>,
    ) -> Result<Self, RobotError> {
        let n = tree.len();
        expect_parts("drives", drives.len(), n)?;
        expect_parts("coupling", coupling.len(), n * n)?;
        for (joint, drive) in drives.iter().enumerate() {
            drive.check(&format!("joint {joint}"))?;
        }
        for (i, &value) in coupling.iter().enumerate() {
            let owner = || format!("motor {} to link {}", i % n, i / n);
            expect_of(i % n > i / n || value == 0.0, "coupling", owner, value, "0 on and below the diagonal")?;
            expect_of(value.is_finite(), "coupling", owner, value, "a finite number")?;
        }
        for (kind, sensors) in [("accelerometer", &accelerometers), ("gyroscope", &gyroscopes)] {
            for (i, sensor) in sensors.iter().enumerate() {
                sensor.check(&format!("{kind} {i}"))?;
            }
        }
        let (trackers, rotors) = (Vec::new(), Vec::new());
        Ok(Self { tree, drives, coupling, accelerometers, gyroscopes, trackers, tool, rotors, gearing: None })
    }

    /// Number of joints.
    pub fn len(&self) -> usize {
        self.tree.len()
    }

    /// Never true.
    pub fn is_empty(&self) -> bool {
        self.tree.is_empty()
    }

    /// Number of recorded accelerometer axes.
    pub fn acceleration_channels(&self) -> usize {
        self.accelerometers.iter().map(|s| s.axes.len()).sum()
    }

    /// Number of recorded gyroscope axes.
    pub fn gyroscope_channels(&self) -> usize {
        self.gyroscopes.iter().map(|s| s.axes.len()).sum()
    }
}
