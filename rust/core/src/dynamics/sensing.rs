//! What sensors and the tool see, with derivatives. Rows are the frame's own x, y, z unless stated.

use super::Kinematics;
use crate::robot::{Frame, Sensor, Tree};
use crate::scalar::Scalar;
use crate::spatial::{Mat3, Vec3};

/// A frame's axes and position in the base frame, and the body that carries it.
#[derive(Clone, Copy)]
pub(crate) struct Placed<T> {
    /// The body that carries it.
    pub(crate) body: usize,
    /// Its axes and its position in the base frame [m].
    pub(crate) axes: Mat3<T>,
    pub(crate) point: Vec3<T>,
}

impl<T: Scalar> Kinematics<T> {
    /// A frame where its body now is.
    #[inline(always)]
    pub(crate) fn place(&self, frame: &Frame) -> Placed<T> {
        let body = &self.bodies[frame.body];
        Placed {
            body: frame.body,
            axes: body.rotation.mul_constant(&frame.rotation),
            point: body.origin + body.rotation.apply_constant(&frame.translation),
        }
    }

    /// Position in the base frame [m].
    #[inline(always)]
    pub fn position(&self, frame: &Frame) -> Vec3<T> {
        self.place(frame).point
    }

    /// ∂position/∂q, handed to `put` column by column: joint, then the derivative in the base frame.
    #[inline(always)]
    pub fn position_jacobian(&self, tree: &Tree, frame: &Frame, mut put: impl FnMut(usize, Vec3<T>)) {
        let point = self.place(frame).point;
        for i in tree.path(frame.body) {
            put(tree.bodies[i].joint, self.bodies[i].axis.at(&point));
        }
    }

    /// Specific force of an ideal accelerometer in its own axes [m/s²]: Rᵀ(p̈ − gravity), the classical acceleration
    /// of its point (De Luca, Schröder and Thümmel 2007, eqs. (8)–(9)). At rest it reads +9.81 m/s² upwards.
    #[inline(always)]
    pub fn specific_force(&self, frame: &Frame) -> Vec3<T> {
        self.specific_force_at(&self.place(frame))
    }

    /// The same in a frame that was placed.
    #[inline(always)]
    pub(crate) fn specific_force_at(&self, placed: &Placed<T>) -> Vec3<T> {
        let Placed { body, axes, point } = *placed;
        let body = &self.bodies[body];
        let centripetal = body.velocity.angular.cross(&body.velocity.at(&point));
        axes.apply_transposed(&(body.acceleration.at(&point) + centripetal))
    }

    /// An accelerometer's reading, and what a displacement in its own axes adds: ω̇ × r + ω × (ω × r).
    #[inline(always)]
    pub(crate) fn seen(&self, sensor: &Sensor) -> (Vec3<T>, impl Fn(&Vec3<T>) -> Vec3<T>) {
        let placed = self.place(&sensor.frame);
        let body = &self.bodies[placed.body];
        let (rate, turning) = (
            placed.axes.apply_transposed(&body.velocity.angular),
            placed.axes.apply_transposed(&body.acceleration.angular),
        );
        let carry = move |r: &Vec3<T>| turning.cross(r) + rate.cross(&rate.cross(r));
        (self.specific_force_at(&placed), carry)
    }

    /// Derivatives of [`specific_force`](Self::specific_force), handed to `put` joint by joint: in q, in q̇, and in q̈.
    /// The last is the column of T_A of eq. (10); the specific force at q̈ = 0 is its W_A.
    #[inline(always)]
    pub fn specific_force_derivatives(&self, tree: &Tree, frame: &Frame, put: impl FnMut(usize, [Vec3<T>; 3])) {
        self.specific_force_derivatives_at(tree, &self.place(frame), put);
    }

    /// The same in a frame that was placed.
    #[inline(always)]
    pub(crate) fn specific_force_derivatives_at(
        &self,
        tree: &Tree,
        placed: &Placed<T>,
        mut put: impl FnMut(usize, [Vec3<T>; 3]),
    ) {
        let Placed { body: carrier, axes, point } = *placed;
        let velocity = self.bodies[carrier].velocity.at(&point);
        for i in tree.path(carrier) {
            let body = &self.bodies[i];
            // Moving joint i carries the sensor along with its own axes; what remains is how the carried frame itself moves.
            let turning = body.axis_rate.angular.cross(&velocity);
            let by_q = body.axis_acceleration.at(&point) + (turning + turning);
            let half = body.axis_rate.at(&point) + body.axis.angular.cross(&velocity);
            let by_dq = half + half;
            let by_ddq = body.axis.at(&point);
            let (by_q, by_dq) = (axes.apply_transposed(&by_q), axes.apply_transposed(&by_dq));
            put(tree.bodies[i].joint, [by_q, by_dq, axes.apply_transposed(&by_ddq)]);
        }
    }

    /// The columns of T_A alone.
    #[inline(always)]
    pub fn acceleration_map(&self, tree: &Tree, frame: &Frame, mut put: impl FnMut(usize, Vec3<T>)) {
        let Placed { axes, point, .. } = self.place(frame);
        for i in tree.path(frame.body) {
            put(tree.bodies[i].joint, axes.apply_transposed(&self.bodies[i].axis.at(&point)));
        }
    }

    /// Angular velocity in the frame's own axes [rad/s]: an ideal gyroscope.
    #[inline(always)]
    pub fn angular_rate(&self, frame: &Frame) -> Vec3<T> {
        self.place(frame).axes.apply_transposed(&self.bodies[frame.body].velocity.angular)
    }

    /// Derivatives of [`angular_rate`](Self::angular_rate), handed to `put` joint by joint: in q and in q̇.
    #[inline(always)]
    pub fn angular_rate_derivatives(&self, tree: &Tree, frame: &Frame, mut put: impl FnMut(usize, [Vec3<T>; 2])) {
        let axes = self.place(frame).axes;
        for i in tree.path(frame.body) {
            let body = &self.bodies[i];
            let by_q = axes.apply_transposed(&body.axis_rate.angular);
            put(tree.bodies[i].joint, [by_q, axes.apply_transposed(&body.axis.angular)]);
        }
    }
}
