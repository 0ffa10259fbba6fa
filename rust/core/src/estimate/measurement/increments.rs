//! The channels of the acceleration-driven model, and how they change with an increment of acceleration.

use super::motion::PlainMotion;
use super::view::OfDrives;
use super::wanted::Along;
use super::{Channel, Driven, LinkMotion, read_all};
use crate::robot::Robot;
use crate::scalar::Scalar;
use crate::simd::{self, Kernel};

/// How much an increment of acceleration moves position, velocity and acceleration: T²/2, T and 1.
pub(crate) type Reach = [f64; 3];

/// Scratch and results, of several particles at once where the scalar is lanes.
#[derive(Clone, Debug)]
pub(crate) struct AlongIncrements<T> {
    /// h (channels), without bias.
    pub(crate) prediction: Vec<T>,
    /// ∂h/∂w (channels × n) for an increment w of acceleration that acts from the start of the interval.
    pub(crate) by_increment: Vec<T>,
    plain: PlainMotion<T>,
    motion: LinkMotion<T>,
}

impl<T: Scalar> AlongIncrements<T> {
    /// Room for `channels` of `robot`.
    pub(crate) fn new(robot: &Robot, channels: usize) -> Self {
        Self {
            prediction: vec![T::default(); channels],
            by_increment: vec![T::default(); channels * robot.len()],
            plain: PlainMotion::new(robot),
            motion: LinkMotion::new(robot),
        }
    }

    /// Predictions alone at `state` = (q, q̇, q̈); `dtheta` (n) is each motor's velocity, NaN to leave its damping out.
    #[inline]
    pub(crate) fn predict(&mut self, robot: &Robot, channels: &[Channel], state: &[T], dtheta: &[f64]) {
        self.plain.predict(robot, channels, state, dtheta, &mut self.prediction);
    }

    /// Predictions, and their derivatives along increments of acceleration (Axelsson, Karlsson and Norrlöf 2012,
    /// eqs. (10) and (12)–(17)).
    #[inline]
    pub(crate) fn linearise(&mut self, robot: &Robot, channels: &[Channel], state: &[T], dtheta: &[f64], reach: Reach) {
        simd::phase(Linearise { at: self, robot, channels, state, dtheta, reach });
    }
}

/// [`AlongIncrements::linearise`], to be compiled for each instruction set.
struct Linearise<'a, T> {
    at: &'a mut AlongIncrements<T>,
    robot: &'a Robot,
    channels: &'a [Channel],
    state: &'a [T],
    dtheta: &'a [f64],
    reach: Reach,
}

impl<T: Scalar> Kernel for Linearise<'_, T> {
    type Output = ();
    const LANES: bool = T::LANES;

    #[inline(always)]
    fn run(self) {
        let Self { at, robot, channels, state, dtheta, reach } = self;
        let AlongIncrements { prediction, by_increment, motion, .. } = at;
        motion.set(robot, state);
        by_increment.fill(T::default());
        let view = Driven { links: motion, state, dtheta, springs: &OfDrives };
        let mut wanted = Along { prediction, rows: by_increment, joints: robot.len(), reach };
        read_all(robot, channels, &view, &mut wanted);
    }
}
