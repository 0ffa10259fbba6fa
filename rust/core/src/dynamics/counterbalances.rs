//! What counterbalances take off the torques of gravity, and its slopes.
//!
//! With a potential V(q) the torque ∂V/∂q joins the load. Of a strut of length ℓ = |d|, d from one end to the other and N its
//! tension, that is N/ℓ d·∂d/∂q, and
//!
//! ```text
//! ∂²V/∂qᵢ∂qⱼ = N/ℓ (∂ᵢd·∂ⱼd + d·∂ᵢⱼd) + (N′ − N/ℓ)/ℓ² (d·∂ᵢd)(d·∂ⱼd).
//! ```

use super::Kinematics;
use crate::robot::{Body, JointKind, Linkage, Strut, Support, Tree, add_angles};
use crate::scalar::Scalar;
use crate::simd::{self, Kernel};
use crate::spatial::{Mat3, Vec3};

/// Where the line between two points that meet is taken to have a direction [m²].
const TOUCHING: f64 = 1e-18;

/// A body's axes and origin, in whatever frame torques are reckoned in.
#[derive(Clone, Copy)]
pub(super) struct Pose<T> {
    pub(super) axes: Mat3<T>,
    pub(super) origin: Vec3<T>,
}

impl<T: Scalar> Pose<T> {
    /// Of the frame itself.
    #[inline(always)]
    pub(super) fn identity() -> Self {
        Self { axes: Mat3::constant(&Mat3::IDENTITY), origin: Vec3::default() }
    }

    #[inline(always)]
    fn point(&self, local: &Vec3<f64>) -> Vec3<T> {
        self.origin + self.axes.apply_constant(local)
    }

    /// How `point` moves by the joint of the body that is here.
    #[inline(always)]
    fn moves(&self, body: &Body, point: &Vec3<T>) -> Vec3<T> {
        match body.kind {
            JointKind::Revolute => self.axes.0[2].cross(&(*point - self.origin)),
            JointKind::Prismatic => self.axes.0[2],
        }
    }
}

/// Where bodies are, relative to one that carries them.
pub(super) trait Posture<T: Scalar> {
    /// Of the body from which others are looked at; none for the base.
    fn stem(&self, body: Option<usize>) -> Pose<T>;

    /// Of `body`, whose carrier is at `carrier`.
    fn carried(&self, tree: &Tree, body: usize, carrier: &Pose<T>) -> Pose<T>;

    /// Sine and cosine of the angle by which the joint of `body` has turned.
    fn turn(&self, tree: &Tree, body: usize) -> (T, T);
}

/// In the base frame.
impl<T: Scalar> Posture<T> for Kinematics<T> {
    #[inline(always)]
    fn stem(&self, body: Option<usize>) -> Pose<T> {
        let of = |i: usize| Pose { axes: self.bodies[i].rotation, origin: self.bodies[i].origin };
        body.map_or_else(Pose::identity, of)
    }

    #[inline(always)]
    fn carried(&self, _: &Tree, body: usize, _: &Pose<T>) -> Pose<T> {
        self.stem(Some(body))
    }

    #[inline(always)]
    fn turn(&self, tree: &Tree, body: usize) -> (T, T) {
        let before = tree.bodies[body].rotation.after(&self.stem(tree.bodies[body].parent).axes);
        let x = &self.bodies[body].rotation.0[0];
        (before.0[1].dot(x), before.0[0].dot(x))
    }
}

/// Adds what counterbalances ask of each joint to `tau`.
#[inline(always)]
pub(super) fn load<T: Scalar, P: Posture<T>>(posture: &P, tree: &Tree, tau: &mut [T]) {
    if !tree.supports.is_empty() {
        simd::phase(Load { posture, tree, tau });
    }
}

/// Adds the slopes of that by positions to `by_q`, bodies × bodies.
#[inline(always)]
pub(super) fn stiffen<T: Scalar>(k: &Kinematics<T>, tree: &Tree, by_q: &mut [T]) {
    if !tree.supports.is_empty() {
        simd::phase(Stiffen { k, tree, by_q });
    }
}

/// A strut between two points as bodies now are.
struct Stretched<T> {
    /// Where the chains of bodies to both points begin.
    stem: Pose<T>,
    /// The points, and the way from the first to the second.
    ends: [Vec3<T>; 2],
    apart: Vec3<T>,
    /// N/ℓ, and its slope by ℓ²/2.
    density: T,
    bend: T,
}

