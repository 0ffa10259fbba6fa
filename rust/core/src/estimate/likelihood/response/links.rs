//! The links' motion, step by step.

use super::equation::{Balance, Equation, MotorSample};
use super::motion::MotorMotion;
use crate::lu::Lu;
use crate::robot::Robot;

/// √3/6: Gauss's two nodes lie this far from the middle of a step.
const SPREAD: f64 = 0.288_675_134_594_812_9;
/// Shares of a step at which the equation of motion holds exactly.
const NODES: [f64; 2] = [0.5 - SPREAD, 0.5 + SPREAD];
/// Runge–Kutta's weights of the stages: q̇ at a node is q̇ + h Σ A q̈ (Hairer and Wanner 1996, table IV.5.1).
const STAGES: [[f64; 2]; 2] = [[0.25, 0.25 - SPREAD], [0.25 + SPREAD, 0.25]];
/// Newton's method is done when accelerations change by less than this share.
const CONVERGED: f64 = 1e-9;
/// It takes two or three; more than this, and the links fly away.
const ITERATIONS: usize = 25;

/// A², the weights of accelerations in positions at the nodes.
const fn squared() -> [[f64; 2]; 2] {
    let a = STAGES;
    let mut out = [[0.0; 2]; 2];
    let mut i = 0;
    while i < 2 {
        out[i][0] = a[i][0] * a[0][0] + a[i][1] * a[1][0];
        out[i][1] = a[i][0] * a[0][1] + a[i][1] * a[1][1];
        i += 1;
    }
    out
}

/// Weights of accelerations in positions at the nodes: A twice, as positions are integrals of velocities.
const POSITIONS: [[f64; 2]; 2] = squared();
/// Weights of accelerations in the position at the end of a step.
const LAST: [f64; 2] = [0.5 * (STAGES[0][0] + STAGES[1][0]), 0.5 * (STAGES[0][1] + STAGES[1][1])];

/// Links on their way, with the derivatives of their motion.
#[derive(Clone, Debug)]
pub(super) struct Links<'a> {
    pub(super) equation: Equation<'a>,
    /// q, q̇, q̈, and the derivatives of each (3n × width).
    pub(super) state: Vec<f64>,
    pub(super) slopes: Vec<f64>,
    pub(super) motors: MotorSample,
    /// Derivatives of each number: in p parameters, and in q and q̇ of the first sample (2n).
    width: usize,
    offset: &'a [f64],
    /// Motors, (q, q̇, q̈) and what is left of the equation at both nodes of the step.
    at_nodes: [MotorSample; 2],
    states: [Vec<f64>; 2],
    balances: [Balance; 2],
    /// Of M (n), and of both nodes' equations together (2n).
    one: Lu,
    both: Lu,
    /// q̈ at the nodes, with which the next step's iteration begins.
    accelerations: [Vec<f64>; 2],
    /// Scratch: a step of Newton's method, and the derivatives of the nodes' accelerations (2n × width).
    solution: Vec<f64>,
    columns: Vec<f64>,
}

impl<'a> Links<'a> {
    pub(super) fn new(equation: Equation<'a>, offset: &'a [f64]) -> Self {
        let n = equation.robot.len();
        let (p, width) = (equation.free.len(), equation.free.len() + 2 * n);
        Self {
            state: vec![0.0; 3 * n],
            slopes: vec![0.0; 3 * n * width],
            motors: MotorSample::new(n),
            width,
            offset,
            at_nodes: [MotorSample::new(n), MotorSample::new(n)],
            states: [vec![0.0; 3 * n], vec![0.0; 3 * n]],
            balances: [Balance::new(n, p), Balance::new(n, p)],
            one: Lu::new(n),
            both: Lu::new(2 * n),
            accelerations: [vec![0.0; n], vec![0.0; n]],
            solution: vec![0.0; 2 * n],
            columns: vec![0.0; 2 * n * width],
            equation,
        }
    }

