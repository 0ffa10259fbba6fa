//! The channels of the acceleration-driven model without derivatives.

use super::motion::PlainMotion;
use super::view::OfDrives;
use super::{Channel, Driven, Values, read_all};
use crate::robot::Robot;
use crate::scalar::Scalar;

/// Scratch and results, of several particles at once where the scalar is lanes.
#[derive(Clone, Debug)]
pub(crate) struct Predictions<T> {
    /// h (channels), without bias.
    pub(crate) prediction: Vec<T>,
    motion: PlainMotion<T>,
}

impl<T: Scalar> Predictions<T> {
    /// Room for `channels` of `robot`.
    pub(crate) fn new(robot: &Robot, channels: usize) -> Self {
        Self { prediction: vec![T::default(); channels], motion: PlainMotion::new(robot) }
    }

    /// At `state` = (q, q̇, q̈); `dtheta` (n) is each motor's velocity, NaN to leave its damping out.
    #[inline(always)]
    pub(crate) fn predict(&mut self, robot: &Robot, channels: &[Channel], state: &[T], dtheta: &[f64]) {
        let Self { prediction, motion } = self;
        motion.set(robot, state);
        let view = Driven { links: motion, state, dtheta, springs: &OfDrives };
        read_all(robot, channels, &view, &mut Values(prediction));
    }
}
