//! The links' equation of motion with its derivatives.

use super::super::parameters::{Parameter, Parameters};
use crate::estimate::measurement::LinkMotion;
use crate::robot::{Drive, Robot};
use crate::scalar::{Dual, Scalar};
use crate::spatial::{Inertia, Sym3, Vec3};

/// Motors at one moment, each (n): position, velocity and acceleration.
#[derive(Clone, Debug)]
pub(super) struct MotorSample {
    /// [rad].
    pub(super) theta: Vec<f64>,
    /// [rad/s].
    pub(super) dtheta: Vec<f64>,
    /// [rad/s²].
    pub(super) ddtheta: Vec<f64>,
}

impl MotorSample {
    /// At rest at zero.
    pub(super) fn new(n: usize) -> Self {
        Self { theta: vec![0.0; n], dtheta: vec![0.0; n], ddtheta: vec![0.0; n] }
    }
}

/// What links need less what springs give, at one moment: residual (n) and its derivatives in q, q̇ and q̈ (n × n), and in
/// the parameters (n × p). Joints without a spring have rows of the identity: they move as their motors do.
#[derive(Clone, Debug)]
pub(super) struct Balance {
    /// M q̈ + C q̇ + g + friction + S θ̈ − φ − D δ̇ [N m].
    pub(super) residual: Vec<f64>,
    /// Row by row, a joint each; the last is M.
    pub(super) by_q: Vec<f64>,
    pub(super) by_dq: Vec<f64>,
    pub(super) by_ddq: Vec<f64>,
    /// In the order of the free parameters.
    pub(super) by_parameter: Vec<f64>,
}

impl Balance {
    /// Room for `n` joints and `p` parameters.
    pub(super) fn new(n: usize, p: usize) -> Self {
        let square = vec![0.0; n * n];
        Self {
            residual: vec![0.0; n],
            by_q: square.clone(),
            by_dq: square.clone(),
            by_ddq: square,
            by_parameter: vec![0.0; n * p],
        }
    }
}

/// The equation of motion of one robot under given parameters, and scratch.
#[derive(Clone, Debug)]
pub(super) struct Equation<'a> {
    /// As robot.yaml has it; its springs' rates, masses and coupling are the parameters'.
    pub(super) robot: &'a Robot,
    /// The robot's numbers now, and which of them are free.
    pub(super) parameters: Parameters<f64>,
    pub(super) free: &'a [Parameter],
    /// Derivatives of the bodies' masses in those free parameters that change them; empty for the others.
    masses: Vec<Vec<Inertia<f64>>>,
    /// Motion and loads of the links, by the parameters' masses.
    pub(super) motion: LinkMotion<f64>,
    /// Scratch: what masses that a parameter changes take (n).
    loads: Vec<f64>,
}

impl<'a> Equation<'a> {
    pub(super) fn new(robot: &'a Robot, parameters: Parameters<f64>, free: &'a [Parameter]) -> Self {
        let mut motion = LinkMotion::new(robot);
        motion.kinematics.set_masses(parameters.masses(robot));
        let masses = free.iter().map(|&parameter| masses_by(robot, &parameters, parameter)).collect();
        Self { robot, parameters, free, masses, motion, loads: vec![0.0; robot.len()] }
    }

    /// Torque of joint `j`'s transmission on its link, and its slopes in torsion and its rate.
    pub(super) fn transmission(&self, j: usize, motors: &MotorSample, state: &[f64]) -> [f64; 3] {
        let (own, Drive { soft_windup, .. }) = (&self.parameters.joints[j], &self.robot.drives[j]);
        let n = self.robot.len();
        let (torsion, rate) = (motors.theta[j] - state[j], motors.dtheta[j] - state[n + j]);
        let square = torsion * torsion;
        let secant = own.spring.stiffness + own.spring.cubic * square + soft_windup.secant(square);
        let slope = own.spring.stiffness + 3.0 * own.spring.cubic * square + soft_windup.tangent(square);
        [secant * torsion + own.damping * rate, slope, own.damping]
    }

