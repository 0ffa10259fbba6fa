//! Inverse dynamics and sensors alone, and the mass matrix, each body in its own axes: half the work of [`Kinematics`](super::Kinematics) with
//! [`Loads`](super::Loads), which derivatives and matrices need.

use super::counterbalances::{self, Pose, Posture};
use super::wrenches::{Applied, apply};
use crate::robot::{Body, Frame, JointKind, Tree};
use crate::scalar::Scalar;
use crate::spatial::{Inertia, Mat3, Vec3};

/// How a body moves, and what that takes, in its own axes.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Moving<T> {
    /// Sine and cosine of a revolute joint's position; a prismatic one's position, and 1.
    pub(super) turn: (T, T),
    /// ω and ω̇ in the body's axes.
    angular_velocity: Vec3<T>,
    angular_acceleration: Vec3<T>,
    /// Of the origin, against free fall.
    acceleration: Vec3<T>,
    /// Γ = [α]× + ω ωᵀ − ω² 1: the point at r accelerates by Γ r more than the origin.
    gradient: Mat3<T>,
    /// Force, and moment about the origin, on this body and all that it carries.
    force: Vec3<T>,
    moment: Vec3<T>,
}

/// Motion of a body whose joint is held, in its axes.
struct Carried<T> {
    /// ω, ω̇, and the origin's acceleration against free fall.
    angular_velocity: Vec3<T>,
    angular_acceleration: Vec3<T>,
    acceleration: Vec3<T>,
}

impl<T: Scalar> Carried<T> {
    /// On a base at rest.
    #[inline(always)]
    fn at_rest(body: &Body, gravity: &Vec3<f64>) -> Self {
        Self {
            angular_velocity: Vec3::default(),
            angular_acceleration: Vec3::default(),
            acceleration: Vec3::constant(&-body.rotation.turn_back(gravity)),
        }
    }
}

/// Scratch of the recursive Newton–Euler algorithm for one robot.
///
/// Luh, Walker and Paul (1980), written in moments of mass: with Γ constant over a body its momentum changes by
/// m a + Γ∫r dm, and its moment of momentum by ∫r dm × a and the skew part of Γ∫r rᵀ dm.
///
/// ```
/// use linkside_core::dynamics::NewtonEuler;
/// use linkside_core::scalar::Dual;
///
/// let robot = linkside_core::demo::arm()?;
/// let mut recursion = NewtonEuler::<Dual<1>>::new(&robot.tree);
/// // The derivative of the torque by q̈ is the inertia: of numbers that carry one, it comes along.
/// let [zero, one] = [0.0, 1.0].map(|x| Dual { value: x, gradient: [x] });
/// recursion.set(&robot.tree, &[zero], &[zero], &[one]);
/// let mut tau = [Dual::default()];
/// recursion.inverse_dynamics_into(&robot.tree, &mut tau);
/// assert!((tau[0].gradient[0] - 1.65).abs() < 1e-12);
/// # Ok::<(), linkside_core::error::RobotError>(())
/// ```
#[derive(Clone, Debug)]
pub struct NewtonEuler<T> {
    /// One a body, in the order of the tree.
    pub(super) bodies: Vec<Moving<T>>,
    /// Forces from outside, one each of the tree's wrenches.
    wrenches: Vec<Applied<T>>,
    /// Moments of mass of each body together with all that it carries, in its own axes.
    pub(super) composites: Vec<Inertia<T>>,
}

impl<T: Scalar> NewtonEuler<T> {
    /// Room for `tree`.
    pub fn new(tree: &Tree) -> Self {
        let count = tree.bodies.len();
        Self {
            bodies: vec![Moving::default(); count],
            wrenches: Applied::all(tree),
            composites: vec![Inertia::default(); count],
        }
    }

    /// Moves all bodies; positions, velocities and accelerations of length n, in the order of the log.
    #[inline(always)]
    pub fn set(&mut self, tree: &Tree, q: &[T], dq: &[T], ddq: &[T]) {
        self.set_position(tree, q);
        self.set_motion(tree, dq, ddq);
    }

    /// Positions alone, which is what a [mass matrix](Self::mass_matrix_into) takes.
    #[inline(always)]
    pub fn set_position(&mut self, tree: &Tree, q: &[T]) {
        for (moving, body) in self.bodies.iter_mut().zip(&tree.bodies) {
            let position = body.position(q[body.joint]);
            moving.turn = match body.kind {
                JointKind::Revolute => position.sin_cos(),
                JointKind::Prismatic => (position, T::constant(1.0)),
            };
        }
    }

