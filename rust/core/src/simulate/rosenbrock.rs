//! One step of RODAS: a stiff robot is moved by solving linear equations, without iteration.

use super::plant::Plant;
use crate::linear::add_scaled;
use crate::lu::Lu;
use crate::robot::Robot;

/// γ, the diagonal.
const GAMMA: f64 = 0.25;
/// What of the stages before is where a stage looks; the last row is the solution that the error is taken from.
const REACH: [[f64; 5]; 6] = [
    [0.0; 5],
    [1.544, 0.0, 0.0, 0.0, 0.0],
    [0.9466785280815826, 0.2557011698983284, 0.0, 0.0, 0.0],
    [3.314825187068521, 2.896124015972201, 0.9986419139977817, 0.0, 0.0],
    [1.221224509226641, 6.019134481288629, 12.53708332932087, -0.687886036105895, 0.0],
    [1.221224509226641, 6.019134481288629, 12.53708332932087, -0.687886036105895, 1.0],
];
/// What of the stages before is in a stage's slope, times the step.
const SLOPE: [[f64; 5]; 6] = [
    [0.0; 5],
    [-5.6688, 0.0, 0.0, 0.0, 0.0],
    [-2.430093356833875, -0.2063599157091915, 0.0, 0.0, 0.0],
    [-0.1073529058151375, -9.594562251023355, -20.47028614809616, 0.0, 0.0],
    [7.496443313967647, -10.24680431464352, -33.99990352819905, 11.7089089320616, 0.0],
    [8.083246795921522, -7.981132988064893, -31.52159432874371, 16.31930543123136, -6.058818238834054],
];

/// RODAS of order 4 with an embedded solution of order 3, both L-stable (Hairer and Wanner 1996, section VI.4, in the
/// form of eq. (IV.7.25), coefficients of their program).
///
/// Of ẋ = f, half says that positions change by velocities: with s = 1/(γ h), a stage's positions follow from its
/// velocities, u_p = (r_p + u_v)/s, which are the solution of (s − V − P/s) u_v = r_v + P r_p/s, half the size. P and
/// V are the derivatives of accelerations by positions and velocities, those of the drives' friction included. A friction
/// element's deflection depends on motion and itself alone, u_z = (r_z + Z_p u_p + Z_v u_v)/(s − Z_z), and goes likewise.
#[derive(Clone, Debug)]
pub(super) struct Rosenbrock {
    /// Where in the state the position and the velocity of each degree of freedom are: links, then elastic motors.
    position: Vec<usize>,
    velocity: Vec<usize>,
    /// The degree of freedom that each number of the state is of.
    degree: Vec<usize>,
    /// The joint of each degree of freedom.
    joint: Vec<usize>,
    /// Where friction elements are.
    elements: Vec<usize>,
    /// Factors of s − V − P/s.
    lu: Lu,
    /// f where the step begins.
    start: Vec<f64>,
    /// u of each stage, and f or a stage's right-hand side.
    stages: [Vec<f64>; 6],
    rate: Vec<f64>,
    /// Right-hand side, then solution of the velocities' equations.
    half: Vec<f64>,
    /// The solution of order 4, after [`step`](Self::step).
    pub(super) end: Vec<f64>,
}

impl Rosenbrock {
    pub(super) fn new(plant: &Plant) -> Self {
        let layout = &plant.layout;
        let (n, d) = (layout.joints, layout.dense);
        let elastic: Vec<usize> = (0..n).filter(|&j| layout.theta[j] >= n).collect();
        let joint: Vec<usize> = (0..n).chain(elastic.iter().copied()).collect();
        let [start, rate, end] = core::array::from_fn(|_| vec![0.0; d]);
        let mut degree = vec![0; d];
        for (i, &j) in joint.iter().enumerate() {
            let motor = i >= n;
            degree[if motor { layout.theta[j] } else { j }] = i;
            degree[if motor { layout.dtheta[j] } else { n + j }] = i;
        }
        Self {
            degree,
            position: (0..n).chain(elastic.iter().map(|&j| layout.theta[j])).collect(),
            velocity: (n..2 * n).chain(elastic.iter().map(|&j| layout.dtheta[j])).collect(),
            elements: plant.dynamics.elements.iter().map(|element| element.state).collect(),
            lu: Lu::new(joint.len()),
            half: vec![0.0; joint.len()],
            joint,
            start,
            stages: core::array::from_fn(|_| vec![0.0; d]),
            rate,
            end,
        }
    }

    /// Learns f and its derivatives at `x`, from where [`step`](Self::step)s begin.
    #[inline(always)]
    pub(super) fn start(&mut self, robot: &Robot, plant: &mut Plant, x: &[f64], tau: &[f64]) {
        plant.linearise_into(robot, x, tau, &mut self.start);
    }

