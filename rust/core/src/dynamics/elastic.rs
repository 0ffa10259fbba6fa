//! Forward dynamics of a robot with elastic and rigid joints, and their derivatives.

use super::{Kinematics, Loads};
use crate::error::DesignError;
use crate::linear;
use crate::robot::Robot;
use crate::simd::{self, Kernel};

/// Where in the state each joint's numbers are: (q, q̇, θ, θ̇ of the elastic joints, disturbance torques).
#[derive(Clone, Debug)]
pub struct ElasticLayout {
    /// Number of joints.
    pub joints: usize,
    /// θ of each joint; q where the joint is rigid.
    pub theta: Vec<usize>,
    /// θ̇ of each joint; q̇ where the joint is rigid.
    pub dtheta: Vec<usize>,
    /// The first disturbance torque.
    pub disturbance: Option<usize>,
    /// Length of the whole.
    pub dense: usize,
}

impl ElasticLayout {
    /// That of `robot`; with a disturbance torque of every motor if `disturbances`.
    ///
    /// # Errors
    /// Motors on links: their coupling changes with posture, see [`ForwardDynamics`](super::ForwardDynamics).
    pub fn new(robot: &Robot, disturbances: bool) -> Result<Self, DesignError> {
        if let Some(rotor) = robot.rotors.first() {
            return Err(DesignError::Rotor { joint: rotor.motor });
        }
        let n = robot.len();
        let elastic = robot.drives.iter().filter(|d| d.elastic).count();
        let mut next = 2 * n;
        let mut theta: Vec<_> = (0..n).collect();
        for (j, slot) in theta.iter_mut().enumerate() {
            if robot.drives[j].elastic {
                *slot = next;
                next += 1;
            }
        }
        let dtheta = (0..n).map(|j| if theta[j] < n { n + j } else { theta[j] + elastic }).collect();
        let first = 2 * (n + elastic);
        Ok(Self {
            joints: n,
            theta,
            dtheta,
            disturbance: disturbances.then_some(first),
            dense: first + if disturbances { n } else { 0 },
        })
    }
}

/// Accelerations of links and motors, and what they depend on.
///
/// Both rows of the model with constant coupling (De Luca, Schröder and Thümmel 2007, eq. (2)), θ̈ eliminated as B is
/// diagonal: (M − S B⁻¹ Sᵀ) q̈ = τ_e − C q̇ − g − d − S B⁻¹ (τ − τ_e). A rigid joint's motor moves with its link: its
/// row and column of S and its B join M. Derivatives: those of M q̈ + C q̇ + g are of the inverse dynamics at q̈.
#[derive(Clone, Debug)]
pub struct ElasticDynamics {
    /// q̈ (n) [rad/s²].
    pub ddq: Vec<f64>,
    /// θ̈ (n) [rad/s²]; q̈ where the joint is rigid.
    pub ddtheta: Vec<f64>,
    /// ∂q̈/∂x, n × dense.
    pub ddq_by: Vec<f64>,
    /// ∂θ̈/∂x, n × dense.
    pub ddtheta_by: Vec<f64>,
    /// ∂q̈/∂τ, n × n.
    pub ddq_by_tau: Vec<f64>,
    /// Of the tree: at the state of [`accelerate`](Self::accelerate), after [`differentiate`](Self::differentiate)
    /// with the accelerations.
    pub kinematics: Kinematics<f64>,
    loads: Loads<f64>,
    zero: Vec<f64>,
    load: Vec<f64>,
    mass: Vec<f64>,
    by_q: Vec<f64>,
    by_dq: Vec<f64>,
    ignored: Vec<f64>,
    /// τ_e (n) [N m]; behind a rigid drive its motor's torque less friction.
    pub spring: Vec<f64>,
    /// Motor torque less friction.
    drive: Vec<f64>,
}

