//! Every kernel for any kind of number, its answers in vectors.

use super::trees::MOST;
use linkside_core::dynamics::{Kinematics, Loads, NewtonEuler};
use linkside_core::robot::{Frame, Tree};
use linkside_core::scalar::{Dual, Lanes, Scalar};
use linkside_core::spatial::Vec3;

/// Directions in which [`varied`] states differ: [`MOST`] for q, then as many for q̇ and for q̈.
pub(crate) const DIRECTIONS: usize = 3 * MOST;

/// Positions, velocities and accelerations of the joints.
#[derive(Clone, Debug)]
pub(crate) struct State<T> {
    pub(crate) q: Vec<T>,
    pub(crate) dq: Vec<T>,
    pub(crate) ddq: Vec<T>,
}

impl State<f64> {
    /// The state as it moves on: q, q̇ and q̈ with their rates, the last of which is taken to be zero.
    pub(crate) fn in_time(&self) -> State<Dual<1>> {
        let moving = |x: &[f64], rate: &[f64]| {
            x.iter().zip(rate).map(|(&value, &rate)| Dual { value, gradient: [rate] }).collect()
        };
        let still = vec![0.0; self.q.len()];
        State { q: moving(&self.q, &self.dq), dq: moving(&self.dq, &self.ddq), ddq: moving(&self.ddq, &still) }
    }

    /// The same position without motion.
    pub(crate) fn at_rest(&self) -> Self {
        let zero = vec![0.0; self.q.len()];
        Self { q: self.q.clone(), dq: zero.clone(), ddq: zero }
    }
}

/// The state with each of its entries an independent variable.
pub(crate) fn varied(state: &State<f64>) -> State<Dual<DIRECTIONS>> {
    let variables = |x: &[f64], first| x.iter().enumerate().map(|(i, &x)| Dual::variable(x, first + i)).collect();
    State { q: variables(&state.q, 0), dq: variables(&state.dq, MOST), ddq: variables(&state.ddq, 2 * MOST) }
}

/// Derivatives of `values` by q, q̇ and q̈ of a [`varied`] state of `n` joints; rows are values, row-major.
pub(crate) fn gradients(values: &[Dual<DIRECTIONS>], n: usize) -> [Vec<f64>; 3] {
    [0, MOST, 2 * MOST].map(|first| values.iter().flat_map(|v| v.gradient[first..first + n].to_vec()).collect())
}

/// As many states as there are lanes, side by side.
pub(crate) fn packed<const L: usize>(states: &[State<f64>]) -> State<Lanes<L>> {
    let pack = |signal: fn(&State<f64>) -> &Vec<f64>| {
        (0..signal(&states[0]).len()).map(|i| Lanes(core::array::from_fn(|lane| signal(&states[lane])[i]))).collect()
    };
    State { q: pack(|s| &s.q), dq: pack(|s| &s.dq), ddq: pack(|s| &s.ddq) }
}

/// `matrix · vector`, the matrix row-major.
pub(crate) fn multiply<T: Scalar>(matrix: &[T], vector: &[T]) -> Vec<T> {
    let row = |row: &[T]| row.iter().zip(vector).fold(T::default(), |sum, (&a, &b)| sum + a * b);
    matrix.chunks_exact(vector.len()).map(row).collect()
}

/// `matrixᵀ`, n × n.
pub(crate) fn transposed(matrix: &[f64], n: usize) -> Vec<f64> {
    (0..n * n).map(|i| matrix[i % n * n + i / n]).collect()
}

/// A robot's kernels in one state.
#[derive(Clone, Debug)]
pub(crate) struct Kernels<'a, T> {
    tree: &'a Tree,
    kinematics: Kinematics<T>,
    loads: Loads<T>,
    newton_euler: NewtonEuler<T>,
}

impl<'a, T: Scalar> Kernels<'a, T> {
    pub(crate) fn new(tree: &'a Tree, state: &State<T>) -> Self {
        let mut kernels = Self {
            tree,
            kinematics: Kinematics::new(tree),
            loads: Loads::new(tree),
            newton_euler: NewtonEuler::new(tree),
        };
        kernels.set(state);
        kernels
    }

    pub(crate) fn set(&mut self, state: &State<T>) {
        self.kinematics.set(self.tree, &state.q, &state.dq, &state.ddq);
        self.newton_euler.set(self.tree, &state.q, &state.dq, &state.ddq);
    }

    /// Room for an answer that must be overwritten.
    fn blank(&self, entries: usize) -> Vec<T> {
        vec![T::constant(f64::NAN); entries]
    }

    /// τ.
    pub(crate) fn torque(&mut self) -> Vec<T> {
        let mut tau = self.blank(self.tree.len());
        self.loads.inverse_dynamics_into(self.tree, &self.kinematics, &mut tau);
        tau
    }

