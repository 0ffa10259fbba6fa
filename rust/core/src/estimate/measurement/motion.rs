//! How the links move: what sensors on them see, and the torques that it takes.
//!
//! Filters that need derivatives read them off a [`Kinematics`]; particles and simulator, which need values alone, take a
//! [`NewtonEuler`] at half the work. Both answer the same two questions, so that a channel's row is written once.

use super::view::OfDrives;
use super::{Channel, Driven, Values, Wanted, read_all};
use crate::dynamics::{Kinematics, Loads, NewtonEuler};
use crate::robot::{Robot, Sensor, Wound};
use crate::scalar::Scalar;
use crate::simd::{self, Kernel};
use crate::spatial::{Inertia, Vec3};

/// What accelerometers and gyroscopes on moving links read.
///
/// Rows begin at `row`, one for each recorded axis of the sensor. Who computes values alone hands over no derivatives.
pub(crate) trait Sensing<T: Scalar> {
    /// Specific force of accelerometer `index` (De Luca, Schröder and Thümmel 2007, eqs. (8)–(11)).
    fn specific_force(&self, robot: &Robot, index: usize, row: usize, wanted: &mut impl Wanted<T>);

    /// Angular rate of gyroscope `index`.
    fn angular_rate(&self, robot: &Robot, index: usize, row: usize, wanted: &mut impl Wanted<T>);

    /// Position of what tracker `index` sees, in its axes.
    fn tracked_position(&self, robot: &Robot, index: usize, row: usize, wanted: &mut impl Wanted<T>);
}

/// The torques τ = M q̈ + C q̇ + g that the links need.
pub(crate) trait Loading<T: Scalar> {
    /// Joint `j`'s.
    fn load(&self, j: usize) -> T;

    /// `factor` times its derivatives into `row`.
    fn load_columns(&self, j: usize, factor: T, row: usize, wanted: &mut impl Wanted<T>);
}

/// The recorded axes of a value in a sensor's own axes.
#[inline(always)]
pub(crate) fn record<T: Scalar>(sensor: &Sensor, value: &Vec3<T>, row: usize, wanted: &mut impl Wanted<T>) {
    for (r, &axis) in sensor.axes.iter().enumerate() {
        wanted.value(row + r, value.0[axis]);
    }
}

impl<T: Scalar> Sensing<T> for Kinematics<T> {
    #[inline(always)]
    fn specific_force(&self, robot: &Robot, index: usize, row: usize, wanted: &mut impl Wanted<T>) {
        let sensor = &robot.accelerometers[index];
        record(sensor, &Kinematics::specific_force(self, &sensor.frame), row, wanted);
        self.specific_force_derivatives(&robot.tree, &sensor.frame, |joint, by| {
            for (r, &axis) in sensor.axes.iter().enumerate() {
                wanted.columns(row + r, joint, by.map(|column| column.0[axis]));
            }
        });
    }

    #[inline(always)]
    fn angular_rate(&self, robot: &Robot, index: usize, row: usize, wanted: &mut impl Wanted<T>) {
        let sensor = &robot.gyroscopes[index];
        record(sensor, &Kinematics::angular_rate(self, &sensor.frame), row, wanted);
        self.angular_rate_derivatives(&robot.tree, &sensor.frame, |joint, by| {
            for (r, &axis) in sensor.axes.iter().enumerate() {
                wanted.add(row + r, joint, by.map(|column| column.0[axis]));
            }
        });
    }

    #[inline(always)]
    fn tracked_position(&self, robot: &Robot, index: usize, row: usize, wanted: &mut impl Wanted<T>) {
        let tracker = &robot.trackers[index];
        record(&tracker.target, &tracker.see(&self.position(&tracker.target.frame)), row, wanted);
        self.position_jacobian(&robot.tree, &tracker.target.frame, |joint, by| {
            let by = tracker.turn(&by);
            for (r, &axis) in tracker.target.axes.iter().enumerate() {
                wanted.add(row + r, joint, [by.0[axis], T::default()]);
            }
        });
    }
}

/// Motion and loads with all their derivatives, and room for them.
#[derive(Clone, Debug)]
pub(crate) struct LinkMotion<T> {
    /// Frames and motion of all bodies.
    pub(crate) kinematics: Kinematics<T>,
    /// Composite inertias and forces.
    loads: Loads<T>,
    /// τ = M q̈ + C q̇ + g (n) [N m], and its derivatives by q, q̇ and q̈ (n × n each).
    pub(crate) tau: Vec<T>,
    pub(crate) by_q: Vec<T>,
    pub(crate) by_dq: Vec<T>,
    pub(crate) mass: Vec<T>,
}

