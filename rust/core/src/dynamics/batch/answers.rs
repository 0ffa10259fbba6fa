//! What can be asked at a state, for any kind of number.

use crate::dynamics::{ElasticDynamics, ElasticLayout, Kinematics, Loads, NewtonEuler};
use crate::robot::{Robot, Sensor};
use crate::scalar::Scalar;
use crate::spatial::Vec3;

/// Scratch of all kernels.
#[derive(Debug)]
pub(super) struct Room<T> {
    /// For derivatives and the matrices that have velocities…
    kinematics: Kinematics<T>,
    loads: Loads<T>,
    /// …for torques, readings and inertia alone…
    newton_euler: NewtonEuler<T>,
    /// …and for elastic joints, with a state; made when it is asked for.
    elastic: Option<(ElasticLayout, ElasticDynamics<T>, Vec<T>)>,
    /// Torques that come with their derivatives.
    tau: Vec<T>,
    /// n zeros.
    zero: Vec<T>,
}

impl<T: Scalar> Room<T> {
    pub(super) fn new(robot: &Robot) -> Self {
        let (tree, zero) = (&robot.tree, vec![T::default(); robot.len()]);
        Self {
            kinematics: Kinematics::new(tree),
            loads: Loads::new(tree),
            newton_euler: NewtonEuler::new(tree),
            elastic: None,
            tau: zero.clone(),
            zero,
        }
    }
}

/// Something to be asked at a state of `S` signals, n numbers each; `out` is all of it, row-major.
pub(super) trait Answer<const S: usize> {
    fn at<T: Scalar>(room: &mut Room<T>, robot: &Robot, signals: [&[T]; S], out: &mut [T]);
}

/// τ at q, q̇ and q̈.
pub(super) struct Torque;

impl Answer<3> for Torque {
    #[inline(always)]
    fn at<T: Scalar>(room: &mut Room<T>, robot: &Robot, [q, dq, ddq]: [&[T]; 3], out: &mut [T]) {
        room.newton_euler.set(&robot.tree, q, dq, ddq);
        room.newton_euler.inverse_dynamics_into(&robot.tree, out);
    }
}

/// ∂τ/∂q, ∂τ/∂q̇ and M.
pub(super) struct TorqueDerivatives;

impl Answer<3> for TorqueDerivatives {
    #[inline(always)]
    fn at<T: Scalar>(room: &mut Room<T>, robot: &Robot, [q, dq, ddq]: [&[T]; 3], out: &mut [T]) {
        let Room { kinematics, loads, tau, .. } = room;
        let (by_q, rest) = out.split_at_mut(robot.len().pow(2));
        let (by_dq, mass) = rest.split_at_mut(by_q.len());
        kinematics.set(&robot.tree, q, dq, ddq);
        loads.inverse_dynamics_derivatives_into(&robot.tree, kinematics, tau, by_q, by_dq, mass);
    }
}

/// M at q.
pub(super) struct MassMatrix;

impl Answer<1> for MassMatrix {
    #[inline(always)]
    fn at<T: Scalar>(room: &mut Room<T>, robot: &Robot, [q]: [&[T]; 1], out: &mut [T]) {
        room.newton_euler.set_position(&robot.tree, q);
        room.newton_euler.mass_matrix_into(&robot.tree, out);
    }
}

/// C at q and q̇.
pub(super) struct CoriolisMatrix;

impl Answer<2> for CoriolisMatrix {
    #[inline(always)]
    fn at<T: Scalar>(room: &mut Room<T>, robot: &Robot, [q, dq]: [&[T]; 2], out: &mut [T]) {
        room.kinematics.set_position(&robot.tree, q);
        room.kinematics.set_velocity(&robot.tree, dq);
        room.loads.coriolis_matrix_into(&robot.tree, &room.kinematics, out);
    }
}

/// q̈ and θ̈ at q, q̇, θ and θ̇ under τ.
pub(super) struct Accelerations;

