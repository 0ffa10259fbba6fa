//! What a velocity observer is made with.

use super::map::GainMap;
use super::schedule::Schedule;
use crate::check::{expect, expect_length};
use crate::error::DesignError;
use crate::estimate::observer::Start;

/// The largest product of a gain and the sampling period: of an error e⁻² is left after one sample.
///
/// The error's pole e^(−kT) is stable for any gain; beyond this one the estimate is hardly more than a difference of two
/// positions, and the observer of the paper under Euler's method is unstable.
pub const FASTEST: f64 = 2.0;

/// Gains of the velocity error.
#[derive(Clone, Debug, PartialEq)]
pub enum Gains {
    /// One for each joint (n) [1/s].
    Constant(Vec<f64>),
    /// One at a time for all joints, by how fast the robot is.
    Scheduled(Schedule),
    /// That of the posture; without a spring.
    Mapped(GainMap),
}

/// What a [`VelocityObserver`](super::VelocityObserver) is made with.
#[derive(Clone, Debug, PartialEq)]
pub struct VelocitySettings {
    /// Sampling period T [s].
    pub period: f64,
    /// K.
    pub gains: Gains,
    /// Diagonal of K_P (n) [N m/rad]; zeros for the reduced-order observer.
    pub spring: Vec<f64>,
    /// Whether torques are those of the motors, so that their inertia and friction count; else those on the links.
    pub motors: bool,
    /// Where the velocity begins, unless it is given.
    pub start: Start,
    /// Positions jump by a multiple of this where an encoder wraps (n) [rad]; infinite where it does not.
    pub wrap: Vec<f64>,
}

impl VelocitySettings {
    /// # Errors
    /// A setting out of its range, a gain too fast for the period, arrays that do not fit `n` joints.
    pub(super) fn check(&self, n: usize) -> Result<(), DesignError> {
        expect(self.period.is_finite() && self.period > 0.0, "the sampling period", self.period, "a positive number")?;
        for (what, values) in [("spring", &self.spring), ("wrap", &self.wrap)] {
            expect_length(what, values.len(), n)?;
        }
        for &value in &self.spring {
            expect(value >= 0.0 && value.is_finite(), "a position gain", value, "at least 0")?;
        }
        for &value in &self.wrap {
            expect(value > 0.0, "wrap", value, "greater than 0")?;
        }
        match &self.gains {
            Gains::Constant(gains) => {
                expect_length("gains", gains.len(), n)?;
                gains.iter().try_for_each(|&gain| self.check_gain(gain))
            }
            Gains::Scheduled(schedule) => {
                schedule.check()?;
                schedule.gains.iter().try_for_each(|&gain| self.check_gain(gain))
            }
            Gains::Mapped(map) => {
                map.check(n)?;
                for &value in &self.spring {
                    expect(value == 0.0, "a position gain", value, "0 beside a gain map")?;
                }
                self.check_gain(map.bound())
            }
        }
    }

    fn check_gain(&self, gain: f64) -> Result<(), DesignError> {
        expect(gain > 0.0 && gain.is_finite(), "a gain", gain, "greater than 0")?;
        match FASTEST / self.period {
            limit if gain <= limit => Ok(()),
            limit => Err(DesignError::FastGain { gain, period: self.period, limit }),
        }
    }
}