impl<T: Scalar> LinkMotion<T> {
    pub(crate) fn new(robot: &Robot) -> Self {
        let (tree, n) = (&robot.tree, robot.len());
        let room = |size| vec![T::default(); size];
        Self {
            kinematics: Kinematics::new(tree),
            loads: Loads::new(tree),
            tau: room(n),
            by_q: room(n * n),
            by_dq: room(n * n),
            mass: room(n * n),
        }
    }

    /// At `state` = (q, q̇, q̈).
    #[inline(always)]
    pub(crate) fn set(&mut self, robot: &Robot, state: &[T]) {
        self.set_kinematics(robot, state);
        self.set_loads(robot);
    }

    /// Without loads, where only sensors on links are read.
    #[inline(always)]
    pub(crate) fn set_kinematics(&mut self, robot: &Robot, state: &[T]) {
        let n = robot.len();
        self.kinematics.set(&robot.tree, &state[..n], &state[n..2 * n], &state[2 * n..3 * n]);
    }

    /// After [`set_kinematics`](Self::set_kinematics).
    #[inline(always)]
    pub(crate) fn set_loads(&mut self, robot: &Robot) {
        let Self { kinematics, loads, tau, by_q, by_dq, mass } = self;
        loads.inverse_dynamics_derivatives_into(&robot.tree, kinematics, tau, by_q, by_dq, mass);
    }

    /// Torques (n) that `masses` alone would need for the motion that was set.
    #[inline(always)]
    pub(crate) fn loads_of(&mut self, robot: &Robot, masses: &mut Vec<Inertia<T>>, tau: &mut [T]) {
        self.kinematics.swap_masses(masses);
        self.loads.load_of_masses_into(&robot.tree, &self.kinematics, tau);
        self.kinematics.swap_masses(masses);
    }

    /// After [`set`](Self::set): torques that others than the transmissions give the links.
    #[inline(always)]
    pub(crate) fn relieve(&mut self, by: &[T]) {
        for (tau, &by) in self.tau.iter_mut().zip(by) {
            *tau -= by;
        }
    }

    /// Torques (n) that hold the links at rest at `q`.
    pub(crate) fn holding_torques(&mut self, robot: &Robot, q: &[T]) -> &[T] {
        let zero = vec![T::default(); q.len()];
        self.kinematics.set(&robot.tree, q, &zero, &zero);
        self.loads.inverse_dynamics_into(&robot.tree, &self.kinematics, &mut self.tau);
        &self.tau
    }
}

impl<T: Scalar> Loading<T> for LinkMotion<T> {
    #[inline(always)]
    fn load(&self, j: usize) -> T {
        self.tau[j]
    }

    #[inline(always)]
    fn load_columns(&self, j: usize, factor: T, row: usize, wanted: &mut impl Wanted<T>) {
        let n = self.tau.len();
        let entries = j * n..(j + 1) * n;
        let matrices = self.by_q[entries.clone()].iter().zip(&self.by_dq[entries.clone()]).zip(&self.mass[entries]);
        for (k, ((q, dq), ddq)) in matrices.enumerate() {
            wanted.scaled(row, k, factor, [*q, *dq, *ddq]);
        }
    }
}

impl<T: Scalar> Sensing<T> for LinkMotion<T> {
    #[inline(always)]
    fn specific_force(&self, robot: &Robot, index: usize, row: usize, wanted: &mut impl Wanted<T>) {
        Sensing::specific_force(&self.kinematics, robot, index, row, wanted);
    }

    #[inline(always)]
    fn angular_rate(&self, robot: &Robot, index: usize, row: usize, wanted: &mut impl Wanted<T>) {
        Sensing::angular_rate(&self.kinematics, robot, index, row, wanted);
    }

    #[inline(always)]
    fn tracked_position(&self, robot: &Robot, index: usize, row: usize, wanted: &mut impl Wanted<T>) {
        Sensing::tracked_position(&self.kinematics, robot, index, row, wanted);
    }
}

/// Motion and loads without derivatives, by half the work.
///
/// By [`NewtonEuler`]: bodies in their own axes, no matrices. Rounding differs from [`LinkMotion`]'s, which particles
/// do not mind: they weigh by this text alone.
#[derive(Clone, Debug)]
pub(crate) struct PlainMotion<T> {
    /// The recursion in body frames.
    motion: NewtonEuler<T>,
    /// The torques that it finds (n) [N m].
    tau: Vec<T>,
}

