//! Dynamics of links and motors with springs between them.
//!
//! | joint | coordinates | equations |
//! | --- | --- | --- |
//! | elastic | q, θ | one of the link, one of the motor |
//! | rigid (`Drive::elastic` false) | q | one: the motor turns with the link, its inertia and friction join the link's |
//!
//! Arrays always have one entry a joint. Of a rigid joint θ and θ̇ are not read, derivatives by them are zero, θ̈ is q̈.

use super::{Kinematics, Loads};
use crate::linear::{factorise, solve};
use crate::robot::{Robot, Tree};
use crate::scalar::Scalar;

/// State of links and motors, one entry a joint.
#[derive(Clone, Copy, Debug)]
pub struct ElasticState<'a, T> {
    /// q.
    pub q: &'a [T],
    /// q̇.
    pub dq: &'a [T],
    /// θ.
    pub theta: &'a [T],
    /// θ̇.
    pub dtheta: &'a [T],
}

/// Derivatives of the accelerations; each matrix has the n rows of q̈, then the n rows of θ̈, and n columns.
#[derive(Clone, Debug, PartialEq)]
pub struct ElasticJacobian<T> {
    /// By q.
    pub by_q: Vec<T>,
    /// By q̇.
    pub by_dq: Vec<T>,
    /// By θ.
    pub by_theta: Vec<T>,
    /// By θ̇.
    pub by_dtheta: Vec<T>,
    /// By τ.
    pub by_tau: Vec<T>,
}

impl<T: Scalar> ElasticJacobian<T> {
    /// Room for `joints` joints.
    pub fn new(joints: usize) -> Self {
        let matrix = || vec![T::default(); 2 * joints * joints];
        Self { by_q: matrix(), by_dq: matrix(), by_theta: matrix(), by_dtheta: matrix(), by_tau: matrix() }
    }
}

/// Forward dynamics of an elastic-joint robot.
///
/// De Luca, Schröder and Thümmel (2007), eq. (2), with nonlinear springs and friction (Ulrich and Sasiadek 2011,
/// eqs. (10)–(16)):
///
/// ```text
/// M q̈ + S θ̈ + C q̇ + g + d(q̇) = τ_e(θ − q, θ̇ − q̇)
/// Sᵀ q̈ + B θ̈ + f(θ̇)          = τ − τ_e
/// ```
///
/// Motors that are [`Rotor`](crate::robot::Rotor)s on links are bodies of an extended tree, whence S(q), its velocity
/// terms and their derivatives. Both rows are solved at once. Nothing allocates after construction.
#[derive(Clone, Debug)]
pub struct ForwardDynamics<T> {
    tree: Tree,
    /// Links, then rotors: the coordinate that each follows, how many times as fast.
    followed: Vec<(usize, f64)>,
    /// The coordinate of each motor: its own behind a spring, its link's otherwise.
    motor: Vec<usize>,
    /// Inertia that does not depend on the posture.
    constant: Vec<f64>,
    coordinates: usize,
    kinematics: Kinematics<T>,
    loads: Loads<T>,
    position: Vec<T>,
    velocity: Vec<T>,
    acceleration: Vec<T>,
    load: Vec<T>,
    mass: Vec<T>,
    inertia: Vec<T>,
    solution: Vec<T>,
    by_position: Vec<T>,
    by_velocity: Vec<T>,
    columns: Vec<T>,
}

impl<T: Scalar> ForwardDynamics<T> {
    /// Scratch for `robot`.
    pub fn new(robot: &Robot) -> Self {
        let (n, tree) = (robot.len(), robot.tree.with_rotors(&robot.rotors, &robot.drives));
        let mut coordinates = n;
        let motor: Vec<usize> = robot
            .drives
            .iter()
            .enumerate()
            .map(|(j, drive)| {
                coordinates += usize::from(drive.elastic);
                if drive.elastic { coordinates - 1 } else { j }
            })
            .collect();
        let rotors = robot.rotors.iter().map(|rotor| (motor[rotor.motor], rotor.ratio));
        let followed = (0..n).map(|i| (i, 1.0)).chain(rotors).collect();
        let bodies = tree.len();
        let vector = |length: usize| vec![T::default(); length];
        Self {
            constant: constant_inertia(robot, &motor, coordinates),
            kinematics: Kinematics::new(&tree),
            loads: Loads::new(&tree),
            position: vector(bodies),
            velocity: vector(bodies),
            acceleration: vector(bodies),
            load: vector(bodies),
            mass: vector(bodies * bodies),
            by_position: vector(bodies * bodies),
            by_velocity: vector(bodies * bodies),
            inertia: vector(coordinates * coordinates),
            solution: vector(coordinates),
            columns: vector(coordinates * 5 * n),
            tree,
            followed,
            motor,
            coordinates,
        }
    }

