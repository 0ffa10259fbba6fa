//! Forward dynamics of a robot with elastic and rigid joints, and their derivatives.
//!
//! | part | where |
//! | --- | --- |
//! | which state is where: q, q̇, θ and θ̇ of the elastic joints, disturbance torques | [`ElasticLayout`] |
//! | S and the tree with rotors as bodies | `coupling` |
//! | q̈ and θ̈ | [`ElasticDynamics::accelerate`] |
//! | q̈ alone, θ̈ being eliminated, and θ̈ after it | `eliminated` |
//! | their derivatives by state and torque, by solving with the factors of the inertia | `derivatives` |
//! | both where jerk moves motors, whatever it takes | `prescribed` |
//!
//! Simulator, elastic-joint filter and smoother, and arrays from Python all read it.

mod coupling;
mod derivatives;
mod elements;
mod eliminated;
mod layout;
mod prescribed;
#[cfg(test)]
mod tests;

pub(crate) use elements::ElementRow;
pub use layout::ElasticLayout;

use super::{Kinematics, Loads, NewtonEuler};
use crate::linear;
use crate::robot::{Robot, Tree};
use crate::scalar::Scalar;
use crate::simd::{self, Kernel};
use coupling::Coupling;
use elements::element_row;
use prescribed::Prescribed;

/// Accelerations of links and motors, and what they depend on.
///
/// De Luca, Schröder and Thümmel (2007), eq. (2), with nonlinear springs and friction (Ulrich and Sasiadek 2011,
/// eqs. (10)–(16)):
///
/// ```text
/// M q̈ + S θ̈ + C q̇ + g + d(q̇, τ_e) = τ_e(θ + ε(θ) − q, (1 + ε′) θ̇ − q̇)
/// Sᵀ q̈ + B θ̈ + f(θ̇, (1 + ε′) τ_e) = τ − (1 + ε′) τ_e
/// ```
///
/// Frictions f and d may grow with the torque that is transmitted: that is a function of the state, no unknown.
/// ε is the kinematic error of each gear, on which power does not depend. Beside each spring there may be friction elements,
/// whose deflections are states: ż = δ̇ g(z, sign δ̇).
/// θ̈ is eliminated, as B is diagonal: (M − S B⁻¹ Sᵀ) q̈ = τ_e − C q̇ − g − d − S B⁻¹ (τ − f − (1 + ε′) τ_e). A rigid joint's motor
/// moves with its link: its row and column of S and its B join M. Motors that are [`Rotor`](crate::robot::Rotor)s on
/// links are bodies of an extended tree, whence S(q) and its velocity terms in both rows. Derivatives: those of the
/// left-hand side are of the inverse dynamics at q̈ and θ̈. Of joints that [share motors](crate::robot::Gearing) B is a full
/// matrix, and S zero. Where motors' accelerations are [states](ElasticLayout::motor_acceleration), the first row alone
/// moves links, and the second says what torque a motor needs.
///
/// ```
/// use linkside_core::dynamics::{ElasticDynamics, ElasticLayout};
///
/// let robot = linkside_core::demo::arm()?;
/// let layout = ElasticLayout::new(&robot, false);
/// let mut dynamics = ElasticDynamics::<f64>::new(&robot, &layout);
/// // (q, q̇, θ, θ̇): the spring is twisted by 0.01 rad and pulls link and motor together, 120 N m on 1.65 and 3 kg m².
/// dynamics.accelerate(&robot, &layout, &[0.0, 0.0, 0.01, 0.0], &[0.0]);
/// assert!((dynamics.ddq[0] - 120.0 / 1.65).abs() < 1e-9 && (dynamics.ddtheta[0] + 40.0).abs() < 1e-9);
/// # Ok::<(), linkside_core::error::RobotError>(())
/// ```
#[derive(Clone, Debug)]
pub struct ElasticDynamics<T = f64> {
    /// q̈ (n) [rad/s²].
    pub ddq: Vec<T>,
    /// θ̈ (n) [rad/s²]; q̈ where the joint is rigid.
    pub ddtheta: Vec<T>,
    /// ∂q̈/∂x, n × dense.
    pub ddq_by: Vec<T>,
    /// ∂θ̈/∂x, n × dense.
    pub ddtheta_by: Vec<T>,
    /// ∂q̈/∂τ, n × n.
    pub ddq_by_tau: Vec<T>,
    /// Of links, and of rotors behind them: after [`differentiate`](Self::differentiate) at its state, with the accelerations.
    pub kinematics: Kinematics<T>,
    /// Derivatives of the inverse dynamics of links and rotors.
    loads: Loads<T>,
    /// Inverse dynamics and mass matrix of links and rotors.
    newton_euler: NewtonEuler<T>,
    /// S, and the tree with rotors where there are any.
    coupling: Coupling<T>,
    /// Accelerations at which the load is taken: none.
    zero: Vec<T>,
    /// The state (dense) that the next three are at; NaN where there is none.
    at: Vec<T>,
    /// C q̇ + g of links and rotors [N m].
    load: Vec<T>,
    /// M of links and rotors, then L and D of what q̈ is solved with (n × n).
    mass: Vec<T>,
    /// A torque that comes with the derivatives, and is there already.
    moved: Vec<T>,
    /// Derivatives of the inverse dynamics by positions and by velocities (bodies × bodies).
    by_q: Vec<T>,
    by_dq: Vec<T>,
    /// A mass matrix that comes with the derivatives, and is there already.
    ignored: Vec<T>,
    /// τ_e (n) [N m]; behind a rigid drive its motor's torque less friction.
    spring: Vec<T>,
    /// 1 + ε′ (n): the motor feels the spring's torque times this.
    ratio: Vec<T>,
    /// How much more than a torque of the spring a motor has to give, and how much of it is left for the link (n): 1 + ε′ and 1
    /// where friction does not grow with load.
    felt: Vec<T>,
    left: Vec<T>,
    /// Motor torque less friction, and of a rotor less what its carrier's turning takes.
    drive: Vec<T>,
    /// How each friction element's rate depends on the state, after [`differentiate`](Self::differentiate).
    pub(crate) elements: Vec<ElementRow<T>>,
    /// Where motors' accelerations are states.
    prescribed: Option<Box<Prescribed<T>>>,
}