impl ElasticDynamics {
    /// Room for `robot`.
    pub fn new(robot: &Robot, layout: &ElasticLayout) -> Self {
        let (tree, n, d) = (&robot.tree, robot.len(), layout.dense);
        let [zero, ddq, ddtheta, load, spring, drive] = core::array::from_fn(|_| vec![0.0; n]);
        let [mass, by_q, by_dq, ignored, ddq_by_tau] = core::array::from_fn(|_| vec![0.0; n * n]);
        let [ddq_by, ddtheta_by] = core::array::from_fn(|_| vec![0.0; n * d]);
        let (kinematics, loads) = (Kinematics::new(tree), Loads::new(tree));
        Self {
            ddq,
            ddtheta,
            ddq_by,
            ddtheta_by,
            ddq_by_tau,
            kinematics,
            loads,
            zero,
            load,
            mass,
            by_q,
            by_dq,
            ignored,
            spring,
            drive,
        }
    }

    /// Accelerations at state `x` (dense) under motor torques `tau` (n) [N m]; NaN when the inertia is not positive definite.
    pub fn accelerate(&mut self, robot: &Robot, layout: &ElasticLayout, x: &[f64], tau: &[f64]) {
        simd::phase(Accelerate { dynamics: self, robot, layout, x, tau });
    }

    #[inline(always)]
    fn accelerate_here(&mut self, robot: &Robot, layout: &ElasticLayout, x: &[f64], tau: &[f64]) {
        let n = layout.joints;
        let (q, dq) = (&x[..n], &x[n..2 * n]);
        let Self { kinematics, loads, load, mass, .. } = self;
        kinematics.set_motion(&robot.tree, q, dq, &self.zero);
        loads.inverse_dynamics_into(&robot.tree, kinematics, load);
        loads.mass_matrix_into(&robot.tree, kinematics, mass);
        for (j, drive) in robot.drives.iter().enumerate() {
            let (speed, extra) = (x[layout.dtheta[j]], layout.disturbance.map_or(0.0, |first| x[first + j]));
            let friction = drive.motor_friction(speed).0;
            self.drive[j] = tau[j] + extra - friction;
            self.spring[j] = if drive.elastic {
                drive.spring_torque(x[layout.theta[j]] - q[j]) + drive.damping * (speed - dq[j])
            } else {
                self.drive[j]
            };
            self.ddq[j] = self.spring[j] - load[j] - drive.link_friction(dq[j]).0;
        }
        self.couple(robot);
        linear::factorise(&mut self.mass, n);
        if !linear::is_definite(&self.mass, n) {
            self.ddq.fill(f64::NAN);
            self.ddtheta.fill(f64::NAN);
            return;
        }
        linear::solve(&self.mass, n, &mut self.ddq, 1);
        for (j, drive) in robot.drives.iter().enumerate() {
            self.ddtheta[j] = if drive.elastic {
                let pull: f64 = (0..j).map(|i| robot.coupling[i * n + j] * self.ddq[i]).sum();
                (self.drive[j] - self.spring[j] - pull) / drive.motor_inertia
            } else {
                self.ddq[j]
            };
        }
    }

    /// What the transmission of joint `j` gives its link [N m], after [`accelerate`](Self::accelerate): the torque of
    /// spring and damper, behind a rigid drive what the motor leaves of its own.
    #[inline(always)]
    pub fn joint_torque(&self, robot: &Robot, j: usize) -> f64 {
        let (n, drive) = (robot.len(), &robot.drives[j]);
        if drive.elastic {
            return self.spring[j];
        }
        let pull: f64 = (0..j).map(|i| robot.coupling[i * n + j] * self.ddq[i]).sum();
        self.drive[j] - drive.motor_inertia * self.ddq[j] - pull
    }

    /// ẋ, after [`accelerate`](Self::accelerate) at state `x`: `out` (dense) is overwritten; disturbances stay.
    #[inline(always)]
    pub fn rate_into(&self, layout: &ElasticLayout, x: &[f64], out: &mut [f64]) {
        let n = layout.joints;
        out.fill(0.0);
        for j in 0..n {
            out[layout.theta[j]] = x[layout.dtheta[j]];
            out[layout.dtheta[j]] = self.ddtheta[j];
            out[j] = x[n + j];
            out[n + j] = self.ddq[j];
        }
    }

