//! What sensors on the links read, and its derivatives.

use super::super::parameters::{Parameter, Parameters, SensorParameters};
use super::equation::{DRY, Equation};
use super::links::Links;
use crate::dynamics::Placed;
use crate::estimate::measurement::Channel;
use crate::scalar::Dual;
use crate::spatial::{Mat3, Vec3};

/// An accelerometer's own rotation, and its derivatives about each of its axes.
#[derive(Clone, Debug)]
struct Turn {
    /// R of the rotation vector, and ∂R by its three components.
    own: Mat3<f64>,
    by: [Mat3<f64>; 3],
}

impl Turn {
    /// By derivative numbers, once a run.
    fn of(sensor: &SensorParameters<f64>) -> Self {
        let zero = Dual::<3>::default();
        let vector = |v: &Vec3<f64>| Vec3::<Dual<3>>::constant(v);
        let mut rotation = vector(&sensor.rotation);
        for (k, angle) in rotation.0.iter_mut().enumerate() {
            *angle = Dual::variable(angle.value, k);
        }
        let turned = SensorParameters {
            translation: vector(&sensor.translation),
            rotation,
            bias: vector(&sensor.bias),
            scale: vector(&sensor.scale),
            time_constant: zero,
            delay: zero,
            noise: zero,
        }
        .turn();
        let part = |f: &dyn Fn(Dual<3>) -> f64| Mat3(turned.0.map(|column| Vec3(column.0.map(f))));
        Self { own: part(&|x| x.value), by: [0, 1, 2].map(|k| part(&move |x| x.gradient[k])) }
    }
}

/// All sensors of a robot.
#[derive(Clone, Debug)]
pub(super) struct Sensors<'a> {
    /// What is read, in the order of the readings.
    channels: &'a [Channel],
    /// What derivatives are taken in, before those in the initial state.
    free: &'a [Parameter],
    /// Each accelerometer's mounting, scale and bias, and its rotation with derivatives.
    sensors: Vec<SensorParameters<f64>>,
    turns: Vec<Turn>,
    /// Derivatives of each reading.
    width: usize,
}

impl<'a> Sensors<'a> {
    /// All accelerometers as the parameters have them.
    pub(super) fn new(parameters: &Parameters<f64>, free: &'a [Parameter], channels: &'a [Channel]) -> Self {
        let sensors = parameters.sensors.clone();
        let width = free.len() + 2 * parameters.joints.len();
        Self { channels, free, turns: sensors.iter().map(Turn::of).collect(), sensors, width }
    }

    /// One sample's readings and their derivatives (channels × width).
    pub(super) fn read(&mut self, links: &mut Links<'_>, prediction: &mut [f64], slopes: &mut [f64]) {
        for (c, &channel) in self.channels.iter().enumerate() {
            let row = &mut slopes[c * self.width..][..self.width];
            prediction[c] = match channel {
                Channel::Acceleration { sensor, axis } => self.specific_force(links, sensor, axis, row),
                Channel::Rate { sensor, axis } => self.angular_rate(links, sensor, axis, row),
                Channel::Position { sensor, axis } => self.tracked_position(links, sensor, axis, row),
                Channel::Link(j) => along(links, j, row),
                Channel::LinkVelocity(j) => along(links, links.motors.theta.len() + j, row),
                Channel::Torque(j) => self.torque(links, j, row),
                Channel::Motor(j) => links.motors.theta[j],
                Channel::MotorVelocity(j) => links.motors.dtheta[j],
                Channel::MotorTorque(j) => self.motor_torque(links, j, row),
                // Robots with such sensors are not calibrated.
                Channel::Wrench(_) => f64::NAN,
            };
        }
    }

    /// One axis of an accelerometer: scale · Rᵀ f + bias, f where the sensor is displaced to.
    fn specific_force(&self, links: &Links<'_>, s: usize, axis: usize, row: &mut [f64]) -> f64 {
        let Links { equation: Equation { robot, motion, .. }, .. } = links;
        let (kinematics, own, turn) = (&motion.kinematics, &self.sensors[s], &self.turns[s]);
        let Placed { body, axes, point } = kinematics.place(&robot.accelerometers[s].frame);
        let nominal = Placed { body, axes, point: point + axes.apply(&own.translation) };
        let placed = Placed { axes: axes.mul(&turn.own), ..nominal };
        let scale = own.scale.0[axis];
        let untouched = kinematics.specific_force_at(&nominal);
        let force = turn.own.apply_transposed(&untouched).0[axis];
        kinematics.specific_force_derivatives_at(&robot.tree, &placed, |joint, by| {
            chain(links, joint, by.map(|column| scale * column.0[axis]), row);
        });
        for (k, parameter) in self.free.iter().enumerate() {
            row[k] += match *parameter {
                Parameter::SensorBias(i, a) if (i, a) == (s, axis) => 1.0,
                Parameter::SensorScale(i, a) if (i, a) == (s, axis) => force,
                Parameter::SensorRotation(i, a) if i == s => scale * turn.by[a].apply_transposed(&untouched).0[axis],
                // Specific force is affine in the sensor's place.
                Parameter::SensorTranslation(i, a) if i == s => {
                    let moved = Placed { point: placed.point + axes.0[a], ..placed };
                    scale * (kinematics.specific_force_at(&moved).0[axis] - force)
                }
                _ => 0.0,
            };
        }
        scale * force + own.bias.0[axis]
    }