impl<T: Scalar> ElasticDynamics<T> {
    /// Room for `robot`.
    pub fn new(robot: &Robot, layout: &ElasticLayout) -> Self {
        let (n, d) = (robot.len(), layout.dense);
        let coupling = Coupling::new(robot);
        let tree = coupling.rotors.as_ref().map_or(&robot.tree, |rotors| &rotors.tree);
        let (kinematics, loads, bodies) = (Kinematics::new(tree), Loads::new(tree), tree.len());
        let room = |length: usize| vec![T::default(); length];
        let square = || room(bodies * bodies);
        Self {
            ddq: room(n),
            ddtheta: room(n),
            ddq_by: room(n * d),
            ddtheta_by: room(n * d),
            ddq_by_tau: room(n * n),
            kinematics,
            loads,
            newton_euler: NewtonEuler::new(tree),
            coupling,
            zero: room(bodies),
            at: vec![T::constant(f64::NAN); d],
            load: room(bodies),
            mass: square(),
            moved: room(bodies),
            by_q: square(),
            by_dq: square(),
            ignored: square(),
            spring: room(n),
            ratio: vec![T::constant(1.0); n],
            felt: vec![T::constant(1.0); n],
            left: vec![T::constant(1.0); n],
            drive: room(n),
            elements: layout.elements(robot).map(|(_, state, _)| ElementRow::at(state)).collect(),
            prescribed: layout.motor_acceleration.map(|first| Box::new(Prescribed::new(first, n, d))),
        }
    }

    /// Accelerations at state `x` (dense) under motor torques `tau` (n) [N m]; NaN when the inertia is not positive definite.
    /// Where motors' accelerations are states, `tau` is not looked at.
    pub fn accelerate(&mut self, robot: &Robot, layout: &ElasticLayout, x: &[T], tau: &[T]) {
        simd::phase(Accelerate { dynamics: self, robot, layout, x, tau });
    }

    /// Right-hand side and inertia of the reduced equation, its solution q̈, and θ̈ from the motors' rows.
    #[inline(always)]
    fn accelerate_here(&mut self, robot: &Robot, layout: &ElasticLayout, x: &[T], tau: &[T]) {
        let n = layout.joints;
        let system = n * n;
        // Of one state under several torques, loads and inertia are found once.
        if !self.is_at(robot, layout, x) {
            self.gather_loads(robot, layout, x);
            if self.prescribed.is_some() {
                self.prescribe_inertia(robot);
            } else {
                self.couple_inertia(robot);
            }
            // L D Lᵀ: the reduced inertia is symmetric, and positive definite unless the coupling is larger than masses can
            // make it.
            linear::factorise_joints(&mut self.mass[..system], n);
            self.at.copy_from_slice(x);
        }
        self.gather_torques(robot, layout, x, tau);
        if self.prescribed.is_some() {
            self.prescribe(robot, x);
        } else {
            self.couple_torques(robot);
        }
        linear::solve_joints(&self.mass[..system], &mut self.ddq);
        if self.prescribed.is_some() {
            self.take_prescribed(robot, x);
        } else {
            self.take_motors(robot);
        }
        if !linear::is_definite(&self.mass[..system], n) {
            // Of lanes perhaps one alone is lost.
            let pivots = self.mass[..system].iter().step_by(n + 1);
            let lost =
                pivots.fold(T::default(), |sum, pivot| sum + pivot.map(|p| if p > 0.0 { 0.0 } else { f64::NAN }));
            self.ddq.iter_mut().chain(&mut self.ddtheta).for_each(|x| *x += lost);
        }
    }

