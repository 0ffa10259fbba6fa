//! Numbers of a robot that are known to a tolerance only, and what a unit error of each does to the readings.

use crate::dynamics::Kinematics;
use crate::estimate::measurement::{Channel, LinkMotion, MotorStand, OfDrives};
use crate::robot::{Robot, Tree, Wound};
use crate::scalar::Scalar;
use crate::simd::{self, Kernel};
use crate::spatial::Vec3;

/// Three tolerances of a logarithm count for no more than this.
const MOST: f64 = 20.0;

/// A number of the robot that is not known exactly. Positive ones are taken by their logarithm: 0.2 is 20 %.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Uncertain {
    /// ln K of an elastic joint, the whole spring with it.
    Stiffness(usize),
    /// Hardening of an elastic joint's spring [N m/rad³].
    CubicStiffness(usize),
    /// ln D of an elastic joint.
    Damping(usize),
    /// How much a joint taken as rigid gives way after all: one is the spring on which its inertia turns at 1 rad/s [s²].
    Yielding(usize),
    /// Logarithm of mass and inertia of the link that a joint moves.
    Mass(usize),
    /// Logarithm of a link's friction.
    LinkFriction(usize),
    /// Logarithm of the torque constant of a joint's motor; not seen by the jerk-driven model.
    TorqueConstant(usize),
    /// Logarithm of a motor's friction; likewise.
    MotorFriction(usize),
    /// ln B of a motor; likewise.
    MotorInertia(usize),
    /// How far a joint's motor position is from the link's zero, all the time [rad].
    EncoderZero(usize),
    /// A harmonic of what a joint's motor encoder reads wrong [rad], of the frequencies that its drive has one by one: the
    /// sine of each, then its cosine. What its phase is a run does not say.
    EncoderLine(usize, usize),
    /// How far a joint's transmission is from its spring's curve [rad]: hysteresis, play, teeth. It changes as the robot moves.
    LostMotion(usize),
    /// Where a joint's friction elements were at the start, as a share of their way.
    Hysteresis(usize),
    /// Rotation of an accelerometer about one of its own axes [rad].
    Rotation(usize, usize),
    /// Displacement of an accelerometer along one of its own axes [m].
    Translation(usize, usize),
    /// Logarithm of an accelerometer's scale, of one axis.
    Scale(usize, usize),
}

impl Uncertain {
    /// The joint whose drive, or whose motor, it belongs to.
    pub(super) fn joint(self) -> Option<usize> {
        match self {
            Self::Stiffness(j)
            | Self::CubicStiffness(j)
            | Self::Damping(j)
            | Self::Yielding(j)
            | Self::LinkFriction(j)
            | Self::TorqueConstant(j)
            | Self::MotorFriction(j)
            | Self::MotorInertia(j)
            | Self::EncoderZero(j)
            | Self::EncoderLine(j, _)
            | Self::LostMotion(j)
            | Self::Hysteresis(j) => Some(j),
            _ => None,
        }
    }

    /// Whether it is one number for all time, which readings can tell.
    pub(super) fn is_constant(self) -> bool {
        !matches!(self, Self::LostMotion(_))
    }

    /// Whether it is the logarithm of a positive number.
    fn is_logarithm(self) -> bool {
        !matches!(
            self,
            Self::CubicStiffness(_)
                | Self::Yielding(_)
                | Self::EncoderZero(_)
                | Self::EncoderLine(..)
                | Self::LostMotion(_)
                | Self::Hysteresis(_)
                | Self::Rotation(..)
                | Self::Translation(..)
        )
    }
}

/// A number of the robot and its standard deviation, in the number's own measure.
#[derive(Clone, Copy, Debug)]
pub struct Tolerance {
    /// Which.
    pub parameter: Uncertain,
    /// Its standard deviation.
    pub std: f64,
}

impl Tolerance {
    /// The standard deviation to count linear effects with: three of it reach as far as three tolerances.
    ///
    /// Of a logarithm p, effects go with eᵖ (a damper's torque, a weight) or with e⁻ᵖ (a spring's torsion), which at three
    /// tolerances on the far side is (e³ˢ − 1)/3s times what its slope says: 1.37 times for 20 %.
    pub(crate) fn counted(self) -> f64 {
        if self.parameter.is_logarithm() { (Scalar::exp((3.0 * self.std).min(MOST)) - 1.0) / 3.0 } else { self.std }
    }
}

/// Links and motors where motor positions are looked at.
#[derive(Clone, Copy, Debug)]
pub(crate) struct MotorsAt<'a, T> {
    /// (q, q̇).
    pub(crate) links: &'a [T],
    /// Motor velocities for the damping torque (n), NaN to leave it out.
    pub(crate) dtheta: &'a [f64],
    /// Friction elements as they were left.
    pub(crate) wound: &'a [Wound],
}

