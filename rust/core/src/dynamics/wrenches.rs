//! What wrenches from outside take off the torques of a motion, and its slopes.
//!
//! A wrench is carried by its link. The force f that it is about the base origin changes with joint j, which carries it, by
//! Sⱼ ×* f, and only in torques of joints further in: ∂(Sᵢ·f)/∂qⱼ = Sᵢ·(Sⱼ ×* f) for i before j, else none.

use super::Kinematics;
use crate::robot::{Acting, Frame, Tree, WRENCH};
use crate::scalar::Scalar;
use crate::spatial::{Force, Vec3};

/// A wrench on a body, in its axes and about its origin.
#[derive(Clone, Copy, Debug)]
pub(super) struct Applied<T> {
    pub(super) body: usize,
    pub(super) force: Vec3<T>,
    pub(super) moment: Vec3<T>,
}

impl<T: Scalar> Applied<T> {
    #[inline(always)]
    fn new(frame: &Frame, values: &[T]) -> Self {
        let [force, moment] = [0, 3].map(|first| Vec3([0, 1, 2].map(|axis| values[first + axis])));
        let (force, moment) = (frame.rotation.turn(&force), frame.rotation.turn(&moment));
        let lever = Vec3::constant(&frame.translation);
        Self { body: frame.body, force, moment: moment + lever.cross(&force) }
    }

    /// All wrenches of a tree; those that vary are zero.
    pub(super) fn all(tree: &Tree) -> Vec<Self> {
        let of = |acting: Acting| match acting {
            Acting::Constant(values) => values.map(T::constant),
            Acting::Varying { .. } => [T::default(); WRENCH],
        };
        tree.wrenches.iter().map(|wrench| Self::new(&wrench.frame, &of(wrench.acting))).collect()
    }
}

/// Puts the `values` of varying wrenches, [`WRENCH`] each, into `applied`.
#[inline(always)]
pub(super) fn apply<T: Scalar>(tree: &Tree, values: &[T], applied: &mut [Applied<T>]) {
    let varying = |acting: Acting| matches!(acting, Acting::Varying { .. });
    let vary = tree.wrenches.iter().zip(applied).filter(|(wrench, _)| varying(wrench.acting));
    for ((wrench, applied), values) in vary.zip(values.chunks_exact(WRENCH)) {
        *applied = Applied::new(&wrench.frame, values);
    }
}

impl<T: Scalar> Kinematics<T> {
    /// Lets the varying wrenches be `values`, six numbers each.
    #[inline(always)]
    pub(crate) fn apply_wrenches(&mut self, tree: &Tree, values: &[T]) {
        apply(tree, values, &mut self.wrenches);
    }

    /// What each number of each varying wrench adds to each joint's torque, at the posture that was set: number, joint, by
    /// how much.
    #[inline(always)]
    pub(crate) fn wrench_map(&self, tree: &Tree, mut put: impl FnMut(usize, usize, T)) {
        for (k, wrench) in tree.varying().enumerate() {
            let placed = self.place(&wrench.frame);
            for i in tree.path(placed.body) {
                let (joint, axis) = (tree.bodies[i].joint, &self.bodies[i].axis);
                let (by_force, by_moment) = (axis.at(&placed.point), axis.angular);
                for (c, direction) in placed.axes.0.iter().enumerate() {
                    put(WRENCH * k + c, joint, direction.dot(&by_force));
                    put(WRENCH * k + 3 + c, joint, direction.dot(&by_moment));
                }
            }
        }
    }

    /// About the base origin.
    #[inline(always)]
    fn in_base(&self, applied: &Applied<T>) -> Force<T> {
        let body = &self.bodies[applied.body];
        let force = body.rotation.apply(&applied.force);
        Force { moment: body.rotation.apply(&applied.moment) + body.origin.cross(&force), force }
    }
}

/// Takes off `tau` (n) what wrenches give.
#[inline(never)]
pub(super) fn load<T: Scalar>(k: &Kinematics<T>, tree: &Tree, tau: &mut [T]) {
    for applied in &k.wrenches {
        let force = k.in_base(applied);
        for i in tree.path(applied.body) {
            tau[tree.bodies[i].joint] -= k.bodies[i].axis.dot(&force);
        }
    }
}

/// The same of their slopes ∂τ/∂q, `by_q` (n × n).
#[inline(never)]
pub(super) fn stiffen<T: Scalar>(k: &Kinematics<T>, tree: &Tree, by_q: &mut [T]) {
    let n = tree.len();
    for applied in &k.wrenches {
        let force = k.in_base(applied);
        for outer in tree.path(applied.body) {
            let change = k.bodies[outer].axis.cross_force(&force);
            for inner in tree.path(outer).skip(1) {
                let (a, b) = (tree.bodies[inner].joint, tree.bodies[outer].joint);
                by_q[a * n + b] -= k.bodies[inner].axis.dot(&change);
            }
        }
    }
}