    /// ẋ = A x near `x` under `tau`: A, row-major dense × dense. Allocates.
    pub fn linearise(&mut self, robot: &Robot, layout: &ElasticLayout, x: &[f64], tau: &[f64]) -> Vec<f64> {
        let (n, d) = (layout.joints, layout.dense);
        self.accelerate(robot, layout, x, tau);
        self.differentiate(robot, layout, x);
        let mut a = vec![0.0; d * d];
        for j in 0..n {
            a[layout.theta[j] * d + layout.dtheta[j]] = 1.0;
            a[layout.dtheta[j] * d..][..d].copy_from_slice(&self.ddtheta_by[j * d..][..d]);
            a[j * d + n + j] = 1.0;
            a[(n + j) * d..][..d].copy_from_slice(&self.ddq_by[j * d..][..d]);
        }
        a
    }

    /// What motors add to the links' inertia and torque.
    #[inline(always)]
    fn couple(&mut self, robot: &Robot) {
        let n = robot.len();
        for (j, drive) in robot.drives.iter().enumerate() {
            let s = |i: usize| robot.coupling[i * n + j];
            if !drive.elastic {
                self.mass[j * n + j] += drive.motor_inertia;
                for i in 0..j {
                    self.mass[i * n + j] += s(i);
                    self.mass[j * n + i] += s(i);
                }
                continue;
            }
            for i in (0..j).filter(|&i| s(i) != 0.0) {
                let share = s(i) / drive.motor_inertia;
                self.ddq[i] -= share * (self.drive[j] - self.spring[j]);
                for k in 0..j {
                    self.mass[i * n + k] -= share * s(k);
                }
            }
        }
    }

    /// Derivatives of the accelerations, after [`accelerate`](Self::accelerate) at the same state.
    pub fn differentiate(&mut self, robot: &Robot, layout: &ElasticLayout, x: &[f64]) {
        simd::phase(Differentiate { dynamics: self, robot, layout, x });
    }

    #[inline(always)]
    fn differentiate_here(&mut self, robot: &Robot, layout: &ElasticLayout, x: &[f64]) {
        let (n, d) = (layout.joints, layout.dense);
        let (q, dq) = (&x[..n], &x[n..2 * n]);
        let Self { kinematics, loads, by_q, by_dq, ignored, load, .. } = self;
        kinematics.set(&robot.tree, q, dq, &self.ddq);
        loads.inverse_dynamics_derivatives_into(&robot.tree, kinematics, load, by_q, by_dq, ignored);
        self.ddtheta_by.fill(0.0);
        self.ddq_by_tau.fill(0.0);
        for (i, row) in self.ddq_by.chunks_exact_mut(d).enumerate() {
            row.fill(0.0);
            for k in 0..n {
                row[k] = -by_q[i * n + k];
                row[n + k] = -by_dq[i * n + k];
            }
            row[n + i] -= robot.drives[i].link_friction(dq[i]).1;
        }
        for j in 0..n {
            self.differentiate_motor(robot, layout, x, j);
        }
        linear::solve(&self.mass, n, &mut self.ddq_by, d);
        linear::solve(&self.mass, n, &mut self.ddq_by_tau, n);
        for (j, drive) in robot.drives.iter().enumerate() {
            let own = &mut self.ddtheta_by[j * d..][..d];
            if !drive.elastic {
                own.copy_from_slice(&self.ddq_by[j * d..][..d]);
                continue;
            }
            for i in 0..j {
                linear::add_scaled(own, -robot.coupling[i * n + j], &self.ddq_by[i * d..][..d]);
            }
            for value in own {
                *value /= drive.motor_inertia;
            }
        }
    }