    /// q̈ and θ̈ (n each) under motor torques `tau` (n).
    #[inline(always)]
    pub fn accelerations_into(
        &mut self,
        robot: &Robot,
        state: ElasticState<'_, T>,
        tau: &[T],
        ddq: &mut [T],
        ddtheta: &mut [T],
    ) {
        self.set_links(state.q, state.dq);
        self.set_rotors(robot, state);
        self.acceleration.fill(T::default());
        self.kinematics.set_motion(&self.tree, &self.position, &self.velocity, &self.acceleration);
        self.loads.inverse_dynamics_into(&self.tree, &self.kinematics, &mut self.load);
        self.loads.mass_matrix_into(&self.tree, &self.kinematics, &mut self.mass);
        self.gather_inertia();
        self.gather_torques(robot, state, tau);
        factorise(&mut self.inertia, self.coordinates);
        solve(&self.inertia, self.coordinates, &mut self.solution, 1);
        for (j, &motor) in self.motor.iter().enumerate() {
            ddq[j] = self.solution[j];
            ddtheta[j] = self.solution[motor];
        }
    }

    /// As [`accelerations_into`](Self::accelerations_into), with exact derivatives.
    #[inline(always)]
    pub fn jacobian_into(
        &mut self,
        robot: &Robot,
        state: ElasticState<'_, T>,
        tau: &[T],
        ddq: &mut [T],
        ddtheta: &mut [T],
        jacobian: &mut ElasticJacobian<T>,
    ) {
        self.accelerations_into(robot, state, tau, ddq, ddtheta);
        let n = ddq.len();
        self.acceleration[..n].copy_from_slice(ddq);
        for (i, &(coordinate, ratio)) in self.followed.iter().enumerate().skip(n) {
            self.acceleration[i] = self.solution[coordinate] * ratio;
        }
        self.kinematics.set(&self.tree, &self.position, &self.velocity, &self.acceleration);
        let Self { tree, kinematics, loads, load, by_position, by_velocity, mass, .. } = self;
        loads.inverse_dynamics_derivatives_into(tree, kinematics, load, by_position, by_velocity, mass);
        self.columns.fill(T::default());
        self.differentiate_loads(robot);
        self.differentiate_drives(robot, state);
        solve(&self.inertia, self.coordinates, &mut self.columns, 5 * n);
        self.scatter(jacobian, n);
    }

    /// The least pivot of the last inertia matrix [kg m²]; not positive where the matrix is not positive definite.
    pub fn least_pivot(&self) -> T
    where
        T: PartialOrd,
    {
        let pivots = self.inertia.iter().step_by(self.coordinates + 1);
        pivots.copied().reduce(|a, b| if b < a { b } else { a }).unwrap_or_default()
    }

    /// Links' positions and velocities. A rotor is round: its angle matters to nothing.
    #[inline(always)]
    fn set_links(&mut self, q: &[T], dq: &[T]) {
        self.position[..q.len()].copy_from_slice(q);
        self.velocity[..dq.len()].copy_from_slice(dq);
    }

    #[inline(always)]
    fn set_rotors(&mut self, robot: &Robot, state: ElasticState<'_, T>) {
        let n = robot.len();
        for (velocity, rotor) in self.velocity[n..].iter_mut().zip(&robot.rotors) {
            let speeds = if robot.drives[rotor.motor].elastic { state.dtheta } else { state.dq };
            *velocity = speeds[rotor.motor] * rotor.ratio;
        }
    }

    #[inline(always)]
    fn gather_inertia(&mut self) {
        let (size, bodies) = (self.coordinates, self.followed.len());
        for (entry, &value) in self.inertia.iter_mut().zip(&self.constant) {
            *entry = T::constant(value);
        }
        for (i, &(row, a)) in self.followed.iter().enumerate() {
            for (j, &(column, b)) in self.followed.iter().enumerate() {
                self.inertia[row * size + column] += self.mass[i * bodies + j] * (a * b);
            }
        }
    }

