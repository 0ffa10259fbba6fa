//! Poses, axes, velocities and accelerations of all bodies, in the base frame.

use super::wrenches::Applied;
use crate::robot::{JointKind, Tree};
use crate::scalar::Scalar;
use crate::simd::{self, Kernel};
use crate::spatial::{Inertia, Mat3, Motion, Sym3, Vec3};

/// One body's state.
///
/// With S the joint's axis and λ the carrying body: `axis_rate` = v_λ × S is how fast the axis moves, and
/// `axis_acceleration` = a_λ × S + v_λ × (v_λ × S). They are all that derivatives in q and q̇ need
/// (Singh, Russell and Wensing 2022).
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct BodyState<T> {
    /// Orientation of the body's frame in the base frame.
    pub(crate) rotation: Mat3<T>,
    /// Its origin in the base frame [m].
    pub(crate) origin: Vec3<T>,
    /// S, the motion per unit of the joint's velocity.
    pub(crate) axis: Motion<T>,
    /// v = v_λ + S q̇.
    pub(crate) velocity: Motion<T>,
    /// v_λ × S.
    pub(crate) axis_rate: Motion<T>,
    /// a = a_λ + S q̈ + (v_λ × S) q̇, with the base accelerated against gravity.
    pub(crate) acceleration: Motion<T>,
    /// a_λ × S + v_λ × (v_λ × S).
    pub(crate) axis_acceleration: Motion<T>,
}

/// Scratch for one robot's kinematics.
///
/// ```
/// use linkside_core::dynamics::Kinematics;
///
/// let robot = linkside_core::demo::arm()?;
/// let mut kinematics = Kinematics::new(&robot.tree);
/// // A quarter turn at 2 rad/s: the tip is on the y axis, and its accelerometer feels the pull towards the joint.
/// kinematics.set(&robot.tree, &[std::f64::consts::FRAC_PI_2], &[2.0], &[0.0]);
/// let tip = kinematics.position(robot.tool.as_ref().unwrap()).0;
/// let reading = kinematics.specific_force(&robot.accelerometers[0].frame).0;
/// assert!((tip[1] - 1.0).abs() < 1e-12 && (reading[0] + 4.0).abs() < 1e-12 && (reading[2] - 9.81).abs() < 1e-12);
/// # Ok::<(), linkside_core::error::RobotError>(())
/// ```
#[derive(Clone, Debug)]
pub struct Kinematics<T> {
    /// In the order of the tree, each after the one that carries it.
    pub(crate) bodies: Vec<BodyState<T>>,
    /// Moments of mass in the bodies' own frames, where they are not those of the tree; else empty.
    masses: Vec<Inertia<T>>,
    /// Forces from outside, one each of the tree's wrenches.
    pub(super) wrenches: Vec<Applied<T>>,
}

impl<T: Scalar> Kinematics<T> {
    /// Room for `tree`.
    pub fn new(tree: &Tree) -> Self {
        Self { bodies: vec![BodyState::default(); tree.bodies.len()], masses: Vec::new(), wrenches: Applied::all(tree) }
    }

    /// Computes with `masses`, the moments of each body's mass in its own frame, in place of the tree's: so that loads
    /// have derivatives in them.
    pub(crate) fn set_masses(&mut self, masses: Vec<Inertia<T>>) {
        self.masses = masses;
    }

    /// Exchanges those masses for others.
    pub(crate) fn swap_masses(&mut self, masses: &mut Vec<Inertia<T>>) {
        core::mem::swap(&mut self.masses, masses);
    }

    /// Positions, velocities and accelerations at once; each of length n, in the order of the log.
    #[inline]
    pub fn set(&mut self, tree: &Tree, q: &[T], dq: &[T], ddq: &[T]) {
        simd::phase(Set { kinematics: self, tree, q, dq, ddq });
    }

    /// As [`set`](Self::set), without what only derivatives in q need.
    #[inline(always)]
    pub fn set_motion(&mut self, tree: &Tree, q: &[T], dq: &[T], ddq: &[T]) {
        self.set_position(tree, q);
        self.set_velocity(tree, dq);
        self.set_acceleration(tree, dq, ddq);
    }

