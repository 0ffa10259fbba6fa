//! The kinematic tree, compiled: bodies in topological order, every joint along or about its own z axis.

use super::counterbalance::Support;
use super::{Drive, Rotor, Wrench};
use crate::check::expect_of;
use crate::error::RobotError;
use crate::scalar::Scalar;
use crate::spatial::{FixedRotation, Inertia, Mat3, Sym3, Vec3};
use nalgebra::Matrix3;

/// How a joint moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JointKind {
    /// Turns about its axis [rad].
    Revolute,
    /// Slides along its axis [m].
    Prismatic,
}

/// One moving body as a modeller describes it.
#[derive(Clone, Debug)]
pub struct BodySpec {
    /// The body that carries it; none for the base.
    pub parent: Option<usize>,
    /// Which entry of q moves it.
    pub joint: usize,
    /// How.
    pub kind: JointKind,
    /// Orientation of the joint frame in the parent's frame at q = 0.
    pub rotation: Mat3<f64>,
    /// Position of the joint frame in the parent's frame at q = 0 [m].
    pub translation: Vec3<f64>,
    /// Unit axis in the joint frame.
    pub axis: Vec3<f64>,
    /// Mass [kg].
    pub mass: f64,
    /// Centre of mass in the body's frame [m].
    pub com: Vec3<f64>,
    /// Rotational inertia about the centre of mass, in the body's axes [kg m²].
    pub inertia: Mat3<f64>,
}

/// A body ready for the kernels: its frame turned so that the joint's axis is z.
#[derive(Clone, Debug)]
pub struct Body {
    /// The body that carries it; none for the base.
    pub(crate) parent: Option<usize>,
    /// Entry of q that moves it, and how.
    pub(crate) joint: usize,
    pub(crate) kind: JointKind,
    /// Where it follows another joint's entry: how far it moves for one of that, and where it is at zero.
    pub(crate) following: Option<[f64; 2]>,
    /// Pose of the joint frame at q = 0 in the carrier's.
    pub(crate) rotation: FixedRotation,
    pub(crate) translation: Vec3<f64>,
    /// Moments of mass in its own frame.
    pub(crate) inertia: Inertia<f64>,
    /// From the modeller's body frame to ours.
    pub(super) align: Mat3<f64>,
}

/// A point with axes, fixed to a body: a sensor or the tool.
#[derive(Clone, Debug)]
pub struct Frame {
    /// Which body carries it, and the pose in that body's frame.
    pub(crate) body: usize,
    pub(crate) rotation: Mat3<f64>,
    pub(crate) translation: Vec3<f64>,
}

/// A tree of rigid bodies on a fixed base.
///
/// ```
/// use linkside_core::spatial::{Mat3, Vec3};
/// let robot = linkside_core::demo::arm()?;
/// let elbow = robot.tree.frame("a probe", 0, &Mat3::IDENTITY, &Vec3([0.4, 0.0, 0.0]))?;
/// assert!(robot.tree.frame("a probe", 7, &Mat3::IDENTITY, &Vec3([0.0; 3])).is_err()); // there is no body 7
/// # drop(elbow);
/// # Ok::<(), linkside_core::error::RobotError>(())
/// ```
#[derive(Clone, Debug)]
pub struct Tree {
    /// Each after the one that carries it.
    pub(crate) bodies: Vec<Body>,
    /// Entries of q.
    joints: usize,
    /// Acceleration of free fall in the base frame [m/s²].
    pub(crate) gravity: Vec3<f64>,
    /// What carries part of the weight.
    pub(crate) supports: Vec<Support>,
    /// What acts on links from outside.
    pub(crate) wrenches: Vec<Wrench>,
}