    #[inline(always)]
    fn gather_torques(&mut self, robot: &Robot, state: ElasticState<'_, T>, tau: &[T]) {
        self.solution.fill(T::default());
        for (&(coordinate, ratio), &load) in self.followed.iter().zip(&self.load) {
            self.solution[coordinate] -= load * ratio;
        }
        for (j, drive) in robot.drives.iter().enumerate() {
            let (motor, dq) = (self.motor[j], state.dq[j]);
            let speed = if drive.elastic { state.dtheta[j] } else { dq };
            self.solution[j] -= drive.link_friction(dq).0;
            self.solution[motor] += tau[j] - drive.motor_friction(speed).0;
            if drive.elastic {
                let torque = drive.spring_torque(state.theta[j] - state.q[j]) + (speed - dq) * drive.damping;
                self.solution[j] += torque;
                self.solution[motor] -= torque;
            }
        }
    }

    /// Minus ∂(M q̈ + C q̇ + g)/∂(q, q̇, θ̇).
    #[inline(always)]
    fn differentiate_loads(&mut self, robot: &Robot) {
        let n = robot.len();
        let (width, bodies) = (5 * n, self.followed.len());
        for (i, &(row, a)) in self.followed.iter().enumerate() {
            for (j, &(coordinate, b)) in self.followed.iter().enumerate() {
                let (by_position, by_velocity) = (self.by_position[i * bodies + j], self.by_velocity[i * bodies + j]);
                if j < n {
                    self.columns[row * width + j] -= by_position * a;
                }
                // Links and rigid motors turn by q̇, the others by θ̇.
                let column = if coordinate < n { n + coordinate } else { 3 * n + robot.rotors[j - n].motor };
                self.columns[row * width + column] -= by_velocity * (a * b);
            }
        }
    }

    /// Derivatives of springs and friction, and of the torques by themselves.
    #[inline(always)]
    fn differentiate_drives(&mut self, robot: &Robot, state: ElasticState<'_, T>) {
        let n = robot.len();
        let width = 5 * n;
        for (j, drive) in robot.drives.iter().enumerate() {
            let (link, motor) = (j * width, self.motor[j] * width);
            let (q, dq, theta, dtheta, tau) = (j, n + j, 2 * n + j, 3 * n + j, 4 * n + j);
            self.columns[link + dq] -= drive.link_friction(state.dq[j]).1;
            self.columns[motor + tau] += T::constant(1.0);
            if !drive.elastic {
                self.columns[link + dq] -= drive.motor_friction(state.dq[j]).1;
                continue;
            }
            self.columns[motor + dtheta] -= drive.motor_friction(state.dtheta[j]).1;
            let stiffness = drive.tangent_stiffness(state.theta[j] - state.q[j]);
            for (plus, minus, slope) in [(theta, q, stiffness), (dtheta, dq, T::constant(drive.damping))] {
                self.columns[link + plus] += slope;
                self.columns[link + minus] -= slope;
                self.columns[motor + plus] -= slope;
                self.columns[motor + minus] += slope;
            }
        }
    }

    #[inline(always)]
    fn scatter(&self, jacobian: &mut ElasticJacobian<T>, n: usize) {
        let ElasticJacobian { by_q, by_dq, by_theta, by_dtheta, by_tau } = jacobian;
        for (block, out) in [by_q, by_dq, by_theta, by_dtheta, by_tau].into_iter().enumerate() {
            for (i, row) in out.chunks_exact_mut(n).enumerate() {
                let coordinate = if i < n { i } else { self.motor[i - n] };
                row.copy_from_slice(&self.columns[(coordinate * 5 + block) * n..][..n]);
            }
        }
    }
}

/// B of motors that are not rotors on links, and S, in the coordinates of links and motors.
fn constant_inertia(robot: &Robot, motor: &[usize], coordinates: usize) -> Vec<f64> {
    let (n, mut inertia) = (robot.len(), vec![0.0; coordinates * coordinates]);
    for (j, drive) in robot.drives.iter().enumerate() {
        if !robot.rotors.iter().any(|rotor| rotor.motor == j) {
            inertia[motor[j] * coordinates + motor[j]] += drive.motor_inertia;
        }
        for i in 0..j {
            inertia[i * coordinates + motor[j]] += robot.coupling[i * n + j];
            inertia[motor[j] * coordinates + i] += robot.coupling[i * n + j];
        }
    }
    inertia
}