impl<T: Scalar> LinkMotion<T> {
    /// N = ∂h/∂p at the state that was last evaluated, into `out` (channels × `stride`, one column a parameter).
    ///
    /// With δ the torsion and φ′ the tangent stiffness, of a motor position: −φ/φ′ for ln K, −D δ̇/φ′ for ln D and
    /// Yᵢπᵢ/φ′ for the mass of link i; of an accelerometer that reads y: [y]× for its rotation and [ω̇]× + [ω]×² for
    /// its displacement, in its own axes.
    #[inline]
    pub(crate) fn signatures(
        &mut self,
        robot: &Robot,
        channels: &[Channel],
        tolerances: &[Tolerance],
        at: MotorsAt<'_, T>,
        stride: usize,
        out: &mut [T],
    ) {
        simd::phase(Signatures { motion: self, robot, channels, tolerances, at, stride, out });
    }

    /// Where elastic joint `j`'s motor stands at the state that was last evaluated.
    #[inline(always)]
    fn motor(&self, robot: &Robot, j: usize, at: MotorsAt<'_, T>) -> MotorStand<T> {
        let (drive, link) = (&robot.drives[j], [at.links[j], at.links[robot.len() + j]]);
        let torque = self.tau[j] + drive.link_friction_beside(link[1], self.tau[j]).torque;
        MotorStand::new(&OfDrives(at.wound), drive, j, link, torque, at.dtheta[j])
    }

    /// A number of a drive shows between motor and link, or on a joint torque sensor.
    ///
    /// With r the torque that the spring holds, φ(δ) = r: dδ/d ln K = −φ/φ′, dδ/dk₃ = −δ³/φ′, dδ/d ln D = −D δ̇/φ′ and
    /// for the link's friction +d/φ′. What a joint taken as rigid yields is r over the inertia that turns on it.
    #[inline(always)]
    fn drive_signature(
        &self,
        robot: &Robot,
        channels: &[Channel],
        parameter: Uncertain,
        at: MotorsAt<'_, T>,
        mut put: impl FnMut(usize, T),
    ) {
        use Uncertain as U;
        let n = robot.len();
        let (U::Stiffness(j)
        | U::CubicStiffness(j)
        | U::Damping(j)
        | U::Yielding(j)
        | U::LinkFriction(j)
        | U::EncoderZero(j)
        | U::EncoderLine(j, _)
        | U::LostMotion(j)
        | U::Hysteresis(j)) = parameter
        else {
            return;
        };
        let drive = &robot.drives[j];
        let friction = drive.link_friction_beside(at.links[n + j], self.tau[j]);
        // A share more of it, and what grows with that.
        let (friction, more) = (friction.torque, friction.torque * (friction.by_load + 1.0));
        if let (Some(row), U::LinkFriction(_)) = (position(channels, Channel::Torque(j)), parameter) {
            put(row, more);
        }
        let Some(row) = position(channels, Channel::Motor(j)) else { return };
        if let U::EncoderZero(_) | U::LostMotion(_) = parameter {
            return put(row, T::constant(1.0));
        }
        if let U::EncoderLine(_, line) = parameter {
            let theta = if drive.elastic { self.motor(robot, j, at).theta } else { at.links[j] };
            return put(row, drive.encoder_line(line, theta));
        }
        if !drive.elastic {
            if parameter == U::Yielding(j) {
                put(row, (self.tau[j] + friction) / self.mass[j * n + j]);
            }
            return;
        }
        let MotorStand { torsion, slip, by_torque, .. } = self.motor(robot, j, at);
        match parameter {
            U::Stiffness(_) => put(row, -by_torque * drive.spring_torque(torsion)),
            U::CubicStiffness(_) => put(row, -by_torque * drive.hardening(torsion)),
            U::Damping(_) => put(row, -by_torque * slip * drive.damping),
            U::LinkFriction(_) => put(row, by_torque * more),
            U::Hysteresis(_) => {
                let Some(wound) = at.wound.get(j) else { return };
                put(row, -by_torque * torsion.map(|x| wound.inherited(drive, x)));
            }
            _ => {}
        }
    }