impl Answer<5> for Accelerations {
    #[inline(always)]
    fn at<T: Scalar>(room: &mut Room<T>, robot: &Robot, [q, dq, theta, dtheta, tau]: [&[T]; 5], out: &mut [T]) {
        let (layout, dynamics, x) = room.elastic.get_or_insert_with(|| {
            let layout = ElasticLayout::new(robot, false);
            (layout.clone(), ElasticDynamics::new(robot, &layout), vec![T::default(); layout.dense])
        });
        layout.gather([q, dq, theta, dtheta], x);
        dynamics.accelerate(robot, layout, x, tau);
        let (links, motors) = out.split_at_mut(robot.len());
        links.copy_from_slice(&dynamics.ddq);
        motors.copy_from_slice(&dynamics.ddtheta);
    }
}

/// What each number of the varying wrenches adds to each joint's torque at q.
pub(super) struct WrenchMap;

impl Answer<1> for WrenchMap {
    #[inline(always)]
    fn at<T: Scalar>(room: &mut Room<T>, robot: &Robot, [q]: [&[T]; 1], out: &mut [T]) {
        out.fill(T::default());
        let numbers = robot.wrench_states();
        room.kinematics.set_position(&robot.tree, q);
        room.kinematics.wrench_map(&robot.tree, |number, joint, by| out[joint * numbers + number] += by);
    }
}

/// Readings of the accelerometers' recorded axes.
pub(super) struct SpecificForce;

impl Answer<3> for SpecificForce {
    #[inline(always)]
    fn at<T: Scalar>(room: &mut Room<T>, robot: &Robot, [q, dq, ddq]: [&[T]; 3], out: &mut [T]) {
        room.newton_euler.set(&robot.tree, q, dq, ddq);
        read(&robot.accelerometers, out, |sensor| room.newton_euler.specific_force(&sensor.frame));
    }
}

/// Their derivatives by q, q̇ and q̈.
pub(super) struct SpecificForceDerivatives;

impl Answer<3> for SpecificForceDerivatives {
    #[inline(always)]
    fn at<T: Scalar>(room: &mut Room<T>, robot: &Robot, [q, dq, ddq]: [&[T]; 3], out: &mut [T]) {
        let (n, channels) = (robot.len(), robot.acceleration_channels());
        out.fill(T::default());
        room.kinematics.set(&robot.tree, q, dq, ddq);
        let mut row = 0;
        for sensor in &robot.accelerometers {
            room.kinematics.specific_force_derivatives(&robot.tree, &sensor.frame, |joint, columns| {
                for (which, column) in columns.iter().enumerate() {
                    for (r, &axis) in sensor.axes.iter().enumerate() {
                        out[(which * channels + row + r) * n + joint] += column.0[axis];
                    }
                }
            });
            row += sensor.axes.len();
        }
    }
}

/// Readings of the gyroscopes' recorded axes.
pub(super) struct AngularRate;

impl Answer<2> for AngularRate {
    #[inline(always)]
    fn at<T: Scalar>(room: &mut Room<T>, robot: &Robot, [q, dq]: [&[T]; 2], out: &mut [T]) {
        room.newton_euler.set(&robot.tree, q, dq, &room.zero);
        read(&robot.gyroscopes, out, |sensor| room.newton_euler.angular_rate(&sensor.frame));
    }
}

/// The tool centre point, NaN where there is none.
pub(super) struct ToolPosition;

impl Answer<1> for ToolPosition {
    #[inline(always)]
    fn at<T: Scalar>(room: &mut Room<T>, robot: &Robot, [q]: [&[T]; 1], out: &mut [T]) {
        room.kinematics.set_position(&robot.tree, q);
        let at = |tool| room.kinematics.position(tool).0;
        out.copy_from_slice(&robot.tool.as_ref().map_or([T::constant(f64::NAN); 3], at));
    }
}

/// The recorded axes of `sensors`, one after the other.
#[inline(always)]
fn read<T: Scalar>(sensors: &[Sensor], out: &mut [T], sense: impl Fn(&Sensor) -> Vec3<T>) {
    let mut from = 0;
    for sensor in sensors {
        from += sensor.record(&sense(sensor), &mut out[from..]);
    }
}