    /// The derivative of joint `j`'s transmission torque in a parameter, if it is one of its own.
    pub(super) fn transmission_by(parameter: Parameter, motors: &MotorSample, state: &[f64]) -> Option<(usize, f64)> {
        let n = motors.theta.len();
        let torsion = |j: usize| motors.theta[j] - state[j];
        Some(match parameter {
            Parameter::Stiffness(j) => (j, torsion(j)),
            Parameter::CubicStiffness(j) => (j, torsion(j).powi(3)),
            Parameter::Damping(j) => (j, motors.dtheta[j] - state[n + j]),
            _ => return None,
        })
    }

    /// At `state` = (q, q̇, q̈).
    pub(super) fn balance(&mut self, motors: &MotorSample, state: &[f64], out: &mut Balance) {
        let n = self.robot.len();
        self.motion.set(self.robot, state);
        out.by_q.copy_from_slice(&self.motion.by_q);
        out.by_dq.copy_from_slice(&self.motion.by_dq);
        out.by_ddq.copy_from_slice(&self.motion.mass);
        for (j, drive) in self.robot.drives.iter().enumerate() {
            let row = j * n..(j + 1) * n;
            if !drive.elastic {
                out.residual[j] = 0.0;
                for matrix in [&mut out.by_q, &mut out.by_dq, &mut out.by_ddq] {
                    matrix[row.clone()].fill(0.0);
                }
                // The identity, with nothing left: whatever is solved with these rows leaves the joint where its motor
                // put it.
                out.by_ddq[j * n + j] = 1.0;
                continue;
            }
            let [torque, stiffness, damping] = self.transmission(j, motors, state);
            let (friction, viscous) = drive.link_friction(state[n + j]);
            let coupled: f64 = self.parameters.coupling[row].iter().zip(&motors.ddtheta).map(|(s, a)| s * a).sum();
            // The motor's part in the link's row is known: S θ̈ of the recorded motion.
            out.residual[j] = self.motion.tau[j] + friction + coupled - torque;
            out.by_q[j * n + j] += stiffness;
            out.by_dq[j * n + j] += damping + viscous;
        }
    }

    /// The residual's derivatives in the parameters, where [`balance`](Self::balance) was called last.
    pub(super) fn differentiate(&mut self, motors: &MotorSample, state: &[f64], out: &mut Balance) {
        let (robot, p) = (self.robot, self.free.len());
        out.by_parameter.fill(0.0);
        for (k, &parameter) in self.free.iter().enumerate() {
            if let Some((j, slope)) = Self::transmission_by(parameter, motors, state) {
                out.by_parameter[j * p + k] = -slope;
            } else if let Parameter::Coupling(i, j) = parameter {
                out.by_parameter[i * p + k] = motors.ddtheta[j];
            } else if !self.masses[k].is_empty() {
                // Loads are linear in the moments of mass: a derivative is the load of the derivative's masses.
                self.motion.loads_of(robot, &mut self.masses[k], &mut self.loads);
                for (j, load) in self.loads.iter().enumerate() {
                    out.by_parameter[j * p + k] = *load;
                }
            }
        }
        for (j, _) in robot.drives.iter().enumerate().filter(|(_, drive)| !drive.elastic) {
            out.by_parameter[j * p..][..p].fill(0.0);
        }
    }
}

/// Derivatives of all bodies' moments of mass in `parameter`; empty if they do not depend on it.
fn masses_by(robot: &Robot, parameters: &Parameters<f64>, parameter: Parameter) -> Vec<Inertia<f64>> {
    use Parameter as P;
    if !matches!(parameter, P::MassScale(_) | P::PayloadMass | P::PayloadCentre(_)) {
        return Vec::new();
    }
    // By derivative numbers once a run, so that the loop itself stays in `f64`.
    let mut varied: Parameters<Dual<1>> = Parameters::of(robot);
    for (varied, own) in varied.joints.iter_mut().zip(&parameters.joints) {
        varied.mass_scale = Dual::constant(own.mass_scale);
    }
    varied.payload_mass = Dual::constant(parameters.payload_mass);
    varied.payload_centre = Vec3::constant(&parameters.payload_centre);
    if let Some(slot) = varied.slot(parameter) {
        *slot = Dual::variable(slot.value, 0);
    }
    let slope = |x: Dual<1>| x.gradient[0];
    let derivative = |m: Inertia<Dual<1>>| Inertia {
        mass: slope(m.mass),
        first: Vec3(m.first.0.map(slope)),
        second: Sym3(m.second.0.map(slope)),
    };
    varied.masses(robot).into_iter().map(derivative).collect()
}
