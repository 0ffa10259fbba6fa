//! Motors whose accelerations are states: what moves links, and what torque motors need.
//!
//! With θ̈ given, links behind springs follow M q̈ = τ_e − C q̇ − g − d − S θ̈, in which the accelerations of rigid joints are
//! given too: their rows become q̈ = θ̈ and their columns join the right-hand side, so that the matrix stays symmetric and
//! positive definite (hybrid dynamics, R. Featherstone 2008, section 9.2). A rigid joint's own row then says what its
//! transmission gives the link, and the motors' rows what torque they need:
//!
//! τ = B θ̈ + Sᵀ q̈ + f + (1 + ε′) τ_e,
//!
//! B being a full matrix of joints that share motors.

use super::{ElasticDynamics, ElasticLayout};
use crate::linear;
use crate::robot::Robot;
use crate::scalar::Scalar;

/// What a motion of motors that is given asks of them.
#[derive(Clone, Debug)]
pub(super) struct Prescribed<T> {
    /// The first acceleration of a motor in the state.
    first: usize,
    /// M of the links (n × n).
    pub(super) mass: Vec<T>,
    /// What motors need (n) [N m].
    torque: Vec<T>,
    /// Its derivatives, and of rigid joints those of what transmissions give links (n × dense).
    torque_by: Vec<T>,
    joint_torque_by: Vec<T>,
}

impl<T: Scalar> Prescribed<T> {
    pub(super) fn new(first: usize, joints: usize, dense: usize) -> Self {
        let room = |length: usize| vec![T::default(); length];
        Self {
            first,
            mass: room(joints * joints),
            torque: room(joints),
            torque_by: room(joints * dense),
            joint_torque_by: room(joints * dense),
        }
    }
}

impl<T: Scalar> ElasticDynamics<T> {
    /// Where motors' accelerations are states: M with rows and columns of rigid joints as those of the identity.
    #[inline(always)]
    pub(super) fn prescribe_inertia(&mut self, robot: &Robot) {
        let n = robot.len();
        let Self { prescribed, mass, .. } = self;
        let Some(prescribed) = prescribed else { return };
        prescribed.mass.copy_from_slice(&mass[..n * n]);
        for j in rigid(robot) {
            for i in 0..n {
                (mass[i * n + j], mass[j * n + i]) = (T::default(), T::default());
            }
            mass[j * n + j] = T::constant(1.0);
        }
    }

    /// And the right-hand side, to which columns of rigid joints go with their accelerations.
    #[inline(always)]
    pub(super) fn prescribe(&mut self, robot: &Robot, x: &[T]) {
        let n = robot.len();
        let Self { prescribed, coupling, ddq, spring, .. } = self;
        let Some(prescribed) = prescribed else { return };
        let ddtheta = &x[prescribed.first..][..n];
        for (j, &acceleration) in ddtheta.iter().enumerate() {
            coupling.coupled(j).for_each(|(i, s)| ddq[i] -= s * acceleration);
        }
        rigid(robot).for_each(|j| spring[j] = -ddq[j]);
        for j in rigid(robot) {
            (0..n).for_each(|i| ddq[i] -= prescribed.mass[i * n + j] * ddtheta[j]);
        }
        rigid(robot).for_each(|j| ddq[j] = ddtheta[j]);
    }

    /// θ̈, what rigid transmissions give, and what motors need, once q̈ is known.
    #[inline(always)]
    pub(super) fn take_prescribed(&mut self, robot: &Robot, x: &[T]) {
        let n = robot.len();
        let Self { prescribed, coupling, ddq, ddtheta, spring, ratio, drive: resisting, .. } = self;
        let Some(prescribed) = prescribed else { return };
        ddtheta.copy_from_slice(&x[prescribed.first..][..n]);
        for j in rigid(robot) {
            spring[j] += product(&prescribed.mass[j * n..][..n], ddq);
        }
        for (j, drive) in robot.drives.iter().enumerate() {
            let own = if has_own_motor(robot, j) { ddtheta[j] * drive.motor_inertia } else { T::default() };
            prescribed.torque[j] = own + coupling.pull(j, ddq) + ratio[j] * spring[j] - resisting[j];
        }
        for motor in robot.gearing.iter().flat_map(|gearing| gearing.motors()) {
            let own = motor.speed(|j| ddtheta[j]) * robot.drives[motor.drive].motor_inertia;
            motor.joints().for_each(|(j, by)| prescribed.torque[j] += own * by);
        }
    }