    /// What motor j's spring, friction, torque and disturbance do to the torques on links and on itself.
    #[inline(always)]
    fn differentiate_motor(&mut self, robot: &Robot, layout: &ElasticLayout, x: &[f64], j: usize) {
        let (n, d, drive) = (layout.joints, layout.dense, &robot.drives[j]);
        let (theta, dtheta) = (layout.theta[j], layout.dtheta[j]);
        let slip = drive.motor_friction(x[dtheta]).1;
        let disturbance = layout.disturbance.map(|first| first + j);
        if !drive.elastic {
            self.ddq_by[j * d + dtheta] -= slip;
            self.ddq_by_tau[j * n + j] = 1.0;
            if let Some(k) = disturbance {
                self.ddq_by[j * d + k] = 1.0;
            }
            return;
        }
        let (kappa, damping) = (drive.tangent_stiffness(x[theta] - x[j]), drive.damping);
        let spring = [(theta, kappa), (j, -kappa), (dtheta, damping), (n + j, -damping)];
        for i in 0..=j {
            let share = if i == j { 1.0 } else { robot.coupling[i * n + j] / drive.motor_inertia };
            if share == 0.0 {
                continue;
            }
            for (k, slope) in spring {
                self.ddq_by[i * d + k] += share * slope;
            }
            if i < j {
                self.ddq_by[i * d + dtheta] += share * slip;
                self.ddq_by_tau[i * n + j] = -share;
                if let Some(k) = disturbance {
                    self.ddq_by[i * d + k] = -share;
                }
            }
        }
        let own = &mut self.ddtheta_by[j * d..][..d];
        for (k, slope) in spring {
            own[k] -= slope;
        }
        own[dtheta] -= slip;
        if let Some(k) = disturbance {
            own[k] = 1.0;
        }
    }
}

struct Accelerate<'a> {
    dynamics: &'a mut ElasticDynamics,
    robot: &'a Robot,
    layout: &'a ElasticLayout,
    x: &'a [f64],
    tau: &'a [f64],
}

impl Kernel for Accelerate<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        self.dynamics.accelerate_here(self.robot, self.layout, self.x, self.tau);
    }
}

struct Differentiate<'a> {
    dynamics: &'a mut ElasticDynamics,
    robot: &'a Robot,
    layout: &'a ElasticLayout,
    x: &'a [f64],
}

