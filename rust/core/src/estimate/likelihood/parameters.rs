//! What of a robot can be freed.

use crate::robot::{Drive, FrictionElement, Robot, SpringRates};
use crate::scalar::Scalar;
use crate::spatial::{Inertia, Mat3, Sym3, Vec3};

/// One number of a robot, its sensors or its noise.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Parameter {
    /// K of a joint [N m/rad].
    Stiffness(usize),
    /// Hardening of a joint's spring [N m/rad³].
    CubicStiffness(usize),
    /// D of a joint [N m s/rad].
    Damping(usize),
    /// B of a joint [kg m²].
    MotorInertia(usize),
    /// Viscous friction of a joint's motor [N m s/rad].
    ViscousFriction(usize),
    /// Dry friction of a joint's motor [N m].
    CoulombFriction(usize),
    /// k of one of the friction elements in a joint [N m/rad].
    ElementStiffness(usize, usize),
    /// W of one of those [N m].
    ElementLimit(usize, usize),
    /// Factor on a joint's motor torques as they were read: a torque constant over that in use.
    TorqueScale(usize),
    /// Factor on all friction of a link.
    LinkFriction(usize),
    /// Dry friction of a link's bearing [N m].
    LinkCoulomb(usize),
    /// Half of a joint's play [rad].
    HalfGap(usize),
    /// S: motor of the second joint, link of the first [kg m²].
    Coupling(usize, usize),
    /// Factor on the mass of the link that a joint moves, its shape unchanged.
    MassScale(usize),
    /// Mass of a point that the tool carries [kg].
    PayloadMass,
    /// A coordinate of that point in the tool's frame [m].
    PayloadCentre(usize),
    /// Displacement of an accelerometer along one of its own axes [m].
    SensorTranslation(usize, usize),
    /// Rotation of an accelerometer about one of its own axes [rad].
    SensorRotation(usize, usize),
    /// Bias of an accelerometer's axis [m/s²].
    SensorBias(usize, usize),
    /// Scale of an accelerometer's axis; 1 when it is right.
    SensorScale(usize, usize),
    /// Time constant of the first-order filter inside an accelerometer [s].
    TimeConstant(usize),
    /// Delay of an accelerometer [s].
    Delay(usize),
    /// Factor on the noise of an accelerometer.
    SensorNoise(usize),
}

/// A joint's numbers.
#[derive(Clone, Copy, Debug)]
pub(super) struct JointParameters<T> {
    /// The spring's, D and B.
    pub(super) spring: SpringRates<T>,
    pub(super) damping: T,
    pub(super) motor_inertia: T,
    /// The motor's.
    pub(super) viscous_friction: T,
    pub(super) coulomb_friction: T,
    /// Factor on its torques as they were read.
    pub(super) torque_scale: T,
    /// Half of the play.
    pub(super) half_gap: T,
    /// Dry friction of the link that the joint moves; factors on all its friction, and on its mass.
    pub(super) link_coulomb: T,
    pub(super) link_friction: T,
    pub(super) mass_scale: T,
}

/// An accelerometer's numbers.
#[derive(Clone, Copy, Debug)]
pub(super) struct SensorParameters<T> {
    /// From where and how the robot says it is mounted, in its own axes [m, rad].
    pub(super) translation: Vec3<T>,
    pub(super) rotation: Vec3<T>,
    /// A reading is scale · specific force + bias, axis by axis.
    pub(super) bias: Vec3<T>,
    pub(super) scale: Vec3<T>,
    /// Of the filter inside, and the age of what is read [s].
    pub(super) time_constant: T,
    pub(super) delay: T,
    /// Factor on its standard deviation.
    pub(super) noise: T,
}

/// All of a robot's numbers, over a scalar.
#[derive(Clone, Debug)]
pub(super) struct Parameters<T> {
    /// One a joint, and one an accelerometer.
    pub(super) joints: Vec<JointParameters<T>>,
    pub(super) sensors: Vec<SensorParameters<T>>,
    /// k and W of each joint's friction elements.
    pub(super) elements: Vec<Vec<[T; 2]>>,
    /// S, n × n.
    pub(super) coupling: Vec<T>,
    /// A point that the tool carries, in its frame.
    pub(super) payload_mass: T,
    pub(super) payload_centre: Vec3<T>,
}

impl Parameter {
    /// Whether the links' response to their motors has it alone: the filter takes it as the robot says, or does not depend
    /// on it.
    pub(super) fn of_response(self) -> bool {
        use Parameter as P;
        matches!(
            self,
            P::LinkFriction(_)
                | P::LinkCoulomb(_)
                | P::HalfGap(_)
                | P::ElementStiffness(..)
                | P::ElementLimit(..)
                | P::TorqueScale(_)
                | P::MotorInertia(_)
                | P::ViscousFriction(_)
                | P::CoulombFriction(_)
                | P::Coupling(..)
        )
    }
}