    /// Joints with a spring.
    fn elastic(&self) -> impl Iterator<Item = usize> + use<'a> {
        let drives = &self.equation.robot.drives;
        (0..drives.len()).filter(move |&j| drives[j].elastic)
    }

    /// Where the springs hold the links, found by Newton's method, and the offset.
    pub(super) fn start(&mut self, motion: &MotorMotion) {
        let (n, width, p) = (self.motors.theta.len(), self.width, self.equation.free.len());
        motion.at(0, 0.0, &mut self.motors);
        let held = MotorSample { theta: self.motors.theta.clone(), ..MotorSample::new(n) };
        let mut at = vec![0.0; 3 * n];
        at[..n].copy_from_slice(&held.theta);
        let balance = &mut self.balances[0];
        for _ in 0..ITERATIONS {
            self.equation.balance(&held, &at, balance);
            let rigid = self.equation.robot.drives.iter().enumerate().filter(|(_, drive)| !drive.elastic);
            rigid.for_each(|(j, _)| balance.by_q[j * n + j] = 1.0);
            self.one.matrix.copy_from_slice(&balance.by_q);
            self.one.factorise();
            self.solution[..n].copy_from_slice(&balance.residual);
            self.one.solve(&mut self.solution[..n]);
            at[..n].iter_mut().zip(&self.solution).for_each(|(q, step)| *q -= step);
            if self.solution[..n].iter().all(|step| step.abs() < CONVERGED * 1e-3) {
                break;
            }
        }
        self.equation.balance(&held, &at, balance);
        self.equation.differentiate(&held, &at, balance);
        let columns = &mut self.columns[..n * width];
        columns.fill(0.0);
        for (row, by) in columns.chunks_exact_mut(width).zip(balance.by_parameter.chunks_exact(p.max(1))) {
            row[..p].iter_mut().zip(by).for_each(|(x, y)| *x = -y);
        }
        // The implicit function theorem at the equilibrium: ∂q/∂p = −(∂r/∂q)⁻¹ ∂r/∂p.
        self.one.solve_rows(columns, width);
        self.state[..n].copy_from_slice(&at[..n]);
        self.state[n..2 * n].copy_from_slice(&self.motors.dtheta);
        self.slopes[..n * width].copy_from_slice(columns);
        for j in self.elastic() {
            for (i, k) in [(j, j), (n + j, n + j)] {
                self.state[i] += self.offset[k];
                self.slopes[i * width + p + k] = 1.0;
            }
        }
    }

    /// The accelerations of sample `row`, where positions and velocities are known.
    pub(super) fn accelerate(&mut self, motion: &MotorMotion, row: usize) {
        let (n, width, p) = (self.motors.theta.len(), self.width, self.equation.free.len());
        let (from, c) = if row == 0 { (0, 0.0) } else { (row - 1, 1.0) };
        motion.at(from, c, &mut self.motors);
        let Self { equation, motors, state, balances: [balance, _], one, solution, slopes, .. } = self;
        follow(equation.robot, motors, state);
        let drives = &equation.robot.drives;
        equation.elements.advance(|j| drives[j].torsion_between(motors.theta[j], state[j]), slopes, row == 0);
        equation.balance(motors, state, balance);
        one.matrix.copy_from_slice(&balance.by_ddq);
        one.factorise();
        solution[..n].copy_from_slice(&balance.residual);
        one.solve(&mut solution[..n]);
        state[2 * n..].iter_mut().zip(solution).for_each(|(ddq, step)| *ddq -= *step);
        equation.balance(motors, state, balance);
        equation.differentiate(motors, state, balance);
        let (known, wanted) = slopes.split_at_mut(2 * n * width);
        for (i, out) in wanted.chunks_exact_mut(width).enumerate() {
            out.fill(0.0);
            out[..p].copy_from_slice(&balance.by_parameter[i * p..][..p]);
            equation.by_elements(i, motors, state, -1.0, out);
            for k in 0..n {
                let (q, dq) = (&known[k * width..][..width], &known[(n + k) * width..][..width]);
                let (a, b) = (balance.by_q[i * n + k], balance.by_dq[i * n + k]);
                out.iter_mut().zip(q).zip(dq).for_each(|((x, q), dq)| *x += a * q + b * dq);
            }
            out.iter_mut().for_each(|x| *x = -*x);
        }
        // ∂q̈/∂p = −M⁻¹ (∂r/∂p + ∂r/∂q ∂q/∂p + ∂r/∂q̇ ∂q̇/∂p), all columns at once.
        one.solve_rows(wanted, width);
    }

    /// From sample `row` to the next.
    pub(super) fn step(&mut self, motion: &MotorMotion, row: usize) {
        let n = self.motors.theta.len();
        let h = motion.t[row + 1] - motion.t[row];
        for (c, motors) in NODES.into_iter().zip(&mut self.at_nodes) {
            motion.at(row, c, motors);
        }
        self.equation.elements.still = false;
        let mut accelerations = core::mem::take(&mut self.accelerations);
        accelerations.iter_mut().for_each(|own| own.copy_from_slice(&self.state[2 * n..]));
        for _ in 0..ITERATIONS {
            self.assemble(h, &accelerations);
            for (i, balance) in self.balances.iter().enumerate() {
                self.solution[i * n..][..n].copy_from_slice(&balance.residual);
            }
            // Both nodes at once: Newton's method on the 2n accelerations, whose matrix holds h A and h² A² of the
            // stages.
            self.both.solve(&mut self.solution);
            let size = accelerations.iter().flatten().fold(1.0, |most: f64, x| most.max(x.abs()));
            let change = self.solution.iter().fold(0.0, |most: f64, x| most.max(x.abs()));
            for (own, step) in accelerations.iter_mut().flatten().zip(&self.solution) {
                *own -= step;
            }
            if change.is_nan() || change <= CONVERGED * size {
                break;
            }
        }
        self.differentiate(h);
        for j in 0..n {
            let [a, b] = [accelerations[0][j], accelerations[1][j]];
            self.state[j] += h * self.state[n + j] + h * h * (LAST[0] * a + LAST[1] * b);
            self.state[n + j] += 0.5 * h * (a + b);
        }
        self.accelerations = accelerations;
    }

    /// The balance at both nodes for given accelerations there, and its matrix in these, factorised.
    fn assemble(&mut self, h: f64, accelerations: &[Vec<f64>; 2]) {
        let n = self.motors.theta.len();
        for i in 0..2 {
            let at = &mut self.states[i];
            for j in 0..n {
                let [a, b] = [accelerations[0][j], accelerations[1][j]];
                let (q, dq) = (self.state[j], self.state[n + j]);
                at[j] = q + NODES[i] * h * dq + h * h * (POSITIONS[i][0] * a + POSITIONS[i][1] * b);
                at[n + j] = dq + h * (STAGES[i][0] * a + STAGES[i][1] * b);
                at[2 * n + j] = accelerations[i][j];
            }
            follow(self.equation.robot, &self.at_nodes[i], at);
            self.equation.balance(&self.at_nodes[i], at, &mut self.balances[i]);
            let Balance { by_q, by_dq, by_ddq, .. } = &self.balances[i];
            for r in 0..n {
                for s in 0..2 {
                    let out = &mut self.both.matrix[((i * n + r) * 2 + s) * n..][..n];
                    let own = f64::from(u8::from(i == s));
                    for (k, x) in out.iter_mut().enumerate() {
                        let e = r * n + k;
                        *x = own * by_ddq[e] + h * STAGES[i][s] * by_dq[e] + h * h * POSITIONS[i][s] * by_q[e];
                    }
                }
            }
        }
        self.both.factorise();
    }

    /// Derivatives at the end of a step from those at its beginning.
    fn differentiate(&mut self, h: f64) {
        let (n, width, p) = (self.motors.theta.len(), self.width, self.equation.free.len());
        let Self { equation, balances, states, at_nodes, columns, slopes, both, .. } = self;
        for (i, balance) in balances.iter_mut().enumerate() {
            // Masses' derivatives need the motion at this node.
            equation.motion.set_kinematics(equation.robot, &states[i]);
            equation.differentiate(&at_nodes[i], &states[i], balance);
            for (r, out) in columns[i * n * width..][..n * width].chunks_exact_mut(width).enumerate() {
                out.fill(0.0);
                out[..p].copy_from_slice(&balance.by_parameter[r * p..][..p]);
                equation.by_elements(r, &at_nodes[i], &states[i], -1.0, out);
                for k in 0..n {
                    let (q, dq) = (&slopes[k * width..][..width], &slopes[(n + k) * width..][..width]);
                    let a = balance.by_q[r * n + k];
                    let b = balance.by_dq[r * n + k] + NODES[i] * h * a;
                    out.iter_mut().zip(q).zip(dq).for_each(|((x, q), dq)| *x += a * q + b * dq);
                }
                out.iter_mut().for_each(|x| *x = -*x);
            }
        }
        both.solve_rows(columns, width);
        let (first, second) = columns.split_at(n * width);
        let (q, dq) = slopes[..2 * n * width].split_at_mut(n * width);
        for (((q, dq), a), b) in q.iter_mut().zip(dq).zip(first).zip(second) {
            *q += h * *dq + h * h * (LAST[0] * a + LAST[1] * b);
            *dq += 0.5 * h * (a + b);
        }
    }
}

/// Joints without a spring are where their motors are.
fn follow(robot: &Robot, motors: &MotorSample, state: &mut [f64]) {
    let n = robot.len();
    for (j, _) in robot.drives.iter().enumerate().filter(|(_, drive)| !drive.elastic) {
        (state[j], state[n + j], state[2 * n + j]) = (motors.theta[j], motors.dtheta[j], motors.ddtheta[j]);
    }
}
