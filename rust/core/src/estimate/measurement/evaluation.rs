//! All channels of the jerk-driven model in one state, with their Jacobian.

use super::motion::PlainMotion;
use super::view::OfDrives;
use super::wanted::OutsideColumns;
use super::{Channel, Driven, Jacobian, LinkMotion, read_all};
use crate::robot::{Robot, Wound};
use crate::scalar::Scalar;
use crate::simd::{self, Kernel};

/// Predictions of all channels at one state, with their derivatives in (q, q̇, q̈).
///
/// ```
/// use linkside_core::estimate::measurement::{Evaluation, Kind};
///
/// let robot = linkside_core::demo::arm()?;
/// let channels = Kind::all_channels(&[Kind::Motor, Kind::Link], &robot);
/// let mut at = Evaluation::new(&robot, channels.len());
/// at.evaluate(&robot, &channels, &[0.1, 0.0, 10.0], &[f64::NAN]); // (q, q̇, q̈), motor velocities unknown
/// // 16.5 N m accelerate the link; the motor is ahead of it by that over K, and by I/K more for each rad/s².
/// assert!((at.prediction[0] - at.prediction[1] - 16.5 / 1.2e4).abs() < 1e-12);
/// assert!((at.jacobian[2] - 1.65 / 1.2e4).abs() < 1e-12);
/// # Ok::<(), linkside_core::error::RobotError>(())
/// ```
#[derive(Clone, Debug)]
pub struct Evaluation<T> {
    /// h (channels), without bias.
    pub prediction: Vec<T>,
    /// ∂h/∂(q, q̇, q̈), by the links' disturbance torques and by varying wrenches if there are any, channels × their number,
    /// row-major.
    pub jacobian: Vec<T>,
    /// ∂h by what a joint's transmission gives its link, of the channels that depend on it [unit/(N m)].
    pub(crate) by_torque: Vec<T>,
    /// Friction elements as the last sample left them (n); empty where no joint has them.
    pub(crate) wound: Vec<Wound>,
    /// Numbers of a row, and where in it wrenches from outside begin.
    width: usize,
    wrench: usize,
    /// What each joint's torque gains by each number of them (n × numbers).
    map: Vec<T>,
    /// Motion and loads with derivatives, and without for values alone.
    pub(crate) motion: LinkMotion<T>,
    plain: PlainMotion<T>,
}

impl<T: Scalar> Evaluation<T> {
    /// Room for `channels` of `robot`.
    pub fn new(robot: &Robot, channels: usize) -> Self {
        Self::disturbed(robot, channels, [0, 0])
    }

    /// The same where the state goes on with so many torques of the links, one each or none, and so many numbers of varying
    /// wrenches, all or none.
    pub fn disturbed(robot: &Robot, channels: usize, [torques, wrenches]: [usize; 2]) -> Self {
        let wrench = 3 * robot.len() + torques;
        let width = wrench + wrenches;
        let plain = robot.drives.iter().all(|drive| drive.hysteresis.is_none());
        Self {
            prediction: vec![T::default(); channels],
            jacobian: vec![T::default(); channels * width],
            by_torque: vec![T::default(); channels],
            wound: if plain { Vec::new() } else { robot.drives.iter().map(Wound::new).collect() },
            width,
            wrench,
            map: vec![T::default(); robot.len() * wrenches],
            motion: LinkMotion::new(robot),
            plain: PlainMotion::new(robot),
        }
    }

    /// Evaluates `channels` at `state` = (q, q̇, q̈); `dtheta` (n) is each motor's velocity for the damping torque, NaN to
    /// leave it out. Rows of motor velocities stay zero: they are the rate of the motor positions'.
    #[inline]
    pub fn evaluate(&mut self, robot: &Robot, channels: &[Channel], state: &[T], dtheta: &[f64]) {
        simd::phase(Evaluate { evaluation: self, robot, channels, state, dtheta });
    }

    /// Predictions alone, as [`evaluate`](Self::evaluate) but for rounding.
    #[inline]
    pub fn predict(&mut self, robot: &Robot, channels: &[Channel], state: &[T], dtheta: &[f64]) {
        let Self { plain, wound, width, wrench, prediction, .. } = self;
        plain.predict(robot, channels, (&state[..*width], *wrench), (dtheta, wound), prediction);
    }
}

impl Evaluation<f64> {
    /// Lets friction elements go on to where a `state` winds them, from rest there if `anew`; the first of `channels` are
    /// the motors'.
    pub(crate) fn follow(&mut self, robot: &Robot, channels: &[Channel], state: &[f64], dtheta: &[f64], anew: bool) {
        let state = (&state[..self.width], self.wrench);
        if anew {
            let loads = self.plain.loads(robot, state);
            for ((wound, drive), load) in self.wound.iter_mut().zip(&robot.drives).zip(loads) {
                wound.rest(drive, *load);
            }
            return;
        }
        let n = robot.len();
        self.plain.predict(robot, &channels[..n], state, (dtheta, &self.wound), &mut self.prediction);
        for (j, (wound, drive)) in self.wound.iter_mut().zip(&robot.drives).enumerate() {
            if drive.elastic {
                wound.follow(drive, drive.torsion_between(self.prediction[j], state.0[j]));
            }
        }
    }
}

/// [`Evaluation::evaluate`], to be compiled for each instruction set.
struct Evaluate<'a, T> {
    evaluation: &'a mut Evaluation<T>,
    robot: &'a Robot,
    channels: &'a [Channel],
    state: &'a [T],
    dtheta: &'a [f64],
}

impl<T: Scalar> Kernel for Evaluate<'_, T> {
    type Output = ();
    const LANES: bool = T::LANES;

    #[inline(always)]
    fn run(self) {
        let Self { evaluation, robot, channels, state, dtheta } = self;
        let Evaluation { prediction, jacobian, by_torque, motion, width, wrench, map, wound, .. } = evaluation;
        let (joints, width, wrench) = (robot.len(), *width, *wrench);
        motion.kinematics.apply_wrenches(&robot.tree, &state[wrench..width]);
        motion.set(robot, state);
        let torques = wrench > 3 * joints;
        if torques {
            motion.relieve(&state[3 * joints..wrench]);
        }
        if !map.is_empty() {
            let numbers = width - wrench;
            map.fill(T::default());
            motion.kinematics.wrench_map(&robot.tree, |number, joint, by| map[joint * numbers + number] += by);
        }
        jacobian.fill(T::default());
        let view = Driven { links: motion, state, wrench, dtheta, springs: &OfDrives(wound) };
        let outside = OutsideColumns { torques, map };
        read_all(
            robot,
            channels,
            &view,
            &mut Jacobian { prediction, rows: jacobian, joints, width, by_torque, outside },
        );
    }
}