impl<T: Scalar> Stretched<T> {
    #[inline(always)]
    fn new<P: Posture<T>>(posture: &P, tree: &Tree, linkage: &Linkage) -> Self {
        let stem = posture.stem(linkage.stem);
        let mut ends = [Vec3::default(); 2];
        for (end, branch) in ends.iter_mut().zip(&linkage.branches) {
            let mut pose = stem;
            for &i in &branch.bodies {
                pose = posture.carried(tree, i, &pose);
            }
            *end = pose.point(&branch.point);
        }
        let apart = ends[1] - ends[0];
        let (density, bend) = density(&linkage.strut, apart.dot(&apart));
        Self { stem, ends, apart, density, bend }
    }
}

/// N/ℓ and its slope by ℓ²/2, of a strut whose ends are apart by the root of `square`.
#[inline(always)]
fn density<T: Scalar>(strut: &Strut, square: T) -> (T, T) {
    let square = square + TOUCHING;
    let length = square.sqrt();
    let (tension, slope) = strut.tension(length);
    let density = tension / length;
    (density, (slope - density) / square)
}

/// Sine and cosine of the sum of the angles of `bodies`' joints.
#[inline(always)]
fn turned<T: Scalar, P: Posture<T>>(posture: &P, tree: &Tree, bodies: &[usize]) -> (T, T) {
    let mut turn = (T::default(), T::constant(1.0));
    for &body in bodies {
        turn = add_angles(turn, posture.turn(tree, body));
    }
    turn
}

struct Load<'a, T, P> {
    posture: &'a P,
    tree: &'a Tree,
    tau: &'a mut [T],
}

impl<T: Scalar, P: Posture<T>> Kernel for Load<'_, T, P> {
    type Output = ();
    const LANES: bool = T::LANES;

    #[inline(always)]
    fn run(self) {
        let Self { posture, tree, tau } = self;
        for support in &tree.supports {
            match support {
                Support::Between(linkage) => {
                    let Stretched { stem, ends, apart, density, .. } = Stretched::new(posture, tree, linkage);
                    let pull = apart.scale(density);
                    for ((branch, end), pull) in linkage.branches.iter().zip(&ends).zip([-pull, pull]) {
                        let mut pose = stem;
                        for &i in &branch.bodies {
                            let body = &tree.bodies[i];
                            pose = posture.carried(tree, i, &pose);
                            tau[body.joint] += body.share(pull.dot(&pose.moves(body, end)));
                        }
                    }
                }
                Support::Turning { bodies, series } => {
                    let torque = series.torque(turned(posture, tree, bodies)).0;
                    for &i in bodies {
                        tau[tree.bodies[i].joint] -= torque;
                    }
                }
            }
        }
    }
}

struct Stiffen<'a, T> {
    k: &'a Kinematics<T>,
    tree: &'a Tree,
    by_q: &'a mut [T],
}

impl<T: Scalar> Kernel for Stiffen<'_, T> {
    type Output = ();
    const LANES: bool = T::LANES;

    #[inline(always)]
    fn run(self) {
        let Self { k, tree, by_q } = self;
        let n = tree.len();
        for support in &tree.supports {
            match support {
                Support::Between(linkage) => {
                    let at = Stretched::new(k, tree, linkage);
                    let joints = || (0..2).flat_map(|s| linkage.branches[s].bodies.iter().map(move |&i| (s, i)));
                    // ∂d/∂q of one joint.
                    let column = |(side, i): (usize, usize)| {
                        let moves = k.bodies[i].axis.at(&at.ends[side]);
                        if side == 0 { -moves } else { moves }
                    };
                    for (p, outer) in joints().enumerate() {
                        let by_outer = column(outer);
                        for inner in joints().take(p + 1) {
                            let by_inner = column(inner);
                            let mut both = by_inner.dot(&by_outer);
                            if inner.0 == outer.0 {
                                both += at.apart.dot(&k.bodies[inner.1].axis.angular.cross(&by_outer));
                            }
                            let bend = at.apart.dot(&by_inner) * at.apart.dot(&by_outer) * at.bend;
                            let slope = both * at.density + bend;
                            let [a, b] = [inner.1, outer.1].map(|i| tree.bodies[i].joint);
                            by_q[a * n + b] += slope;
                            if inner != outer {
                                by_q[b * n + a] += slope;
                            }
                        }
                    }
                }
                Support::Turning { bodies, series } => {
                    let slope = series.torque(turned(k, tree, bodies)).1;
                    for (&i, &j) in bodies.iter().flat_map(|i| bodies.iter().map(move |j| (i, j))) {
                        by_q[tree.bodies[i].joint * n + tree.bodies[j].joint] -= slope;
                    }
                }
            }
        }
    }
}