impl Tree {
    /// Compiles `specs`, in topological order, under the acceleration of free fall `gravity` [m/s²] in the base frame.
    ///
    /// # Errors
    /// A body before its parent, a joint that moves no body or two, an axis that is not of unit length, a negative mass, an
    /// inertia with a negative principal moment.
    pub fn new(gravity: Vec3<f64>, specs: &[BodySpec]) -> Result<Self, RobotError> {
        if specs.is_empty() {
            return Err(RobotError::NoBodies);
        }
        let sum: f64 = gravity.0.iter().sum();
        expect_of(sum.is_finite(), "gravity", || "the robot".into(), sum, "finite numbers")?;
        for joint in 0..specs.len() {
            let count = specs.iter().filter(|s| s.joint == joint).count();
            if count != 1 {
                return Err(RobotError::Joint { joint, count });
            }
        }
        let mut bodies: Vec<Body> = Vec::with_capacity(specs.len());
        for (body, spec) in specs.iter().enumerate() {
            let carrier = match spec.parent {
                Some(parent) if parent >= body => return Err(RobotError::Order { body, parent }),
                Some(parent) => bodies[parent].align,
                None => Mat3::IDENTITY,
            };
            bodies.push(compile(body, spec, &carrier)?);
        }
        Ok(Self { joints: bodies.len(), bodies, gravity, supports: Vec::new(), wrenches: Vec::new() })
    }

    /// Number of joints.
    pub fn len(&self) -> usize {
        self.joints
    }

    /// Never true: a tree has a joint at least.
    pub fn is_empty(&self) -> bool {
        self.bodies.is_empty()
    }

    /// The tree with its last joints following others: `followers` are, of each, the joint that leads, how far it moves for one of
    /// that, and where it is when that is at zero. Parallel linkages move so, reduced to a tree.
    ///
    /// # Errors
    /// A leader that follows or does not exist, numbers that are not finite.
    pub fn with_followers(mut self, followers: &[(usize, f64, f64)]) -> Result<Self, RobotError> {
        let joints = self.joints.saturating_sub(followers.len());
        for (k, &(leader, ratio, offset)) in followers.iter().enumerate() {
            let owner = || format!("joint {}", joints + k);
            expect_of(leader < joints, "leader", owner, leader as f64, "a joint that follows none")?;
            expect_of(ratio.is_finite() && offset.is_finite(), "multiplier", owner, ratio, "a finite number")?;
            for body in self.bodies.iter_mut().filter(|body| body.joint == joints + k) {
                (body.joint, body.following) = (leader, Some([ratio, offset]));
            }
        }
        self.joints = joints;
        Ok(self)
    }

    /// A frame at `translation` with axes `rotation`, both in the modeller's frame of `body`; `owner` names it in errors.
    ///
    /// # Errors
    /// A body that does not exist.
    pub fn frame(
        &self,
        owner: &str,
        body: usize,
        rotation: &Mat3<f64>,
        translation: &Vec3<f64>,
    ) -> Result<Frame, RobotError> {
        let count = self.bodies.len();
        let carrier = self.bodies.get(body).ok_or_else(|| RobotError::Body { owner: owner.into(), body, count })?;
        expect_place(|| owner.into(), rotation, translation)?;
        let align = &carrier.align;
        Ok(Frame { body, rotation: align.mul_constant(rotation), translation: align.apply(translation) })
    }

    /// The tree with each rotor as one more joint, after all others.
    pub(crate) fn with_rotors(&self, rotors: &[Rotor], drives: &[Drive]) -> Self {
        let mut tree = self.clone();
        for rotor in rotors {
            tree.bodies.push(self.rotor(rotor, tree.len(), &drives[rotor.motor]));
            tree.joints += 1;
        }
        tree
    }

    /// Spin inertia about the rotor's axis alone: its mass is its carrier's.
    fn rotor(&self, rotor: &Rotor, joint: usize, drive: &Drive) -> Body {
        let rotation = FixedRotation::z_to(&self.bodies[rotor.body].align.apply(&rotor.axis));
        let spin = drive.motor_inertia / (rotor.ratio * rotor.ratio);
        Body {
            parent: Some(rotor.body),
            joint,
            kind: JointKind::Revolute,
            following: None,
            align: rotation.matrix().transpose(),
            rotation,
            translation: Vec3([0.0; 3]),
            // tr(Σ)·1 − Σ is then the spin inertia about z, and nothing about x and y.
            inertia: Inertia {
                mass: 0.0,
                first: Vec3([0.0; 3]),
                second: Sym3([0.5 * spin, 0.0, 0.0, 0.5 * spin, 0.0, -0.5 * spin]),
            },
        }
    }