    /// M, computed in the bodies' own axes.
    pub(crate) fn mass_in_own_axes(&mut self) -> Vec<T> {
        let mut mass = self.blank(self.tree.len().pow(2));
        self.newton_euler.mass_matrix_into(self.tree, &mut mass);
        mass
    }

    /// τ, position, specific force and angular rate of a frame, computed in the bodies' own axes.
    pub(crate) fn in_own_axes(&mut self, frame: &Frame) -> Vec<T> {
        let mut out = self.blank(self.tree.len());
        self.newton_euler.inverse_dynamics_into(self.tree, &mut out);
        out.extend(self.newton_euler.position(self.tree, frame).0);
        out.extend(self.newton_euler.specific_force(frame).0);
        out.extend(self.newton_euler.angular_rate(frame).0);
        out
    }

    /// M.
    pub(crate) fn mass(&mut self) -> Vec<T> {
        let mut mass = self.blank(self.tree.len().pow(2));
        self.loads.mass_matrix_into(self.tree, &self.kinematics, &mut mass);
        mass
    }

    /// C.
    pub(crate) fn coriolis(&mut self) -> Vec<T> {
        let mut coriolis = self.blank(self.tree.len().pow(2));
        self.loads.coriolis_matrix_into(self.tree, &self.kinematics, &mut coriolis);
        coriolis
    }

    /// τ, and its derivatives by q, q̇ and q̈.
    pub(crate) fn torque_derivatives(&mut self) -> (Vec<T>, [Vec<T>; 3]) {
        let (mut tau, size) = (self.blank(self.tree.len()), self.tree.len().pow(2));
        let [mut by_q, mut by_dq, mut mass] = [(); 3].map(|()| self.blank(size));
        let (tree, k) = (self.tree, &self.kinematics);
        self.loads.inverse_dynamics_derivatives_into(tree, k, &mut tau, &mut by_q, &mut by_dq, &mut mass);
        (tau, [by_q, by_dq, mass])
    }

    /// Position, specific force and angular rate of a frame.
    pub(crate) fn sensed(&self, frame: &Frame) -> [Vec3<T>; 3] {
        let k = &self.kinematics;
        [k.position(frame), k.specific_force(frame), k.angular_rate(frame)]
    }

    /// ∂position/∂q, 3 × n.
    pub(crate) fn position_jacobian(&self, frame: &Frame) -> Vec<T> {
        let mut columns = Columns::new(self.tree);
        self.kinematics.position_jacobian(self.tree, frame, |joint, v| columns.put(joint, [v]));
        let [by_q] = columns.0;
        by_q
    }

    /// Derivatives of the specific force by q, q̇ and q̈, each 3 × n.
    pub(crate) fn force_derivatives(&self, frame: &Frame) -> [Vec<T>; 3] {
        let mut columns = Columns::new(self.tree);
        self.kinematics.specific_force_derivatives(self.tree, frame, |joint, v| columns.put(joint, v));
        columns.0
    }

    /// T_A, 3 × n.
    pub(crate) fn acceleration_map(&self, frame: &Frame) -> Vec<T> {
        let mut columns = Columns::new(self.tree);
        self.kinematics.acceleration_map(self.tree, frame, |joint, v| columns.put(joint, [v]));
        let [map] = columns.0;
        map
    }

    /// Derivatives of the angular rate by q and q̇, each 3 × n.
    pub(crate) fn rate_derivatives(&self, frame: &Frame) -> [Vec<T>; 2] {
        let mut columns = Columns::new(self.tree);
        self.kinematics.angular_rate_derivatives(self.tree, frame, |joint, v| columns.put(joint, v));
        columns.0
    }

    /// What every kernel answers, one after the other.
    pub(crate) fn everything(&mut self, frame: &Frame) -> Vec<T> {
        let (tau, derivatives) = self.torque_derivatives();
        let parts = [
            vec![tau, self.torque(), self.mass(), self.mass_in_own_axes(), self.coriolis()],
            derivatives.to_vec(),
            self.sensed(frame).map(|v| v.0.to_vec()).to_vec(),
            vec![self.in_own_axes(frame), self.position_jacobian(frame), self.acceleration_map(frame)],
            self.force_derivatives(frame).to_vec(),
            self.rate_derivatives(frame).to_vec(),
        ];
        parts.concat().concat()
    }
}

/// `N` matrices of 3 × n, row-major, filled by columns.
struct Columns<T, const N: usize>([Vec<T>; N]);

impl<T: Scalar, const N: usize> Columns<T, N> {
    fn new(tree: &Tree) -> Self {
        Self([(); N].map(|()| vec![T::default(); 3 * tree.len()]))
    }

    fn put(&mut self, joint: usize, columns: [Vec3<T>; N]) {
        for (matrix, column) in self.0.iter_mut().zip(columns) {
            let n = matrix.len() / 3;
            for (row, entry) in column.0.into_iter().enumerate() {
                matrix[row * n + joint] = entry;
            }
        }
    }
}
