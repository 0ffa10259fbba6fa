//! Gains where the poles give none: positions that come in only some of the samples, and the first samples of all.
//!
//! Poles hold for a position in every sample. One that comes g samples after the last carries more news, of an error that
//! has grown for longer, and its gain is that of a Kalman filter in steady state: it is stable at any rate, also where g
//! samples are about half a swing of the motor on its spring, at which no gain moves all poles. At the start, where the
//! velocity is not known, the same filter runs from what is.
//!
//! All is in units in which the observer's own speed is 1, so that an error of each state would look alike in θ, and of
//! [`READING`].

use super::gains::JointModel;
use super::matrix::{JointMatrix, identity, multiply};
use super::sampled::{JointState, ORDER};
use crate::robot::Drive;

/// What a position reading may be off by [rad]; sets the scale for what is not known at the start.
pub(super) const READING: f64 = 1e-5;
/// What is not known at the start: velocity [rad/s], torsion beside that of gravity [rad], its rate [rad/s], the
/// acceleration of a rigid joint [rad/s²], and the bias of a measured one [rad/s²].
const VELOCITY: f64 = 10.0;
const TORSION: f64 = 1e-3;
const TORSION_RATE: f64 = 0.05;
const ACCELERATION: f64 = 100.0;
const BIAS: f64 = 0.1;
/// Readings after which a filter's gain is that in steady state.
const SETTLED: usize = 60;
/// Duration of a start, in units of the observer's own time, and the readings that it needs.
const START: f64 = 8.0;
const START_READINGS: u32 = 8;

/// A joint's model in the units of this module.
#[derive(Clone, Copy, Debug)]
pub(super) struct VaryingGain {
    /// Elastic, with a bias state, or rigid.
    model: JointModel,
    /// K/B, by which q moves θ̈.
    reach: f64,
    /// The observer's fastest pole [rad/s], one over the unit of time.
    speed: f64,
    /// T [s].
    period: f64,
}

/// Covariance of a joint's state.
pub(super) type JointCovariance = JointMatrix;

impl VaryingGain {
    pub(super) fn new(model: JointModel, drive: &Drive, speed: f64, period: f64) -> Self {
        Self { model, reach: drive.stiffness / drive.motor_inertia, speed, period }
    }

    /// Samples until the poles take over from a start.
    pub(super) fn start_samples(&self) -> u32 {
        ((START / (self.speed * self.period)).ceil() as u32).max(START_READINGS)
    }

    /// Whether the start is over after this many samples and readings.
    pub(super) fn is_settled(&self, samples: u32, readings: u32) -> bool {
        samples >= self.start_samples() && readings >= START_READINGS
    }

    /// What to multiply each state by.
    fn scale(&self, speed: f64) -> JointState {
        let reach = self.reach / speed.powi(2);
        match self.model {
            JointModel::Rigid => [1.0, 1.0 / speed, 1.0 / speed.powi(2), 0.0, 0.0],
            _ => [1.0, reach, 1.0 / speed, reach / speed, reach / speed.powi(2)],
        }
    }

    /// The transition in units of `scale`, zero beyond the model's order.
    fn scaled(&self, transition: &[JointState; ORDER], scale: &JointState) -> [JointState; ORDER] {
        let n = self.model.order();
        core::array::from_fn(|i| {
            core::array::from_fn(|j| if i < n && j < n { transition[i][j] * scale[i] / scale[j] } else { 0.0 })
        })
    }

    /// What moves each state beside the model: forces on motor and link, jerk of a rigid joint, walk of a bias.
    fn is_moved(&self, state: usize) -> bool {
        match self.model {
            JointModel::Rigid => state == 2,
            JointModel::Elastic => state == 2 || state == 3,
            JointModel::ElasticWithBias => state >= 2,
        }
    }

    /// One sample on.
    fn predict(&self, spread: &mut JointCovariance, transition: &[JointState; ORDER], noise: f64) {
        let product: JointCovariance = multiply(transition, spread);
        for i in 0..ORDER {
            for j in 0..ORDER {
                spread[i][j] = (0..ORDER).map(|k| product[i][k] * transition[j][k]).sum();
            }
            if self.is_moved(i) {
                spread[i][i] += noise;
            }
        }
    }

