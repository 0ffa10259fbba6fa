//! A robot as the kernels see it: tree, drives, sensors.

mod drive;
mod tree;

pub use drive::{Drive, MotorFriction, SoftWindup};
pub use tree::{Body, BodySpec, Frame, JointKind, Tree};

use crate::error::RobotError;

/// A three-axis sensor fixed to a body.
#[derive(Clone, Debug)]
pub struct Sensor {
    /// Where it is and how it is turned.
    pub frame: Frame,
    /// Which of its axes are recorded, 0 to 2 for x to z.
    pub axes: Vec<usize>,
    /// Standard deviation of one axis' noise.
    pub noise_std: f64,
}

/// An elastic-joint robot with its sensors. Joints are in the order of the log.
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
    /// Tool centre point.
    pub tool: Option<Frame>,
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
        expect_length("drives", drives.len(), n)?;
        expect_length("coupling", coupling.len(), n * n)?;
        for (joint, drive) in drives.iter().enumerate().filter(|(_, d)| d.elastic) {
            for (what, value) in [("stiffness", drive.stiffness), ("motor inertia", drive.motor_inertia)] {
                expect_range(value > 0.0 && value.is_finite(), what, joint, value, "greater than 0")?;
            }
            expect_range(drive.damping >= 0.0, "damping", joint, drive.damping, "at least 0")?;
        }
        for (i, &value) in coupling.iter().enumerate() {
            expect_range(i % n > i / n || value == 0.0, "coupling", i % n, value, "0 on and below the diagonal")?;
        }
        for sensor in accelerometers.iter().chain(&gyroscopes) {
            let value = sensor.noise_std;
            expect_range(value > 0.0 && value.is_finite(), "noise_std of a sensor", 0, value, "greater than 0")?;
        }
        Ok(Self { tree, drives, coupling, accelerometers, gyroscopes, tool })
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

fn expect_length(what: &'static str, found: usize, expected: usize) -> Result<(), RobotError> {
    if found == expected { Ok(()) } else { Err(RobotError::Length { what, found, expected }) }
}

fn expect_range(
    ok: bool,
    what: &'static str,
    joint: usize,
    value: f64,
    expected: &'static str,
) -> Result<(), RobotError> {
    if ok { Ok(()) } else { Err(RobotError::Range { what, owner: format!("joint {joint}"), value, expected }) }
}