    /// Whether loads and inertia are those of state `x`.
    #[inline(always)]
    fn is_at(&self, robot: &Robot, layout: &ElasticLayout, x: &[T]) -> bool {
        let (at, moving) = (&self.at, 2 * layout.joints);
        let spins = |motor: usize| at[layout.dtheta[motor]] == x[layout.dtheta[motor]];
        at[..moving] == x[..moving]
            && robot.rotors.iter().all(|rotor| spins(rotor.motor))
            && layout.wrench.is_none_or(|first| at[first..] == x[first..])
    }

    /// M, S and C q̇ + g of links and rotors.
    #[inline(always)]
    fn gather_loads(&mut self, robot: &Robot, layout: &ElasticLayout, x: &[T]) {
        let n = layout.joints;
        let Self { newton_euler, load, mass, coupling, .. } = self;
        let (mut tree, mut q, mut dq) = (&robot.tree, &x[..n], &x[n..2 * n]);
        if let Some(rotors) = &mut coupling.rotors {
            rotors.position[..n].copy_from_slice(q);
            rotors.velocity[..n].copy_from_slice(dq);
            for (velocity, rotor) in rotors.velocity[n..].iter_mut().zip(&robot.rotors) {
                *velocity = x[layout.dtheta[rotor.motor]] * rotor.ratio;
            }
            (tree, q, dq) = (&rotors.tree, &rotors.position, &rotors.velocity);
        }
        // Inverse dynamics at no acceleration are C q̇ + g, of a rotor what its carrier's turning takes.
        if let Some(first) = layout.wrench {
            newton_euler.apply_wrenches(tree, &x[first..]);
        }
        newton_euler.set(tree, q, dq, &self.zero);
        newton_euler.inverse_dynamics_into(tree, load);
        newton_euler.mass_matrix_into(tree, mass);
        coupling.take(robot, mass);
    }

    /// Torques on motors, springs and links; what the rotors' rows have goes to their motors' torques.
    #[inline(always)]
    fn gather_torques(&mut self, robot: &Robot, layout: &ElasticLayout, x: &[T], tau: &[T]) {
        let n = layout.joints;
        let (q, dq) = (&x[..n], &x[n..2 * n]);
        self.drive.fill(T::default());
        for (&load, rotor) in self.load[n..].iter().zip(&robot.rotors) {
            self.drive[rotor.motor] = -(load * rotor.ratio);
        }
        for (j, drive) in robot.drives.iter().enumerate() {
            let speed = x[layout.dtheta[j]];
            let extra = layout.disturbance.map_or(T::default(), |first| x[first + j]);
            if self.prescribed.is_none() {
                self.drive[j] += tau[j] + extra;
            }
            if robot.gearing.as_ref().is_none_or(|gearing| !gearing.has(j)) {
                self.drive[j] -= drive.motor_friction(speed).0;
            }
            self.spring[j] = if drive.elastic {
                let gear = drive.ripple.output(x[layout.theta[j]]);
                (self.ratio[j], self.felt[j]) = (gear.ratio, gear.ratio);
                drive.spring_torque(gear.angle - q[j])
                    + (gear.ratio * speed - dq[j]) * drive.damping
                    + drive.hysteresis.force(&x[layout.deflections[j]..])
            } else if self.prescribed.is_some() {
                T::default()
            } else {
                self.drive[j]
            };
            self.ddq[j] = self.spring[j] - self.load[j] - drive.link_friction(dq[j]).0;
            if !drive.gear_loss.is_none() {
                let loss = drive.gear_loss.loss(speed, self.ratio[j] * self.spring[j]);
                self.drive[j] -= loss.torque;
                self.felt[j] += self.ratio[j] * loss.by_load;
            }
            if !drive.bearing_loss.is_none() {
                let loss = drive.bearing_loss.loss(dq[j], self.spring[j]);
                self.ddq[j] -= loss.torque;
                self.left[j] = -loss.by_load + 1.0;
            }
        }
        if let Some(first) = layout.link_disturbance {
            linear::add_scaled(&mut self.ddq, T::constant(1.0), &x[first..][..n]);
        }
        if let Some(gearing) = &robot.gearing {
            for motor in gearing.motors() {
                let friction = robot.drives[motor.drive].motor_friction(motor.speed(|j| x[layout.dtheta[j]])).0;
                for (j, by) in motor.joints() {
                    self.drive[j] -= friction * by;
                }
            }
        }
    }

