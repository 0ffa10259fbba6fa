//! Torques and matrices of the equations of motion, from composite moments gathered towards the base.

use super::{Kinematics, counterbalances, wrenches};
use crate::robot::Tree;
use crate::scalar::Scalar;
use crate::simd::{self, Kernel};
use crate::spatial::{Coriolis, Force, Inertia};

/// A body together with all that it carries.
#[derive(Clone, Copy, Debug, Default)]
struct Composite<T> {
    /// I of all of them, about the base origin: a plain sum there.
    inertia: Inertia<T>,
    /// B(I, v), with Ṗ = I a + B v of the momentum P.
    coriolis: Coriolis<T>,
    /// What moves them as they move.
    force: Force<T>,
}

/// Scratch for the equations of motion M(q) q̈ + C(q, q̇) q̇ + g(q) = τ of one robot, g less what counterbalances carry.
///
/// ```
/// use linkside_core::dynamics::{Kinematics, Loads};
///
/// let robot = linkside_core::demo::arm()?;
/// let (mut kinematics, mut loads) = (Kinematics::new(&robot.tree), Loads::new(&robot.tree));
/// kinematics.set(&robot.tree, &[0.3], &[1.0], &[2.0]);
/// let (mut tau, mut mass) = ([0.0], [0.0]);
/// loads.inverse_dynamics_into(&robot.tree, &kinematics, &mut tau);
/// loads.mass_matrix_into(&robot.tree, &kinematics, &mut mass);
/// // About the vertical: 0.4 kg m² about the centre and 5 kg half a metre out, no Coriolis force, no gravity.
/// assert!((mass[0] - 1.65).abs() < 1e-12 && (tau[0] - 2.0 * mass[0]).abs() < 1e-12);
/// # Ok::<(), linkside_core::error::RobotError>(())
/// ```
#[derive(Clone, Debug)]
pub struct Loads<T> {
    /// One a body, in the order of the tree.
    composites: Vec<Composite<T>>,
}

impl<T: Scalar> Loads<T> {
    /// Room for `tree`.
    pub fn new(tree: &Tree) -> Self {
        Self { composites: vec![Composite::default(); tree.bodies.len()] }
    }

    /// Inverse dynamics: τ (n) for the state of `k`, counterbalances and wrenches from outside included. Recursive Newton–Euler, O(n).
    #[inline(always)]
    pub fn inverse_dynamics_into(&mut self, tree: &Tree, k: &Kinematics<T>, tau: &mut [T]) {
        self.load_of_masses_into(tree, k, tau);
        counterbalances::load(k, tree, tau);
        if !k.wrenches.is_empty() {
            wrenches::load(k, tree, tau);
        }
    }

    /// The same of masses alone, in which it is linear.
    #[inline(always)]
    pub(crate) fn load_of_masses_into(&mut self, tree: &Tree, k: &Kinematics<T>, tau: &mut [T]) {
        tau.fill(T::default());
        for i in 0..tree.bodies.len() {
            let state = &k.bodies[i];
            let inertia = k.inertia(tree, i);
            // Newton and Euler: I a + v ×* I v, then summed from the leaves to the base.
            let inertial = inertia.apply(&state.acceleration);
            self.composites[i].force = inertial + state.velocity.cross_force(&inertia.apply(&state.velocity));
        }
        for i in (0..tree.bodies.len()).rev() {
            let force = self.composites[i].force;
            tau[tree.bodies[i].joint] += k.bodies[i].axis.dot(&force);
            if let Some(p) = tree.bodies[i].parent {
                self.composites[p].force += force;
            }
        }
    }

    /// Mass matrix M(q), n × n. Composite rigid bodies, O(n · depth).
    #[inline(always)]
    pub fn mass_matrix_into(&mut self, tree: &Tree, k: &Kinematics<T>, mass: &mut [T]) {
        let n = tree.len();
        mass.fill(T::default());
        for i in 0..tree.bodies.len() {
            self.composites[i].inertia = k.inertia(tree, i);
        }
        for j in (0..tree.bodies.len()).rev() {
            let inertia = self.composites[j].inertia;
            // Column j of M: the momentum that a unit velocity of joint j gives to all it carries, along the axes below
            // it.
            let momentum = inertia.apply(&k.bodies[j].axis);
            for i in tree.path(j) {
                let (a, b) = (tree.bodies[i].joint, tree.bodies[j].joint);
                let entry = k.bodies[i].axis.dot(&momentum);
                mass[a * n + b] += entry;
                if i != j {
                    mass[b * n + a] += entry;
                }
            }
            if let Some(p) = tree.bodies[j].parent {
                self.composites[p].inertia += inertia;
            }
        }
    }