    /// The gain for positions `gap` samples apart.
    pub(super) fn gain(&self, transition: &[JointState; ORDER], gap: usize) -> JointState {
        // Nothing between two readings can be followed that is faster than they are.
        let interval = gap as f64 * self.period;
        let speed = self.speed.min(1.0 / interval);
        let scale = self.scale(speed);
        let transition = self.scaled(transition, &scale);
        let mut spread = JointCovariance::default();
        let mut whole = identity();
        let mut added = JointCovariance::default();
        // Transition and noise over the whole gap, then the filter's recursion until its gain stands still: a Riccati
        // equation solved by iteration, once for each length of a gap.
        for _ in 0..gap {
            self.predict(&mut added, &transition, speed * self.period);
            whole = multiply(&transition, &whole);
        }
        let mut gain = JointState::default();
        for _ in 0..SETTLED {
            self.predict(&mut spread, &whole, 0.0);
            for (row, more) in spread.iter_mut().zip(&added) {
                for (entry, more) in row.iter_mut().zip(more) {
                    *entry += more;
                }
            }
            gain = correct(&mut spread, 1.0 / (speed * interval));
        }
        unscaled(&gain, &scale)
    }

    /// What is not known when the first position has been read.
    pub(super) fn first(&self) -> JointCovariance {
        let scale = self.scale(self.speed);
        let known = |i: usize, value: f64| (scale[i] * value / READING).powi(2);
        let mut spread = JointCovariance::default();
        spread[0][0] = 1.0 / (self.speed * self.period);
        if self.model == JointModel::Rigid {
            (spread[1][1], spread[2][2]) = (known(1, VELOCITY), known(2, ACCELERATION));
            return spread;
        }
        // The link moves as its motor does, but for the torsion.
        spread[1][1] = known(1, TORSION) + scale[1].powi(2) * spread[0][0];
        (spread[0][1], spread[1][0]) = (scale[1] * spread[0][0], scale[1] * spread[0][0]);
        spread[2][2] = known(2, VELOCITY);
        spread[3][3] = known(3, VELOCITY) + known(3, TORSION_RATE);
        let common = scale[2] * scale[3] * (VELOCITY / READING).powi(2);
        (spread[2][3], spread[3][2]) = (common, common);
        if self.model == JointModel::ElasticWithBias {
            spread[4][4] = known(4, BIAS);
        }
        spread
    }

    /// The same in the joint's own units.
    pub(super) fn first_covariance(&self) -> JointCovariance {
        let (spread, scale) = (self.first(), self.scale(self.speed));
        let unit = |i: usize| if scale[i] > 0.0 { READING / scale[i] } else { 0.0 };
        core::array::from_fn(|i| core::array::from_fn(|j| spread[i][j] * unit(i) * unit(j)))
    }

    /// One sample further into a start: the gain for its position, if there is one.
    pub(super) fn start(
        &self,
        transition: &[JointState; ORDER],
        spread: &mut JointCovariance,
        reads: bool,
    ) -> JointState {
        let scale = self.scale(self.speed);
        let pace = self.speed * self.period;
        self.predict(spread, &self.scaled(transition, &scale), pace);
        if reads { unscaled(&correct(spread, 1.0 / pace), &scale) } else { JointState::default() }
    }
}

/// Takes a reading of the first state of variance `noise`; returns the gain.
fn correct(spread: &mut JointCovariance, noise: f64) -> JointState {
    let row = spread[0];
    let gain = row.map(|entry| entry / (row[0] + noise));
    for i in 0..ORDER {
        for j in 0..ORDER {
            spread[i][j] -= gain[i] * row[j];
        }
    }
    gain
}

/// A gain in the joint's own units.
fn unscaled(gain: &JointState, scale: &JointState) -> JointState {
    core::array::from_fn(|i| if scale[i] > 0.0 { gain[i] / scale[i] } else { 0.0 })
}