    /// Velocities and accelerations at the positions that were set.
    #[inline(always)]
    pub fn set_motion(&mut self, tree: &Tree, dq: &[T], ddq: &[T]) {
        for (i, body) in tree.bodies.iter().enumerate() {
            let carried = match body.parent {
                Some(p) => self.bodies[p].carry(body),
                None => Carried::at_rest(body, &tree.gravity),
            };
            let (dq, ddq) = (body.share(dq[body.joint]), body.share(ddq[body.joint]));
            match body.kind {
                JointKind::Revolute => self.bodies[i].revolve(&carried, dq, ddq),
                JointKind::Prismatic => self.bodies[i].slide(carried, dq, ddq),
            }
        }
    }

    /// Lets the varying wrenches be `values`, six numbers each.
    #[inline(always)]
    pub(crate) fn apply_wrenches(&mut self, tree: &Tree, values: &[T]) {
        apply(tree, values, &mut self.wrenches);
    }

    /// τ (n) for the state that was set.
    #[inline(always)]
    pub fn inverse_dynamics_into(&mut self, tree: &Tree, tau: &mut [T]) {
        for (moving, body) in self.bodies.iter_mut().zip(&tree.bodies) {
            moving.load(&body.inertia);
        }
        for applied in &self.wrenches {
            let moving = &mut self.bodies[applied.body];
            moving.force -= applied.force;
            moving.moment -= applied.moment;
        }
        tau.fill(T::default());
        for (i, body) in tree.bodies.iter().enumerate().rev() {
            let Moving { force, moment, .. } = self.bodies[i];
            tau[body.joint] += body.share(match body.kind {
                JointKind::Revolute => moment.0[2],
                JointKind::Prismatic => force.0[2],
            });
            if let Some(p) = body.parent {
                let (force, moment) = self.bodies[i].hand_over(body, force, moment);
                self.bodies[p].force += force;
                self.bodies[p].moment += moment;
            }
        }
        counterbalances::load(self, tree, tau);
    }

    /// Position in the base frame at the positions that were set, as [`Kinematics::position`](super::Kinematics::position) [m].
    #[inline(always)]
    pub fn position(&self, tree: &Tree, frame: &Frame) -> Vec3<T> {
        let mut point = Vec3::constant(&frame.translation);
        for i in tree.path(frame.body) {
            point = self.bodies[i].point_in_carrier(&tree.bodies[i], &point);
        }
        point
    }

    /// Specific force of an ideal accelerometer, as [`Kinematics::specific_force`](super::Kinematics::specific_force)
    /// [m/s²].
    #[inline(always)]
    pub fn specific_force(&self, frame: &Frame) -> Vec3<T> {
        frame.rotation.turn_back(&self.specific_force_of_body(frame))
    }

    /// The same in the axes of the body.
    #[inline(always)]
    pub(crate) fn specific_force_of_body(&self, frame: &Frame) -> Vec3<T> {
        let body = &self.bodies[frame.body];
        body.acceleration + body.gradient.apply_constant(&frame.translation)
    }

    /// Angular velocity in the frame's own axes [rad/s]: an ideal gyroscope.
    #[inline(always)]
    pub fn angular_rate(&self, frame: &Frame) -> Vec3<T> {
        frame.rotation.turn_back(&self.angular_rate_of_body(frame))
    }

    /// The same in the axes of the body.
    #[inline(always)]
    pub(crate) fn angular_rate_of_body(&self, frame: &Frame) -> Vec3<T> {
        self.bodies[frame.body].angular_velocity
    }
}

/// In the frame of the body from which others are looked at.
impl<T: Scalar> Posture<T> for NewtonEuler<T> {
    #[inline(always)]
    fn stem(&self, _: Option<usize>) -> Pose<T> {
        Pose::identity()
    }

    #[inline(always)]
    fn carried(&self, tree: &Tree, body: usize, carrier: &Pose<T>) -> Pose<T> {
        let (Body { kind, rotation, translation, .. }, turn) = (&tree.bodies[body], self.bodies[body].turn);
        let axes = rotation.after(&carrier.axes);
        let origin = carrier.origin + carrier.axes.apply_constant(translation);
        match kind {
            JointKind::Revolute => Pose { axes: axes.turn_about_z(turn), origin },
            JointKind::Prismatic => Pose { axes, origin: origin + axes.0[2].scale(turn.0) },
        }
    }

    #[inline(always)]
    fn turn(&self, _: &Tree, body: usize) -> (T, T) {
        self.bodies[body].turn
    }
}

impl<T: Scalar> Moving<T> {
    /// A point in this body's axes, in those of the carrying body.
    #[inline(always)]
    fn point_in_carrier(&self, body: &Body, point: &Vec3<T>) -> Vec3<T> {
        let [x, y, z] = point.0;
        let moved = match body.kind {
            JointKind::Revolute => {
                let (sin, cos) = self.turn;
                Vec3([x * cos - y * sin, y * cos + x * sin, z])
            }
            JointKind::Prismatic => Vec3([x, y, z + self.turn.0]),
        };
        let turned = body.rotation.turn(&moved);
        let [x, y, z] = body.translation.0;
        Vec3([turned.0[0] + x, turned.0[1] + y, turned.0[2] + z])
    }