    /// One axis of a gyroscope, which is taken to be as the robot says.
    fn angular_rate(&self, links: &Links<'_>, s: usize, axis: usize, row: &mut [f64]) -> f64 {
        let Links { equation: Equation { robot, motion, .. }, .. } = links;
        let frame = &robot.gyroscopes[s].frame;
        motion.kinematics.angular_rate_derivatives(&robot.tree, frame, |joint, [by_q, by_dq]| {
            chain(links, joint, [by_q.0[axis], by_dq.0[axis], 0.0], row);
        });
        motion.kinematics.angular_rate(frame).0[axis]
    }

    /// One axis of a tracker, which is taken to be where the robot says.
    fn tracked_position(&self, links: &Links<'_>, s: usize, axis: usize, row: &mut [f64]) -> f64 {
        let Links { equation: Equation { robot, motion, .. }, .. } = links;
        let (kinematics, tracker) = (&motion.kinematics, &robot.trackers[s]);
        let frame = &tracker.target.frame;
        kinematics.position_jacobian(&robot.tree, frame, |joint, by| {
            chain(links, joint, [tracker.turn(&by).0[axis], 0.0, 0.0], row);
        });
        tracker.see(&kinematics.position(frame)).0[axis]
    }

    /// What the transmission gives the link; of a joint without a spring, what the link needs.
    fn torque(&self, links: &Links<'_>, j: usize, row: &mut [f64]) -> f64 {
        let Links { equation, state, motors, .. } = links;
        let n = motors.theta.len();
        if !equation.robot.drives[j].elastic {
            for k in 0..n {
                let e = j * n + k;
                let motion = &equation.motion;
                chain(links, k, [motion.by_q[e], motion.by_dq[e], motion.mass[e]], row);
            }
            return equation.motion.tau[j];
        }
        let [torque, stiffness, damping] = equation.transmission(j, motors, state);
        chain(links, j, [-stiffness, -damping, 0.0], row);
        equation.by_elements(j, motors, state, 1.0, row);
        for (k, &parameter) in self.free.iter().enumerate() {
            if let Some((_, slope)) = equation.transmission_by(parameter, motors, state).filter(|own| own.0 == j) {
                row[k] += slope;
            }
        }
        torque
    }

    /// What the motor gives by its own equation, B θ̈ + Sᵀ q̈ + friction(θ̇) + what its gear takes (De Luca, Schröder and
    /// Thümmel 2007, eq. (2)), over the factor on its torques as they are read.
    fn motor_torque(&self, links: &Links<'_>, j: usize, row: &mut [f64]) -> f64 {
        let Links { equation, state, motors, .. } = links;
        let (n, drive, own) = (motors.theta.len(), &equation.robot.drives[j], &equation.parameters.joints[j]);
        let (v, acceleration) = (motors.dtheta[j], motors.ddtheta[j]);
        let ratio = drive.ripple.output(motors.theta[j]).ratio;
        let (transmitted, dry) = (ratio * self.torque(links, j, row), DRY.dry(v).0);
        row.iter_mut().for_each(|x| *x *= ratio);
        let said = &drive.motor_friction;
        let friction =
            said.torque(v).0 + (own.viscous_friction - said.viscous) * v + (own.coulomb_friction - said.coulomb) * dry;
        let mut torque = own.motor_inertia * acceleration + friction + transmitted;
        for k in 0..j {
            let coupling = equation.parameters.coupling[k * n + j];
            torque += coupling * state[2 * n + k];
            chain(links, k, [0.0, 0.0, coupling], row);
        }
        for (k, parameter) in self.free.iter().enumerate() {
            row[k] += match *parameter {
                Parameter::MotorInertia(i) if i == j => acceleration,
                Parameter::ViscousFriction(i) if i == j => v,
                Parameter::CoulombFriction(i) if i == j => dry,
                Parameter::Coupling(i, motor) if motor == j => state[2 * n + i],
                Parameter::TorqueScale(i) if i == j => -torque / own.torque_scale,
                _ => 0.0,
            };
        }
        row.iter_mut().for_each(|x| *x /= own.torque_scale);
        torque / own.torque_scale
    }
}

/// A number of the state, and its derivatives.
fn along(links: &Links<'_>, i: usize, row: &mut [f64]) -> f64 {
    row.copy_from_slice(&links.slopes[i * row.len()..][..row.len()]);
    links.state[i]
}

/// Adds what a reading changes by because joint `joint` moves: `by` are its derivatives in q, q̇ and q̈.
fn chain(links: &Links<'_>, joint: usize, by: [f64; 3], row: &mut [f64]) {
    let (n, width) = (links.motors.theta.len(), row.len());
    for (order, slope) in by.into_iter().enumerate() {
        let own = &links.slopes[(order * n + joint) * width..][..width];
        row.iter_mut().zip(own).for_each(|(x, y)| *x += slope * y);
    }
}