    /// The bodies from `body` to the base, itself first.
    #[inline(always)]
    pub(crate) fn path(&self, body: usize) -> impl Iterator<Item = usize> + '_ {
        core::iter::successors(Some(body), |&b| self.bodies[b].parent)
    }
}

impl Body {
    /// How far its joint has moved where its entry of q is `position`.
    #[inline(always)]
    pub(crate) fn position<T: Scalar>(&self, position: T) -> T {
        self.following.map_or(position, |[ratio, offset]| position * ratio + offset)
    }

    /// What its joint has of a velocity, an acceleration or an axis of that entry, or the entry of its torque.
    #[inline(always)]
    pub(crate) fn share<T: Scalar>(&self, value: T) -> T {
        self.following.map_or(value, |[ratio, _]| value * ratio)
    }
}

/// A body with its frame turned so that the joint's axis is z, for kernels that know no other axis.
fn compile(body: usize, spec: &BodySpec, carrier: &Mat3<f64>) -> Result<Body, RobotError> {
    let owner = || format!("body {body}");
    let length = spec.axis.norm();
    if (length - 1.0).abs() > 1e-9 || length.is_nan() {
        return Err(RobotError::Axis { body, length });
    }
    expect_of(spec.mass >= 0.0 && spec.mass.is_finite(), "mass", owner, spec.mass, "at least 0")?;
    expect_place(owner, &spec.rotation, &spec.translation)?;
    let [x, y, z] = &spec.inertia.0;
    for (what, vector) in [("inertia", x), ("inertia", y), ("inertia", z), ("centre of mass", &spec.com)] {
        let sum: f64 = vector.0.iter().sum();
        expect_of(sum.is_finite(), what, owner, sum, "finite numbers")?;
    }
    let [least, most] = moments_between(&spec.inertia);
    let roundoff = 1e-6 * most.abs() + 1e-12; // a rod's, singular in truth, in a file of six digits
    expect_of(least >= -roundoff, "inertia", owner, least, "principal moments of at least 0")?;
    // Where the axis is in the carrier's frame counts; how the joint's frame is turned about it goes into what the body carries.
    let turned = carrier.mul_constant(&spec.rotation);
    let rotation = FixedRotation::z_to(&turned.apply(&spec.axis));
    let align = rotation.matrix().transpose().mul(&turned);
    Ok(Body {
        parent: spec.parent,
        joint: spec.joint,
        kind: spec.kind,
        following: None,
        rotation,
        translation: carrier.apply(&spec.translation),
        inertia: moments(spec, &align),
        align,
    })
}

/// Refuses a place that is not finite.
fn expect_place(
    owner: impl Fn() -> String + Copy,
    rotation: &Mat3<f64>,
    translation: &Vec3<f64>,
) -> Result<(), RobotError> {
    let [x, y, z] = &rotation.0;
    for (what, vector) in [("rotation", x), ("rotation", y), ("rotation", z), ("translation", translation)] {
        let sum: f64 = vector.0.iter().sum();
        expect_of(sum.is_finite(), what, owner, sum, "finite numbers")?;
    }
    Ok(())
}

/// The least and the greatest principal moment.
fn moments_between(inertia: &Mat3<f64>) -> [f64; 2] {
    let columns = inertia.0.map(|column| column.0);
    let symmetric = Matrix3::from_fn(|i, j| 0.5 * (columns[j][i] + columns[i][j]));
    let moments = symmetric.symmetric_eigenvalues();
    [moments.min(), moments.max()]
}

/// Moments of mass about the joint frame's origin, in our axes.
fn moments(spec: &BodySpec, align: &Mat3<f64>) -> Inertia<f64> {
    let [x, y, z] = spec.inertia.0;
    let half = 0.5 * spec.inertia.trace();
    let about_com = Sym3([half - x.0[0], -y.0[0], -z.0[0], half - y.0[1], -z.0[1], half - z.0[2]]);
    let com = align.apply(&spec.com);
    let mut second = Sym3::rotated(&about_com, align);
    second += Sym3::outer(&com, &(com * spec.mass));
    Inertia { mass: spec.mass, first: com * spec.mass, second }
}