impl<T: Scalar> PlainMotion<T> {
    pub(crate) fn new(robot: &Robot) -> Self {
        Self { motion: NewtonEuler::new(&robot.tree), tau: vec![T::default(); robot.len()] }
    }

    /// At `state` = (q, q̇, q̈).
    #[inline(always)]
    fn set(&mut self, robot: &Robot, state: &[T]) {
        let (tree, n) = (&robot.tree, robot.len());
        self.motion.set(tree, &state[..n], &state[n..2 * n], &state[2 * n..3 * n]);
        self.motion.inverse_dynamics_into(tree, &mut self.tau);
    }

    /// Torques that the transmissions give the links at `state` (n), what acts from outside taken off; see
    /// [`predict`](Self::predict).
    #[inline(always)]
    pub(super) fn loads(&mut self, robot: &Robot, (state, wrench): (&[T], usize)) -> &[T] {
        self.motion.apply_wrenches(&robot.tree, &state[wrench..]);
        self.set(robot, state);
        for (tau, &by) in self.tau.iter_mut().zip(&state[3 * robot.len()..wrench]) {
            *tau -= by;
        }
        &self.tau
    }

    /// `channels` at `state` = (q, q̇, q̈, disturbance torques of links, varying wrenches from entry `wrench` on), links moved
    /// by jerk; `dtheta` (n) is each motor's velocity for the damping torque, NaN to leave it out, friction elements being
    /// `wound`.
    #[inline]
    pub(crate) fn predict(
        &mut self,
        robot: &Robot,
        channels: &[Channel],
        (state, wrench): (&[T], usize),
        (dtheta, wound): (&[f64], &[Wound]),
        prediction: &mut [T],
    ) {
        simd::phase(PredictReadings { motion: self, robot, channels, state, wrench, dtheta, wound, prediction });
    }
}

/// [`PlainMotion::predict`], to be compiled for each instruction set.
struct PredictReadings<'a, T> {
    motion: &'a mut PlainMotion<T>,
    robot: &'a Robot,
    channels: &'a [Channel],
    state: &'a [T],
    wrench: usize,
    dtheta: &'a [f64],
    wound: &'a [Wound],
    prediction: &'a mut [T],
}

impl<T: Scalar> Kernel for PredictReadings<'_, T> {
    type Output = ();
    const LANES: bool = T::LANES;

    #[inline(always)]
    fn run(self) {
        let Self { motion, robot, channels, state, wrench, dtheta, wound, prediction } = self;
        motion.loads(robot, (state, wrench));
        let view = Driven { links: motion, state, wrench, dtheta, springs: &OfDrives(wound) };
        read_all(robot, channels, &view, &mut Values(prediction));
    }
}

impl<T: Scalar> Loading<T> for PlainMotion<T> {
    #[inline(always)]
    fn load(&self, j: usize) -> T {
        self.tau[j]
    }

    #[inline(always)]
    fn load_columns(&self, _: usize, _: T, _: usize, _: &mut impl Wanted<T>) {}
}

impl<T: Scalar> Sensing<T> for PlainMotion<T> {
    #[inline(always)]
    fn specific_force(&self, robot: &Robot, index: usize, row: usize, wanted: &mut impl Wanted<T>) {
        let sensor = &robot.accelerometers[index];
        record_of_body(sensor, &self.motion.specific_force_of_body(&sensor.frame), row, wanted);
    }

    #[inline(always)]
    fn angular_rate(&self, robot: &Robot, index: usize, row: usize, wanted: &mut impl Wanted<T>) {
        let sensor = &robot.gyroscopes[index];
        record_of_body(sensor, &self.motion.angular_rate_of_body(&sensor.frame), row, wanted);
    }

    #[inline(always)]
    fn tracked_position(&self, robot: &Robot, index: usize, row: usize, wanted: &mut impl Wanted<T>) {
        let tracker = &robot.trackers[index];
        let point = self.motion.position(&robot.tree, &tracker.target.frame);
        record(&tracker.target, &tracker.see(&point), row, wanted);
    }
}

/// The recorded axes of a value in the axes of the body that carries the sensor.
#[inline(always)]
fn record_of_body<T: Scalar>(sensor: &Sensor, value: &Vec3<T>, row: usize, wanted: &mut impl Wanted<T>) {
    for (r, &axis) in sensor.axes.iter().enumerate() {
        wanted.value(row + r, value.dot_constant(&sensor.frame.rotation.0[axis]));
    }
}