    /// How a body that this one carries moves, its joint held at zero.
    #[inline(always)]
    fn carry(&self, body: &Body) -> Carried<T> {
        let acceleration = self.acceleration + self.gradient.apply_constant(&body.translation);
        Carried {
            angular_velocity: body.rotation.turn_back(&self.angular_velocity),
            angular_acceleration: body.rotation.turn_back(&self.angular_acceleration),
            acceleration: body.rotation.turn_back(&acceleration),
        }
    }

    /// A revolute joint turns by q about z: ω += q̇ z, ω̇ += q̈ z + ω × q̇ z.
    #[inline(always)]
    fn revolve(&mut self, carried: &Carried<T>, dq: T, ddq: T) {
        let (sin, cos) = self.turn;
        // Into the turned axes; z stays.
        let back = |v: &Vec3<T>| Vec3([v.0[0] * cos + v.0[1] * sin, v.0[1] * cos - v.0[0] * sin, v.0[2]]);
        let [x, y, z] = back(&carried.angular_velocity).0;
        let [dx, dy, dz] = back(&carried.angular_acceleration).0;
        self.angular_velocity = Vec3([x, y, z + dq]);
        self.angular_acceleration = Vec3([dx + y * dq, dy - x * dq, dz + ddq]);
        self.acceleration = back(&carried.acceleration);
        self.set_gradient();
    }

    /// A prismatic joint moves the origin by q along z: a += Γ q z + 2 ω × q̇ z + q̈ z.
    #[inline(always)]
    fn slide(&mut self, carried: Carried<T>, dq: T, ddq: T) {
        self.angular_velocity = carried.angular_velocity;
        self.angular_acceleration = carried.angular_acceleration;
        self.set_gradient();
        let [x, y, _] = self.angular_velocity.0;
        let twice = dq + dq;
        let sliding = Vec3([y * twice, -(x * twice), ddq]);
        self.acceleration = carried.acceleration + self.gradient.0[2].scale(self.turn.0) + sliding;
    }

    /// Γ from ω and ω̇.
    #[inline(always)]
    fn set_gradient(&mut self) {
        let ([x, y, z], [a, b, c]) = (self.angular_velocity.0, self.angular_acceleration.0);
        let (xx, yy, zz) = (x * x, y * y, z * z);
        let (xy, xz, yz) = (x * y, x * z, y * z);
        self.gradient = Mat3([
            Vec3([-(yy + zz), xy + c, xz - b]),
            Vec3([xy - c, -(xx + zz), yz + a]),
            Vec3([xz + b, yz - a, -(xx + yy)]),
        ]);
    }

    /// What the body's own mass takes.
    #[inline(always)]
    fn load(&mut self, mass: &Inertia<f64>) {
        let [x, y, z] = self.gradient.0.map(|column| column.0);
        let [sx, sy, sz] = mass.second.columns().map(|column| column.0);
        // Entry (row, column) of Γ∫r rᵀ dm.
        let entry = |row: usize, s: &[f64; 3]| x[row] * s[0] + y[row] * s[1] + z[row] * s[2];
        let [a, b, c] = self.acceleration.0;
        let [fx, fy, fz] = mass.first.0;
        self.force = self.acceleration * mass.mass + self.gradient.apply_constant(&mass.first);
        self.moment = Vec3([
            c * fy - b * fz + entry(2, &sy) - entry(1, &sz),
            a * fz - c * fx + entry(0, &sz) - entry(2, &sx),
            b * fx - a * fy + entry(1, &sx) - entry(0, &sy),
        ]);
    }

    /// A force and a moment about this body's origin, in the axes of the carrying body and about its origin.
    #[inline(always)]
    pub(super) fn hand_over(&self, body: &Body, mut force: Vec3<T>, mut moment: Vec3<T>) -> (Vec3<T>, Vec3<T>) {
        match body.kind {
            JointKind::Revolute => {
                let (sin, cos) = self.turn;
                let turn = |v: &Vec3<T>| Vec3([v.0[0] * cos - v.0[1] * sin, v.0[1] * cos + v.0[0] * sin, v.0[2]]);
                (force, moment) = (turn(&force), turn(&moment));
            }
            JointKind::Prismatic => {
                let q = self.turn.0;
                moment += Vec3([-(q * force.0[1]), q * force.0[0], T::default()]);
            }
        }
        let (force, moment) = (body.rotation.turn(&force), body.rotation.turn(&moment));
        let ([x, y, z], [a, b, c]) = (force.0, body.translation.0);
        (force, moment + Vec3([z * b - y * c, x * c - z * a, y * a - x * b]))
    }
}
