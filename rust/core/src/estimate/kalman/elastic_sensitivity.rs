//! What errors of a robot's numbers do to its accelerations, and by them to a step of time and to readings.
//!
//! The equations of motion are linear in nearly all parameters, F(x, ẍ) = Y p, so that at a given state ∂ẍ/∂p = −(∂F/∂ẍ)⁻¹ Y: one
//! right-hand side a parameter through factors that the step of time has anyway. Columns are then propagated with the covariance:
//! Σ ← Φ Σ + ∫ e^(A s) ∂ẋ/∂p ds over a step, and ∂h/∂p + H Σ at a reading.

use super::tolerances::Tolerances;
use super::uncertain::{Tolerance, Uncertain, of_sensor, shares_of_link};
use crate::dynamics::{ElasticDynamics, ElasticLayout};
use crate::estimate::measurement::Channel;
use crate::linear;
use crate::robot::Robot;

/// ∂q̈/∂p and ∂θ̈/∂p of the elastic-joint model, one column a parameter.
///
/// Each parameter is a torque on its joint, or for a mass on the joints that carry it: φ(δ) for ln K, δ³ for hardening,
/// D δ̇ for ln D between motor and link; −Yᵢπᵢ at the present q̈ for the mass of link i, −friction for a link's friction;
/// τ, −friction and −B θ̈ on a motor, of a rotor on all that carry it. Accelerations follow from all of them at once.
#[derive(Clone, Debug, Default)]
pub(super) struct ElasticSensitivity {
    /// One column each.
    tolerances: Tolerances,
    /// Numbers between rows: parameters, padded.
    stride: usize,
    /// ∂q̈/∂p (n × stride).
    pub(super) links: Vec<f64>,
    /// ∂θ̈/∂p (n × stride), of elastic joints; where jerk moves motors ∂τ/∂p.
    pub(super) motors: Vec<f64>,
    /// What the transmissions give their links more, in the same state (n × stride).
    transmitted: Vec<f64>,
    /// Motor positions (n) [rad].
    angles: Vec<f64>,
}

impl ElasticSensitivity {
    pub(super) fn new(tolerances: Tolerances, joints: usize) -> Self {
        let stride = tolerances.len().next_multiple_of(linear::LANES);
        let [links, motors, transmitted] = core::array::from_fn(|_| vec![0.0; joints * stride]);
        Self { tolerances, stride, links, motors, transmitted, angles: vec![0.0; joints] }
    }

    /// The parameters, in the order of the columns.
    pub(super) fn tolerances(&self) -> &Tolerances {
        &self.tolerances
    }

    /// Whether every number of the robot is taken to be exact.
    pub(super) fn is_empty(&self) -> bool {
        self.tolerances.is_empty()
    }

    /// At state `x` under motor torques `tau`, where `dynamics` has been differentiated.
    ///
    /// Torques of a unit error of each parameter first, as three right-hand sides for links, motors and transmissions;
    /// then all of them through the factors of the inertia at once.
    #[inline(always)]
    pub(super) fn set(
        &mut self,
        robot: &Robot,
        layout: &ElasticLayout,
        dynamics: &ElasticDynamics,
        x: &[f64],
        tau: &[f64],
    ) {
        self.load(robot, layout, dynamics, x, tau);
        let Self { stride, links, motors, transmitted, .. } = self;
        dynamics.respond(robot, links, motors, transmitted, *stride);
    }

    /// Σ of links (states × stride) that stand where motors and torsions put them: what a parameter gives a link more, its
    /// spring holds.
    pub(super) fn start_columns(
        &mut self,
        robot: &Robot,
        layout: &ElasticLayout,
        dynamics: &ElasticDynamics,
        x: &[f64],
        tau: &[f64],
        columns: &mut [f64],
    ) {
        self.load(robot, layout, dynamics, x, tau);
        let p = self.stride;
        for (j, drive) in robot.drives.iter().enumerate().filter(|(_, drive)| drive.elastic) {
            let compliance = drive.compliance(drive.torsion_between(x[layout.theta[j]], x[j]));
            for torques in [&self.links, &self.transmitted] {
                linear::add_scaled(&mut columns[j * p..][..p], compliance, &torques[j * p..][..p]);
            }
            // What friction elements hold the spring need not.
            let past = |one: &Tolerance| one.parameter == Uncertain::Hysteresis(j);
            let Some(column) = self.tolerances.iter().position(past) else { continue };
            for (i, element) in drive.hysteresis.elements.iter().enumerate() {
                columns[(layout.deflections[j] + i) * p + column] += element.reach();
                columns[j * p + column] += compliance * element.limit;
            }
        }
    }