    /// Derivatives of the same, from those of both rows with accelerations held.
    #[inline(always)]
    pub(super) fn differentiate_prescribed(&mut self, robot: &Robot, layout: &ElasticLayout) {
        let (n, d) = (layout.joints, layout.dense);
        let Self { prescribed, coupling, mass, ddq_by, ddtheta_by, .. } = self;
        let Some(prescribed) = prescribed else { return };
        let (first, row) = (prescribed.first, |j: usize| j * d..(j + 1) * d);
        for j in 0..n {
            coupling.coupled(j).for_each(|(i, s)| ddq_by[i * d + first + j] -= s);
        }
        for j in rigid(robot) {
            let own = prescribed.joint_torque_by[row(j)].iter_mut().zip(&ddq_by[row(j)]);
            own.for_each(|(out, by)| *out = -*by);
        }
        for j in rigid(robot) {
            (0..n).for_each(|i| ddq_by[i * d + first + j] -= prescribed.mass[i * n + j]);
        }
        for j in rigid(robot) {
            ddq_by[row(j)].fill(T::default());
            ddq_by[j * d + first + j] = T::constant(1.0);
        }
        linear::solve(&mass[..n * n], n, ddq_by, d);
        let Prescribed { mass, torque_by, joint_torque_by, .. } = &mut **prescribed;
        for j in rigid(robot) {
            for (entry, by) in mass[j * n..][..n].iter().zip(ddq_by.chunks_exact(d)) {
                linear::add_scaled(&mut joint_torque_by[row(j)], *entry, by);
            }
        }
        for (j, drive) in robot.drives.iter().enumerate() {
            let own = &mut ddtheta_by[row(j)];
            coupling.subtract_pull(j, ddq_by, own);
            torque_by[row(j)].iter_mut().zip(&*own).for_each(|(out, by)| *out = -*by);
            if !drive.elastic {
                linear::add_scaled(&mut torque_by[row(j)], T::constant(1.0), &joint_torque_by[row(j)]);
            }
            if has_own_motor(robot, j) {
                torque_by[j * d + first + j] += T::constant(drive.motor_inertia);
            }
            own.fill(T::default());
            own[first + j] = T::constant(1.0);
        }
        for motor in robot.gearing.iter().flat_map(|gearing| gearing.motors()) {
            let inertia = robot.drives[motor.drive].motor_inertia;
            for (j, by) in motor.joints() {
                motor.joints().for_each(|(k, other)| torque_by[j * d + first + k] += T::constant(by * other * inertia));
            }
        }
    }

    /// Accelerations by further torques on links and in transmissions, as `respond` has them where motors' accelerations are
    /// states; in place of those on motors what motors need more.
    #[inline(always)]
    pub(super) fn respond_prescribed(&self, robot: &Robot, [links, motors, transmitted]: [&mut [T]; 3], width: usize) {
        let (n, row) = (robot.len(), |j: usize| j * width..(j + 1) * width);
        let Some(prescribed) = &self.prescribed else { return };
        for j in rigid(robot) {
            let own = transmitted[row(j)].iter_mut().zip(&mut links[row(j)]);
            own.for_each(|(out, link)| *out = -core::mem::take(link));
        }
        linear::solve(&self.mass[..n * n], n, links, width);
        for j in rigid(robot) {
            for (entry, link) in prescribed.mass[j * n..][..n].iter().zip(links.chunks_exact(width)) {
                linear::add_scaled(&mut transmitted[row(j)], *entry, link);
            }
            linear::add_scaled(&mut motors[row(j)], T::constant(-1.0), &transmitted[row(j)]);
        }
        for j in 0..n {
            self.coupling.subtract_pull(j, links, &mut motors[row(j)]);
            motors[row(j)].iter_mut().for_each(|x| *x = -*x);
        }
    }

    /// What torques motors need (n) [N m], after [`accelerate`](Self::accelerate); none where torques move motors.
    #[inline(always)]
    pub fn motor_torques(&self) -> &[T] {
        self.prescribed.as_ref().map_or(&[], |prescribed| &prescribed.torque)
    }

    /// Their derivatives by the state (n × dense), after [`differentiate`](Self::differentiate).
    #[inline(always)]
    pub fn motor_torques_by(&self) -> &[T] {
        self.prescribed.as_ref().map_or(&[], |prescribed| &prescribed.torque_by)
    }

    /// Derivatives of what the transmission of joint `j`, rigid, gives its link; none where torques move motors.
    #[inline(always)]
    pub(crate) fn rigid_torque_by(&self, j: usize) -> Option<&[T]> {
        self.prescribed.as_ref().map(|prescribed| {
            let d = prescribed.joint_torque_by.len() / prescribed.torque.len();
            &prescribed.joint_torque_by[j * d..][..d]
        })
    }
}

/// Joints whose links move as their motors.
#[inline(always)]
fn rigid(robot: &Robot) -> impl Iterator<Item = usize> + '_ {
    robot.drives.iter().enumerate().filter(|(_, drive)| !drive.elastic).map(|(j, _)| j)
}

/// Whether joint `j` has a motor, and that turns no other joint.
#[inline(always)]
fn has_own_motor(robot: &Robot, j: usize) -> bool {
    !robot.drives[j].is_passive() && robot.gearing.as_ref().is_none_or(|gearing| !gearing.has(j))
}

#[inline(always)]
fn product<T: Scalar>(a: &[T], b: &[T]) -> T {
    a.iter().zip(b).fold(T::default(), |sum, (a, b)| sum + *a * *b)
}