    /// Coriolis matrix C(q, q̇), n × n, by Christoffel symbols of the first kind: Ṁ − 2C is skew, and C(q, u) w = C(q, w) u.
    ///
    /// Each entry pairs a joint's axis with the Coriolis operator of what the outer joint carries
    /// (Echeandia and Wensing 2021); ∂(C q̇)/∂q̇ = 2C. O(n · depth).
    #[inline(always)]
    pub fn coriolis_matrix_into(&mut self, tree: &Tree, k: &Kinematics<T>, coriolis: &mut [T]) {
        let n = tree.len();
        coriolis.fill(T::default());
        self.gather_start(tree, k);
        for j in (0..tree.bodies.len()).rev() {
            let composite = self.composites[j];
            let state = &k.bodies[j];
            let outer = composite.inertia.apply(&state.axis_rate) + composite.coriolis.apply(&state.axis);
            let momentum = composite.inertia.apply(&state.axis);
            let turning = composite.coriolis.apply_transposed(&state.axis);
            let b = tree.bodies[j].joint;
            for i in tree.path(j) {
                let a = tree.bodies[i].joint;
                let carrier = &k.bodies[i];
                if i != j {
                    coriolis[b * n + a] += carrier.axis_rate.dot(&momentum) + carrier.axis.angular.dot(&turning);
                }
                coriolis[a * n + b] += carrier.axis.dot(&outer);
            }
            self.gather(tree, j);
        }
    }

    /// τ with its derivatives ∂τ/∂q, ∂τ/∂q̇ and ∂τ/∂q̈ = M, the last three n × n, at the cost of about three τ.
    ///
    /// Singh, Russell and Wensing (2022), with all quantities in the base frame.
    #[inline]
    pub fn inverse_dynamics_derivatives_into(
        &mut self,
        tree: &Tree,
        k: &Kinematics<T>,
        tau: &mut [T],
        by_q: &mut [T],
        by_dq: &mut [T],
        mass: &mut [T],
    ) {
        simd::phase(Derivatives { loads: self, tree, k, tau, by_q, by_dq, mass });
    }

    /// Each body's own moments.
    #[inline(always)]
    fn gather_start(&mut self, tree: &Tree, k: &Kinematics<T>) {
        for i in 0..tree.bodies.len() {
            let state = &k.bodies[i];
            let inertia = k.inertia(tree, i);
            let coriolis = Coriolis::new(&inertia, &state.velocity);
            let force = inertia.apply(&state.acceleration) + coriolis.apply(&state.velocity);
            self.composites[i] = Composite { inertia, coriolis, force };
        }
    }

    /// Hands body `j`'s composite to its carrier.
    #[inline(always)]
    fn gather(&mut self, tree: &Tree, j: usize) {
        if let Some(p) = tree.bodies[j].parent {
            let Composite { inertia, coriolis, force } = self.composites[j];
            self.composites[p].inertia += inertia;
            self.composites[p].coriolis += coriolis;
            self.composites[p].force += force;
        }
    }
}

/// [`Loads::inverse_dynamics_derivatives_into`], to be compiled for each instruction set.
struct Derivatives<'a, T> {
    loads: &'a mut Loads<T>,
    tree: &'a Tree,
    k: &'a Kinematics<T>,
    tau: &'a mut [T],
    by_q: &'a mut [T],
    by_dq: &'a mut [T],
    mass: &'a mut [T],
}

impl<T: Scalar> Kernel for Derivatives<'_, T> {
    type Output = ();
    const LANES: bool = T::LANES;

    #[inline(always)]
    fn run(self) {
        let Self { loads, tree, k, tau, by_q, by_dq, mass } = self;
        let n = tree.len();
        for out in [&mut *tau, &mut *by_q, &mut *by_dq, &mut *mass] {
            out.fill(T::default());
        }
        loads.gather_start(tree, k);
        for j in (0..tree.bodies.len()).rev() {
            let Composite { inertia, coriolis, force } = loads.composites[j];
            let state = &k.bodies[j];
            let momentum = inertia.apply(&state.axis);
            let turning = coriolis.apply_transposed(&state.axis);
            let twice = |f: Force<T>| f + f;
            // ∂f/∂q_j and ∂f/∂q̇_j of the force on the composite: the axis turns what is carried, and is itself carried
            // along.
            let outer_q = state.axis.cross_force(&force)
                + inertia.apply(&state.axis_acceleration)
                + twice(coriolis.apply(&state.axis_rate));
            let outer_dq = twice(inertia.apply(&state.axis_rate) + coriolis.apply(&state.axis));
            let b = tree.bodies[j].joint;
            tau[b] += state.axis.dot(&force);
            for i in tree.path(j) {
                let a = tree.bodies[i].joint;
                let carrier = &k.bodies[i];
                let entry = carrier.axis.dot(&momentum);
                // Entries where the inner joint's torque depends on the outer joint's motion, and the other way round.
                by_q[a * n + b] += carrier.axis.dot(&outer_q);
                by_dq[a * n + b] += carrier.axis.dot(&outer_dq);
                mass[a * n + b] += entry;
                if i == j {
                    continue;
                }
                let (by_rate, by_axis) = (carrier.axis_rate.angular.dot(&turning), carrier.axis.angular.dot(&turning));
                by_q[b * n + a] += carrier.axis_acceleration.dot(&momentum) + by_rate + by_rate;
                let half = carrier.axis_rate.dot(&momentum) + by_axis;
                by_dq[b * n + a] += half + half;
                mass[b * n + a] += entry;
            }
            loads.gather(tree, j);
        }
        counterbalances::load(k, tree, tau);
        counterbalances::stiffen(k, tree, by_q);
        if !k.wrenches.is_empty() {
            wrenches::load(k, tree, tau);
            wrenches::stiffen(k, tree, by_q);
        }
    }
}