    /// The least pivot of the last inertia matrix [kg m²]; not positive where the matrix is not positive definite.
    pub fn least_pivot(&self) -> T
    where
        T: PartialOrd,
    {
        let n = self.ddq.len();
        let pivots = self.mass[..n * n].iter().step_by(n + 1);
        pivots.copied().reduce(|a, b| if b < a { b } else { a }).unwrap_or_default()
    }

    /// The tree that [`kinematics`](Self::kinematics) is of: links, then rotors in the robot's order.
    #[inline(always)]
    pub(crate) fn tree<'a>(&'a self, robot: &'a Robot) -> &'a Tree {
        self.coupling.rotors.as_ref().map_or(&robot.tree, |rotors| &rotors.tree)
    }

    /// S of motor `j` and the links that it may couple to [kg m²], after [`accelerate`](Self::accelerate).
    #[inline(always)]
    pub(crate) fn coupling(&self, j: usize) -> impl Iterator<Item = (usize, T)> + '_ {
        self.coupling.links(j)
    }

    /// Friction of joint `j`'s motor and of its link at state `x`, with what of them grows with load [N m], after
    /// [`accelerate`](Self::accelerate).
    #[inline(always)]
    pub(crate) fn frictions(&self, robot: &Robot, layout: &ElasticLayout, x: &[T], j: usize) -> [T; 2] {
        let (drive, speed, dq) = (&robot.drives[j], x[layout.dtheta[j]], x[layout.joints + j]);
        let motor = drive.motor_friction(speed).0 + drive.gear_loss.loss(speed, self.ratio[j] * self.spring[j]).torque;
        [motor, drive.link_friction(dq).0 + drive.bearing_loss.loss(dq, self.spring[j]).torque]
    }

    /// What the transmission of joint `j` gives its link [N m], after [`accelerate`](Self::accelerate): the torque of
    /// spring and damper, behind a rigid drive what the motor leaves of its own.
    #[inline(always)]
    pub fn joint_torque(&self, robot: &Robot, j: usize) -> T {
        let drive = &robot.drives[j];
        if drive.elastic || self.prescribed.is_some() {
            return self.spring[j];
        }
        self.drive[j] - self.ddq[j] * drive.motor_inertia - self.coupling.pull(j, &self.ddq)
    }

    /// Inertia of joint `j`'s rigid drive's load [kg m²], after [`accelerate`](Self::accelerate).
    #[inline(always)]
    pub(crate) fn inertia(&self, robot: &Robot, j: usize) -> T {
        let n = robot.len();
        if let Some(prescribed) = &self.prescribed {
            let behind = if robot.drives[j].elastic { robot.drives[j].motor_inertia } else { 0.0 };
            return prescribed.mass[j * n + j] + -behind;
        }
        let entry = |i: usize, k: usize| self.mass[i * n + k];
        let before = (0..j).fold(T::default(), |sum, k| sum + entry(j, k) * entry(j, k) * entry(k, k));
        let own = self.coupling.links(j).filter(|(i, _)| *i == j).fold(T::default(), |_, (_, s)| s + s);
        before + entry(j, j) + -robot.drives[j].motor_inertia - own
    }

    /// ẋ, after [`accelerate`](Self::accelerate) at state `x`: `out` (dense) is overwritten; motors' disturbances stay.
    #[inline(always)]
    pub fn rate_into(&self, robot: &Robot, layout: &ElasticLayout, x: &[T], out: &mut [T]) {
        let n = layout.joints;
        out.fill(T::default());
        for j in 0..n {
            out[layout.theta[j]] = x[layout.dtheta[j]];
            out[layout.dtheta[j]] = self.ddtheta[j];
            out[j] = x[n + j];
            out[n + j] = self.ddq[j];
        }
        for (j, k, element) in layout.elements(robot) {
            out[k] = element_row(robot, layout, x, (j, k, element)).0;
        }
        if let Some(first) = layout.link_disturbance {
            linear::add_scaled(&mut out[first..][..n], T::constant(-layout.forgetting), &x[first..][..n]);
        }
    }
}

/// [`ElasticDynamics::accelerate`], to be compiled for each instruction set.
struct Accelerate<'a, T> {
    dynamics: &'a mut ElasticDynamics<T>,
    robot: &'a Robot,
    layout: &'a ElasticLayout,
    x: &'a [T],
    tau: &'a [T],
}

impl<T: Scalar> Kernel for Accelerate<'_, T> {
    type Output = ();
    const LANES: bool = T::LANES;

    #[inline(always)]
    fn run(self) {
        self.dynamics.accelerate_here(self.robot, self.layout, self.x, self.tau);
    }
}
