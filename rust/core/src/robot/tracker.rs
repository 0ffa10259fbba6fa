//! Sensors beside the robot that see where a point of a link is: laser trackers, cameras, motion capture.

use super::{Robot, Sensor};
use crate::check::expect_of;
use crate::error::RobotError;
use crate::scalar::Scalar;
use crate::spatial::{Mat3, Vec3};

/// A point on a body, and what sees it: a reading is the point's position in the tracker's own axes.
#[derive(Clone, Debug)]
pub struct Tracker {
    /// The point that it sees, and which of the tracker's axes are recorded; how the point's frame is turned does not matter.
    pub target: Sensor,
    /// The tracker's axes in the base frame.
    pub axes: Mat3<f64>,
    /// Its origin in the base frame [m].
    pub origin: Vec3<f64>,
}

impl Tracker {
    /// A direction of the base frame in the tracker's axes.
    #[inline(always)]
    pub(crate) fn turn<T: Scalar>(&self, direction: &Vec3<T>) -> Vec3<T> {
        Vec3(self.axes.0.map(|axis| direction.dot_constant(&axis)))
    }

    /// A point of the base frame as the tracker sees it.
    #[inline(always)]
    pub(crate) fn see<T: Scalar>(&self, point: &Vec3<T>) -> Vec3<T> {
        self.turn(&(*point - Vec3::constant(&self.origin)))
    }

    fn check(&self, owner: &str) -> Result<(), RobotError> {
        self.target.check(owner)?;
        let sum: f64 = self.origin.0.iter().chain(self.axes.0.iter().flat_map(|axis| &axis.0)).sum();
        expect_of(sum.is_finite(), "place", || owner.to_string(), sum, "finite numbers")
    }
}

impl Robot {
    /// The same robot, seen by `trackers`.
    ///
    /// # Errors
    /// Noise that is not positive, an axis that there is not, a place that is not finite.
    pub fn with_trackers(mut self, trackers: Vec<Tracker>) -> Result<Self, RobotError> {
        for (i, tracker) in trackers.iter().enumerate() {
            tracker.check(&format!("tracker {i}"))?;
        }
        self.trackers = trackers;
        Ok(self)
    }

    /// Number of recorded axes of trackers.
    pub fn position_channels(&self) -> usize {
        self.trackers.iter().map(|tracker| tracker.target.axes.len()).sum()
    }
}