impl<T: Scalar> Parameters<T> {
    /// What `robot` says.
    pub(super) fn of(robot: &Robot) -> Self {
        let one = T::constant(1.0);
        let joint = |d: &Drive| JointParameters {
            spring: SpringRates { stiffness: T::constant(d.stiffness), cubic: T::constant(d.cubic_stiffness) },
            damping: T::constant(d.damping),
            motor_inertia: T::constant(d.motor_inertia),
            viscous_friction: T::constant(d.motor_friction.viscous),
            coulomb_friction: T::constant(d.motor_friction.coulomb),
            torque_scale: one,
            half_gap: T::constant(d.backlash.half_gap),
            link_coulomb: T::constant(d.bearing_friction.coulomb),
            link_friction: one,
            mass_scale: one,
        };
        let sizes = |e: &FrictionElement| [e.stiffness, e.limit].map(T::constant);
        let elements = |d: &Drive| d.hysteresis.elements.iter().map(sizes).collect();
        let sensor = SensorParameters {
            translation: Vec3::default(),
            rotation: Vec3::default(),
            bias: Vec3::default(),
            scale: Vec3([one; 3]),
            time_constant: T::default(),
            delay: T::default(),
            noise: one,
        };
        Self {
            joints: robot.drives.iter().map(joint).collect(),
            sensors: vec![sensor; robot.accelerometers.len()],
            elements: robot.drives.iter().map(elements).collect(),
            coupling: robot.coupling.iter().map(|&s| T::constant(s)).collect(),
            payload_mass: T::default(),
            payload_centre: Vec3::default(),
        }
    }

    /// Where a parameter is kept; none for one that the robot does not have.
    pub(super) fn slot(&mut self, parameter: Parameter) -> Option<&mut T> {
        use Parameter as P;
        let n = self.joints.len();
        let joints = &mut self.joints;
        let sensors = &mut self.sensors;
        Some(match parameter {
            P::Stiffness(j) => &mut joints.get_mut(j)?.spring.stiffness,
            P::CubicStiffness(j) => &mut joints.get_mut(j)?.spring.cubic,
            P::Damping(j) => &mut joints.get_mut(j)?.damping,
            P::MotorInertia(j) => &mut joints.get_mut(j)?.motor_inertia,
            P::ViscousFriction(j) => &mut joints.get_mut(j)?.viscous_friction,
            P::CoulombFriction(j) => &mut joints.get_mut(j)?.coulomb_friction,
            P::ElementStiffness(j, i) => &mut self.elements.get_mut(j)?.get_mut(i)?[0],
            P::ElementLimit(j, i) => &mut self.elements.get_mut(j)?.get_mut(i)?[1],
            P::TorqueScale(j) => &mut joints.get_mut(j)?.torque_scale,
            P::HalfGap(j) => &mut joints.get_mut(j)?.half_gap,
            P::LinkCoulomb(j) => &mut joints.get_mut(j)?.link_coulomb,
            P::LinkFriction(j) => &mut joints.get_mut(j)?.link_friction,
            P::MassScale(j) => &mut joints.get_mut(j)?.mass_scale,
            P::Coupling(i, j) if i < j && j < n => &mut self.coupling[i * n + j],
            P::Coupling(..) => return None,
            P::PayloadMass => &mut self.payload_mass,
            P::PayloadCentre(axis) => self.payload_centre.0.get_mut(axis)?,
            P::SensorTranslation(s, axis) => sensors.get_mut(s)?.translation.0.get_mut(axis)?,
            P::SensorRotation(s, axis) => sensors.get_mut(s)?.rotation.0.get_mut(axis)?,
            P::SensorBias(s, axis) => sensors.get_mut(s)?.bias.0.get_mut(axis)?,
            P::SensorScale(s, axis) => sensors.get_mut(s)?.scale.0.get_mut(axis)?,
            P::TimeConstant(s) => &mut sensors.get_mut(s)?.time_constant,
            P::Delay(s) => &mut sensors.get_mut(s)?.delay,
            P::SensorNoise(s) => &mut sensors.get_mut(s)?.noise,
        })
    }

    /// Each body's moments of mass, with the payload on the one that carries the tool.
    pub(super) fn masses(&self, robot: &Robot) -> Vec<Inertia<T>> {
        let scaled = |body: &crate::robot::Body| {
            let (own, scale) = (&body.inertia, self.joints[body.joint].mass_scale);
            let second = own.second.0.map(|entry| scale * entry);
            Inertia { mass: scale * own.mass, first: Vec3(own.first.0.map(|x| scale * x)), second: Sym3(second) }
        };
        let mut masses: Vec<_> = robot.tree.bodies.iter().map(scaled).collect();
        if let Some(tool) = &robot.tool {
            let turned = Mat3::<T>::constant(&tool.rotation).apply(&self.payload_centre);
            let at = turned + Vec3::constant(&tool.translation);
            masses[tool.body] += Inertia::point(self.payload_mass, &at);
        }
        masses
    }
}

impl<T: Scalar> SensorParameters<T> {
    /// The rotation from the frame that the robot says to the true one, by Rodrigues' formula.
    pub(super) fn turn(&self) -> Mat3<T> {
        let r = &self.rotation;
        let square = r.dot(r);
        // sin(a)/a and (1 − cos a)/a², by their series where a is small: smooth at zero, where most sensors are.
        let mut sine = T::constant(1.0);
        let mut versine = T::constant(0.5);
        let (mut odd, mut even) = (sine, versine);
        for k in 1..9 {
            let k = k as f64;
            odd = odd * square * (-1.0 / ((2.0 * k) * (2.0 * k + 1.0)));
            even = even * square * (-1.0 / ((2.0 * k + 1.0) * (2.0 * k + 2.0)));
            sine += odd;
            versine += even;
        }
        let column = |k: usize| {
            let mut unit = Vec3::<T>::default();
            unit.0[k] = T::constant(1.0);
            let across = r.cross(&unit);
            unit + across.scale(sine) + r.cross(&across).scale(versine)
        };
        Mat3([column(0), column(1), column(2)])
    }
}