    /// Poses and axes at q.
    #[inline(always)]
    pub fn set_position(&mut self, tree: &Tree, q: &[T]) {
        for (i, body) in tree.bodies.iter().enumerate() {
            // A tree is in topological order: the carrier has been set when its bodies come.
            let (carrier, origin) = match body.parent {
                Some(p) => {
                    let parent = &self.bodies[p];
                    let rotation = body.rotation.after(&parent.rotation);
                    (rotation, parent.origin + parent.rotation.apply_constant(&body.translation))
                }
                None => (body.rotation.after(&Mat3::constant(&Mat3::IDENTITY)), Vec3::constant(&body.translation)),
            };
            let z = carrier.0[2];
            let position = body.position(q[body.joint]);
            let state = &mut self.bodies[i];
            match body.kind {
                JointKind::Revolute => {
                    state.rotation = carrier.turn_about_z(position.sin_cos());
                    state.origin = origin;
                    state.axis = Motion { angular: z, linear: origin.cross(&z) };
                }
                JointKind::Prismatic => {
                    state.rotation = carrier;
                    state.origin = origin + z.scale(position);
                    state.axis = Motion { angular: Vec3::default(), linear: z };
                }
            }
            if let Some([ratio, _]) = body.following {
                state.axis = state.axis.scale(T::constant(ratio));
            }
        }
    }

    /// Velocities at q̇; after [`set_position`](Self::set_position).
    #[inline(always)]
    pub fn set_velocity(&mut self, tree: &Tree, dq: &[T]) {
        for (i, body) in tree.bodies.iter().enumerate() {
            let carrier = body.parent.map_or_else(Motion::default, |p| self.bodies[p].velocity);
            let state = &mut self.bodies[i];
            state.axis_rate = carrier.cross(&state.axis);
            state.velocity = carrier + state.axis.scale(dq[body.joint]);
        }
    }

    /// Accelerations at q̇ and q̈, the base accelerated against gravity; after [`set_velocity`](Self::set_velocity).
    #[inline(always)]
    pub fn set_acceleration(&mut self, tree: &Tree, dq: &[T], ddq: &[T]) {
        for (i, body) in tree.bodies.iter().enumerate() {
            let carrier = self.carrier_acceleration(tree, body.parent);
            let state = &mut self.bodies[i];
            state.acceleration = carrier + state.axis.scale(ddq[body.joint]) + state.axis_rate.scale(dq[body.joint]);
        }
    }

    /// How the axes accelerate; after [`set_acceleration`](Self::set_acceleration).
    #[inline(always)]
    fn set_axis_acceleration(&mut self, tree: &Tree) {
        for (i, body) in tree.bodies.iter().enumerate() {
            let carrier = self.carrier_acceleration(tree, body.parent);
            let velocity = body.parent.map_or_else(Motion::default, |p| self.bodies[p].velocity);
            let state = &mut self.bodies[i];
            state.axis_acceleration = carrier.cross(&state.axis) + velocity.cross(&state.axis_rate);
        }
    }

    /// a_λ; of the base −g, so that gravity needs no text of its own (Luh, Walker and Paul 1980).
    #[inline(always)]
    fn carrier_acceleration(&self, tree: &Tree, parent: Option<usize>) -> Motion<T> {
        match parent {
            Some(p) => self.bodies[p].acceleration,
            None => Motion { angular: Vec3::default(), linear: Vec3::constant(&-tree.gravity) },
        }
    }

    /// The body's moments of mass about the base origin.
    #[inline(always)]
    pub(crate) fn inertia(&self, tree: &Tree, i: usize) -> Inertia<T> {
        let BodyState { rotation, origin, .. } = &self.bodies[i];
        if let Some(own) = self.masses.get(i) {
            return own.moved(rotation, origin);
        }
        let local = &tree.bodies[i].inertia;
        let offset = rotation.apply_constant(&local.first);
        let first = offset + *origin * local.mass;
        let mut second = Sym3::rotated(&local.second, rotation);
        // offset·oᵀ + o·(offset + m o)ᵀ, the parallel-axis terms, is symmetric only as a sum.
        second += Sym3::outer(&offset, origin);
        second += Sym3::outer(origin, &first);
        Inertia { mass: T::constant(local.mass), first, second }
    }
}

/// [`Kinematics::set`], to be compiled for each instruction set.
struct Set<'a, T> {
    kinematics: &'a mut Kinematics<T>,
    tree: &'a Tree,
    q: &'a [T],
    dq: &'a [T],
    ddq: &'a [T],
}

impl<T: Scalar> Kernel for Set<'_, T> {
    type Output = ();
    const LANES: bool = T::LANES;

    #[inline(always)]
    fn run(self) {
        let Self { kinematics, tree, q, dq, ddq } = self;
        kinematics.set_motion(tree, q, dq, ddq);
        kinematics.set_axis_acceleration(tree);
    }
}