    /// Torques of parameters on links and motors, and in transmissions.
    #[inline(always)]
    fn load(&mut self, robot: &Robot, layout: &ElasticLayout, dynamics: &ElasticDynamics, x: &[f64], tau: &[f64]) {
        let Self { tolerances, stride, links, motors, transmitted, angles } = self;
        // Where jerk moves motors their torques are what they need for it.
        let tau = if layout.motor_acceleration.is_some() { dynamics.motor_torques() } else { tau };
        for (angle, &k) in angles.iter_mut().zip(&layout.theta) {
            *angle = x[k];
        }
        for torques in [&mut *links, &mut *motors, &mut *transmitted] {
            torques.fill(0.0);
        }
        for (column, Tolerance { parameter, .. }) in tolerances.iter().enumerate() {
            use Uncertain as U;
            if let U::Mass(link) = *parameter {
                shares_of_link(&dynamics.kinematics, &robot.tree, link, |j, share| {
                    links[j * *stride + column] -= share;
                });
                continue;
            }
            let Some(j) = parameter.joint() else { continue };
            let rotor = robot.rotors.iter().position(|rotor| rotor.motor == j);
            if let (U::MotorInertia(_), Some(k)) = (parameter, rotor) {
                // The rotor is a body of its own: its carriers feel it as they feel a link's mass.
                shares_of_link(&dynamics.kinematics, dynamics.tree(robot), layout.joints + k, |i, share| {
                    if i < layout.joints {
                        links[i * *stride + column] = -share;
                    } else {
                        motors[j * *stride + column] = -(share * robot.rotors[k].ratio);
                    }
                });
                continue;
            }
            if let Some(motor) = robot.gearing.as_ref().and_then(|gearing| gearing.motor(j)) {
                // A motor that turns several joints: what it gives more, all of them feel.
                let drive = &robot.drives[j];
                let more = match parameter {
                    U::TorqueConstant(_) => Some(motor.torque(|j| tau[j])),
                    U::MotorFriction(_) => Some(-drive.motor_friction(motor.speed(|j| x[layout.dtheta[j]])).0),
                    U::MotorInertia(_) => Some(-drive.motor_inertia * motor.speed(|j| dynamics.ddtheta[j])),
                    _ => None,
                };
                if let Some(more) = more {
                    motor.joints().for_each(|(k, by)| motors[k * *stride + column] = more * by);
                    continue;
                }
            }
            let (drive, at) = (&robot.drives[j], j * *stride + column);
            let (theta, speed, dq) = (x[layout.theta[j]], x[layout.dtheta[j]], x[layout.joints + j]);
            let torsion = drive.torsion_between(theta, x[j]);
            let motor = match parameter {
                U::Stiffness(_) => drive.spring_torque(torsion),
                U::CubicStiffness(_) => drive.hardening(torsion),
                U::Damping(_) => drive.damping * drive.slip(theta, [speed, dq]),
                U::TorqueConstant(_) => tau[j],
                U::MotorFriction(_) => -dynamics.frictions(robot, layout, x, j)[0],
                U::MotorInertia(_) => -drive.motor_inertia * dynamics.ddtheta[j],
                _ => 0.0,
            };
            match parameter {
                U::LinkFriction(_) => links[at] = -dynamics.frictions(robot, layout, x, j)[1],
                U::Stiffness(_) | U::CubicStiffness(_) | U::Damping(_) if drive.elastic => transmitted[at] = motor,
                U::Stiffness(_)
                | U::CubicStiffness(_)
                | U::Damping(_)
                | U::EncoderZero(_)
                | U::EncoderLine(..)
                | U::LostMotion(_)
                | U::Hysteresis(_) => {}
                _ => motors[at] = motor,
            }
        }
    }

    /// N = ∂h/∂p at state `x`, where [`set`](Self::set) was called, into `out` (channels × `stride`).
    ///
    /// Motors and links are states; accelerometers feel ∂q̈/∂p, joint torque sensors what transmissions give more, motor torques
    /// what motors need more. What a
    /// joint taken as rigid yields shows between its motor's position and the link.
    #[inline(always)]
    pub(super) fn signatures(
        &self,
        robot: &Robot,
        dynamics: &ElasticDynamics,
        channels: &[Channel],
        stride: usize,
        out: &mut [f64],
    ) {
        out.fill(0.0);
        for (row, channel) in channels.iter().enumerate() {
            match *channel {
                Channel::Torque(j) => {
                    out[row * stride..][..stride].copy_from_slice(&self.transmitted[j * stride..][..stride]);
                }
                Channel::MotorTorque(j) => {
                    out[row * stride..][..stride].copy_from_slice(&self.motors[j * stride..][..stride]);
                }
                Channel::Acceleration { sensor, axis } => {
                    let own = &mut out[row * stride..][..stride];
                    dynamics.kinematics.acceleration_map(&robot.tree, &robot.accelerometers[sensor].frame, |j, by| {
                        linear::add_scaled(own, by.0[axis], &self.links[j * stride..][..stride]);
                    });
                }
                _ => {}
            }
        }
        for (column, Tolerance { parameter, .. }) in self.tolerances.iter().enumerate() {
            let mut put = |row: usize, value: f64| out[row * stride + column] += value;
            if let Uncertain::EncoderZero(j) | Uncertain::LostMotion(j) = *parameter {
                let row = channels.iter().position(|c| *c == Channel::Motor(j));
                row.into_iter().for_each(|row| put(row, 1.0));
            } else if let Uncertain::EncoderLine(j, line) = *parameter {
                let row = channels.iter().position(|c| *c == Channel::Motor(j));
                row.into_iter().for_each(|row| put(row, robot.drives[j].encoder_line(line, self.angles[j])));
            } else if let Uncertain::Yielding(j) = *parameter {
                let row = channels.iter().position(|c| *c == Channel::Motor(j) && !robot.drives[j].elastic);
                row.into_iter().for_each(|row| {
                    out[row * stride + column] += dynamics.joint_torque(robot, j) / dynamics.inertia(robot, j)
                });
            } else {
                of_sensor(&dynamics.kinematics, robot, channels, *parameter, put);
            }
        }
    }
}

#[cfg(test)]
#[allow(clippy::disallowed_methods)] // the oracle is the platform's
mod tests;