    /// Moves from `x` by `h` [s] to [`end`](Self::end), `tau` held.
    #[inline(always)]
    pub(super) fn step(&mut self, robot: &Robot, plant: &mut Plant, x: &[f64], tau: &[f64], h: f64) {
        let s = 1.0 / (GAMMA * h);
        self.factorise(plant, s);
        // Six stages, each one linear solution with the same factors (eq. (IV.7.25)): u_i of (1/(γ h) − J) u_i = f(x +
        // Σ a_ij u_j) + Σ (c_ij/h) u_j. The last stage is the error estimate, added it gives the solution of order 4.
        for (i, (reach, slope)) in REACH.into_iter().zip(SLOPE).enumerate() {
            self.end.copy_from_slice(x);
            for (stage, reach) in self.stages[..i].iter().zip(reach) {
                add_scaled(&mut self.end, reach, stage);
            }
            if i == 0 {
                self.rate.copy_from_slice(&self.start);
            } else {
                plant.rate_into(robot, &self.end, tau, &mut self.rate);
            }
            for (stage, slope) in self.stages[..i].iter().zip(slope) {
                add_scaled(&mut self.rate, slope / h, stage);
            }
            self.solve(plant, s, i);
        }
        add_scaled(&mut self.end, 1.0, &self.stages[5]);
    }

    /// By how much the embedded solution differs, over what is tolerated: root mean square over the state, and the
    /// joint where it is worst.
    #[inline(always)]
    pub(super) fn error(&self, x: &[f64], tolerated: impl Fn(f64) -> f64) -> (f64, usize) {
        let (mut sum, mut worst) = (0.0, (0.0, 0));
        for ((&p, &v), &joint) in self.position.iter().zip(&self.velocity).zip(&self.joint) {
            let square = |k: usize| {
                let ratio = self.stages[5][k] / tolerated(x[k].abs().max(self.end[k].abs()));
                ratio * ratio
            };
            let own = square(p) + square(v);
            sum += own;
            if own > worst.0 {
                worst = (own, joint);
            }
        }
        for &k in &self.elements {
            let ratio = self.stages[5][k] / tolerated(x[k].abs().max(self.end[k].abs()));
            sum += ratio * ratio;
        }
        ((sum / x.len() as f64).sqrt(), worst.1)
    }

    /// s − V − P/s.
    #[inline(always)]
    fn factorise(&mut self, plant: &Plant, s: f64) {
        let Self { position, velocity, joint, lu, degree, .. } = self;
        let m = joint.len();
        for (i, row) in lu.matrix.chunks_exact_mut(m).enumerate() {
            let by = derivatives(plant, joint, i);
            for ((value, &p), &v) in row.iter_mut().zip(&*position).zip(&*velocity) {
                *value = -by[v] - by[p] / s;
            }
            row[i] += s;
            for element in &plant.dynamics.elements {
                // θ, θ̇ and q̇ of the element's joint: θ follows from θ̇.
                let [theta, dtheta, dq, own] = element.entries;
                let share = by[element.state] / (s - own.1);
                for (k, entry) in [(theta.0, theta.1 / s), dtheta, dq] {
                    row[degree[k]] -= share * entry;
                }
            }
        }
        lu.factorise();
    }

    /// Stage `i` from its slope in `rate`.
    #[inline(always)]
    fn solve(&mut self, plant: &Plant, s: f64, i: usize) {
        let Self { position, velocity, joint, lu, stages, rate, half, .. } = self;
        for (k, (value, &v)) in half.iter_mut().zip(&*velocity).enumerate() {
            let by = derivatives(plant, joint, k);
            // r_v + P r_p/s: positions eliminated, half the size.
            let pull: f64 = position.iter().map(|&p| by[p] * rate[p]).sum();
            *value = rate[v] + pull / s;
            for element in &plant.dynamics.elements {
                let [theta, _, _, own] = element.entries;
                let left = rate[element.state] + theta.1 * rate[theta.0] / s;
                *value += by[element.state] * left / (s - own.1);
            }
        }
        lu.solve(half);
        for ((value, &p), &v) in half.iter().zip(&*position).zip(&*velocity) {
            stages[i][v] = *value;
            stages[i][p] = (rate[p] + value) / s;
        }
        for element in &plant.dynamics.elements {
            let [motion @ .., own] = element.entries;
            let driven: f64 = motion.iter().map(|(k, by)| by * stages[i][*k]).sum();
            stages[i][element.state] = (rate[element.state] + driven) / (s - own.1);
        }
    }
}

/// The derivatives of degree of freedom `i`'s acceleration by the state.
#[inline(always)]
fn derivatives<'a>(plant: &'a Plant, joint: &[usize], i: usize) -> &'a [f64] {
    let Plant { layout, dynamics } = plant;
    let rows = if i < layout.joints { &dynamics.ddq_by } else { &dynamics.ddtheta_by };
    &rows[joint[i] * layout.dense..][..layout.dense]
}