impl Kernel for Differentiate<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        self.dynamics.differentiate_here(self.robot, self.layout, self.x);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::{BodySpec, Drive, JointKind, MotorFriction, SoftWindup, Tree};
    use crate::spatial::{Mat3, Vec3};

    /// Four joints, one of them sliding, one rigid, coupled, with everything nonlinear.
    fn robot() -> Robot {
        let drive = |elastic| Drive {
            elastic,
            stiffness: 500.0,
            damping: 2.0,
            motor_inertia: 3.0,
            cubic_stiffness: 3e3,
            soft_windup: SoftWindup { stiffness: 120.0, shape: 80.0 },
            motor_friction: MotorFriction { viscous: 0.4, coulomb: 1e-3, ..MotorFriction::default() },
            link_friction: [0.5, 1.5, 0.5, 0.2, 1.0, 0.5],
        };
        let body = |index: usize| BodySpec {
            parent: index.checked_sub(1),
            joint: index,
            kind: if index == 2 { JointKind::Prismatic } else { JointKind::Revolute },
            rotation: Mat3::IDENTITY,
            translation: Vec3([0.4, 0.1, 0.0]),
            axis: Vec3(if index.is_multiple_of(2) { [0.0, 0.0, 1.0] } else { [0.0, 1.0, 0.0] }),
            mass: 2.0,
            com: Vec3([0.2, 0.1, 0.0]),
            inertia: Mat3::from_rows([[0.1, 0.0, 0.0], [0.0, 0.2, 0.0], [0.0, 0.0, 0.15]]),
        };
        let tree = Tree::new(Vec3([1.0, 0.0, -9.0]), &[0, 1, 2, 3].map(body)).unwrap();
        let mut coupling = vec![0.0; 16];
        (coupling[1], coupling[3], coupling[7], coupling[2], coupling[6]) = (0.2, 0.1, -0.1, 0.05, 0.3);
        let drives = [true, true, false, true].map(drive).to_vec();
        Robot::new(tree, drives, coupling, vec![], vec![], None).unwrap()
    }

    #[test]
    fn derivatives_are_those_of_differences() {
        let robot = robot();
        let layout = ElasticLayout::new(&robot, true).unwrap();
        let d = layout.dense;
        assert_eq!((d, &layout.theta[..], &layout.dtheta[..]), (18, &[8, 9, 2, 10][..], &[11, 12, 6, 13][..]));
        let x: Vec<f64> = (0..d).map(|i| 0.3 * (1.7 * i as f64).sin()).collect();
        let tau = [5.0, -3.0, 2.0, 1.0];
        let mut dynamics = ElasticDynamics::new(&robot, &layout);
        dynamics.accelerate(&robot, &layout, &x, &tau);
        dynamics.differentiate(&robot, &layout, &x);
        let mut probe = ElasticDynamics::new(&robot, &layout);
        let mut at = |x: &[f64], tau: &[f64]| {
            probe.accelerate(&robot, &layout, x, tau);
            [probe.ddq.clone(), probe.ddtheta.clone()].concat()
        };
        let (h, n) = (1e-6, 4);
        let check = |above: Vec<f64>, below: Vec<f64>, ours: &dyn Fn(usize) -> f64| {
            for i in 0..2 * n {
                let slope = (above[i] - below[i]) / (2.0 * h);
                assert!((ours(i) - slope).abs() < 1e-6 * (1.0 + slope.abs()), "{i}: {} {slope}", ours(i));
            }
        };
        for k in 0..d {
            let (mut above, mut below) = (x.clone(), x.clone());
            (above[k], below[k]) = (above[k] + h, below[k] - h);
            let ours = |i: usize| if i < n { dynamics.ddq_by[i * d + k] } else { dynamics.ddtheta_by[(i - n) * d + k] };
            check(at(&above, &tau), at(&below, &tau), &ours);
        }
        for k in 0..n {
            let (mut above, mut below) = (tau, tau);
            (above[k], below[k]) = (above[k] + h, below[k] - h);
            let [above, below] = [above, below].map(|tau| at(&x, &tau)[..n].to_vec());
            for i in 0..n {
                let slope = (above[i] - below[i]) / (2.0 * h);
                assert!((dynamics.ddq_by_tau[i * n + k] - slope).abs() < 1e-6 * (1.0 + slope.abs()));
            }
        }
    }

    #[test]
    fn both_rows_of_the_model_balance() {
        let robot = robot();
        let layout = ElasticLayout::new(&robot, false).unwrap();
        let x: Vec<f64> = (0..layout.dense).map(|i| 0.3 * (1.7 * i as f64).sin()).collect();
        let (n, tau) = (4, [5.0, -3.0, 2.0, 1.0]);
        let mut dynamics = ElasticDynamics::new(&robot, &layout);
        dynamics.accelerate(&robot, &layout, &x, &tau);
        let (mut kinematics, mut loads) = (Kinematics::new(&robot.tree), Loads::new(&robot.tree));
        kinematics.set(&robot.tree, &x[..n], &x[n..2 * n], &dynamics.ddq);
        let mut load = vec![0.0; n];
        loads.inverse_dynamics_into(&robot.tree, &kinematics, &mut load);
        for (j, drive) in robot.drives.iter().enumerate() {
            let (theta, dtheta) = (x[layout.theta[j]], x[layout.dtheta[j]]);
            let spring = drive.spring_torque(theta - x[j]) + drive.damping * (dtheta - x[n + j]);
            let pull: f64 = (0..n).map(|i| robot.coupling[i * n + j] * dynamics.ddq[i]).sum();
            let push: f64 = (0..n).map(|i| robot.coupling[j * n + i] * dynamics.ddtheta[i]).sum();
            let motor = tau[j] - drive.motor_friction.viscous * dtheta - drive.dry_friction(dtheta);
            let torque = if drive.elastic { spring } else { motor - drive.motor_inertia * dynamics.ddq[j] - pull };
            let link = load[j] + drive.link_friction(x[n + j]).0 + push - torque;
            assert!(link.abs() < 1e-12, "{j}: {link}");
            let sensor = dynamics.joint_torque(&robot, j);
            assert!((sensor - torque).abs() < 1e-12, "{j}: {sensor} {torque}");
            if drive.elastic {
                let row = drive.motor_inertia * dynamics.ddtheta[j] + pull + spring - motor;
                assert!(row.abs() < 1e-12, "{j}: {row}");
            }
        }
    }
}