    /// A link's share of all joints' torques reaches the joints that carry it.
    #[inline(always)]
    fn mass_signature(
        &self,
        robot: &Robot,
        channels: &[Channel],
        link: usize,
        at: MotorsAt<'_, T>,
        mut put: impl FnMut(usize, T),
    ) {
        shares_of_link(&self.kinematics, &robot.tree, link, |j, share| {
            let drive = &robot.drives[j];
            let speed = at.links[robot.len() + j];
            let share = share * (drive.link_friction_beside(speed, self.tau[j]).by_load + 1.0);
            if let Some(row) = position(channels, Channel::Torque(j)) {
                put(row, share);
            }
            if let Some(row) = position(channels, Channel::Motor(j)).filter(|_| drive.elastic) {
                put(row, self.motor(robot, j, at).by_torque * share);
            }
        });
    }
}

/// Hands over each joint that carries `link`, and the torque that it holds on account of this link's inertia.
#[inline(always)]
pub(crate) fn shares_of_link<T: Scalar>(
    kinematics: &Kinematics<T>,
    tree: &Tree,
    link: usize,
    mut each: impl FnMut(usize, T),
) {
    for (body, _) in tree.bodies.iter().enumerate().filter(|(_, body)| body.joint == link) {
        let state = &kinematics.bodies[body];
        let inertia = kinematics.inertia(tree, body);
        let force = inertia.apply(&state.acceleration) + state.velocity.cross_force(&inertia.apply(&state.velocity));
        for i in tree.path(body) {
            each(tree.bodies[i].joint, kinematics.bodies[i].axis.dot(&force));
        }
    }
}

/// What an accelerometer's mounting or scale does to its own rows, each handed to `put`; other parameters do nothing.
#[inline(always)]
pub(super) fn of_sensor<T: Scalar>(
    kinematics: &Kinematics<T>,
    robot: &Robot,
    channels: &[Channel],
    parameter: Uncertain,
    mut put: impl FnMut(usize, T),
) {
    use Uncertain as U;
    let (U::Rotation(s, about) | U::Translation(s, about) | U::Scale(s, about)) = parameter else { return };
    let sensor = &robot.accelerometers[s];
    let own = |c: &Channel| matches!(c, Channel::Acceleration { sensor, .. } if *sensor == s);
    let Some(first) = channels.iter().position(own) else { return };
    let (reading, carry) = kinematics.seen(sensor);
    let change = match parameter {
        U::Rotation(..) => reading.cross(&unit(about)),
        U::Translation(..) => carry(&unit(about)),
        _ => {
            let mut along = Vec3::default();
            along.0[about] = reading.0[about];
            along
        }
    };
    for (r, &axis) in sensor.axes.iter().enumerate() {
        put(first + r, change.0[axis]);
    }
}

/// The unit vector along an axis.
fn unit<T: Scalar>(axis: usize) -> Vec3<T> {
    let mut out = Vec3::default();
    out.0[axis] = T::constant(1.0);
    out
}

/// The row of a channel, where it is measured.
#[inline(always)]
fn position(channels: &[Channel], wanted: Channel) -> Option<usize> {
    channels.iter().position(|c| *c == wanted)
}

/// [`LinkMotion::signatures`], to be compiled for each instruction set.
struct Signatures<'a, T> {
    motion: &'a mut LinkMotion<T>,
    robot: &'a Robot,
    channels: &'a [Channel],
    tolerances: &'a [Tolerance],
    at: MotorsAt<'a, T>,
    stride: usize,
    out: &'a mut [T],
}

impl<T: Scalar> Kernel for Signatures<'_, T> {
    type Output = ();
    const LANES: bool = T::LANES;

    #[inline(always)]
    fn run(self) {
        let Self { motion, robot, channels, tolerances, at, stride, out } = self;
        out.fill(T::default());
        for (column, tolerance) in tolerances.iter().enumerate() {
            let put = |row: usize, value: T| out[row * stride + column] += value;
            match tolerance.parameter {
                Uncertain::Mass(j) => motion.mass_signature(robot, channels, j, at, put),
                parameter if parameter.joint().is_some() => {
                    motion.drive_signature(robot, channels, parameter, at, put);
                }
                parameter => of_sensor(&motion.kinematics, robot, channels, parameter, put),
            }
        }
    }
}

#[cfg(test)]
#[allow(clippy::disallowed_methods)] // the oracle is the platform's
mod tests {
    use super::*;

    #[test]
    fn three_standard_deviations_reach_as_far_as_three_tolerances_of_a_logarithm() {
        for std in [1e-6, 0.05, 0.2, 1.0] {
            let softer = Tolerance { parameter: Uncertain::Stiffness(0), std };
            assert!((3.0 * softer.counted() - (3.0 * std).exp_m1()).abs() < 1e-9 * std, "{std}");
            let turned = Tolerance { parameter: Uncertain::Rotation(0, 1), std };
            assert_eq!(turned.counted(), std);
        }
        assert!(Tolerance { parameter: Uncertain::Mass(0), std: 1e3 }.counted().is_finite());
    }
}
