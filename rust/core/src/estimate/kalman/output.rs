//! What a filter or a smoother gives back.

use super::correction::Correction;
use super::findings::Finding;
use super::model::Model;
use crate::dynamics::Kinematics;
use crate::error::DesignError;
use crate::memory::filled;
use crate::robot::Robot;
use crate::simd::{self, Kernel};

/// What to keep of each sample beyond the estimate.
#[derive(Clone, Copy, Debug, Default)]
pub struct Keep {
    /// The whole state and its covariance.
    pub covariance: bool,
    /// Innovations, and their standard deviations.
    pub innovations: bool,
}

/// Estimates of a recording, row-major, one row a sample.
///
/// What was not asked for, or does not exist, is empty: the tool of a robot that has none, innovations without
/// [`Keep::innovations`].
#[derive(Clone, Debug, Default)]
pub struct FilterOutput {
    /// Link positions (n).
    pub q: Vec<f64>,
    /// Link velocities (n).
    pub dq: Vec<f64>,
    /// Link accelerations (n).
    pub ddq: Vec<f64>,
    /// Motor positions (n).
    pub theta: Vec<f64>,
    /// Motor velocities (n).
    pub dtheta: Vec<f64>,
    /// Standard deviations of link positions (n).
    pub q_std: Vec<f64>,
    /// Disturbance torques of the links (n); empty where the model has none.
    pub disturbance: Vec<f64>,
    /// Their standard deviations (n).
    pub disturbance_std: Vec<f64>,
    /// Numbers of varying wrenches from outside (6 each) [N, N m]; empty where there are none.
    pub wrench: Vec<f64>,
    /// Their standard deviations.
    pub wrench_std: Vec<f64>,
    /// Tool centre point (3); empty when the robot has none.
    pub tool: Vec<f64>,
    /// Its standard deviations (3).
    pub tool_std: Vec<f64>,
    /// See [`Status`](crate::estimate::Status).
    pub status: Vec<u8>,
    /// Normalised innovation squared; its mean should be the number of readings used.
    pub nis: Vec<f64>,
    /// Readings used.
    pub used: Vec<u32>,
    /// Logarithm of the readings' probability density.
    pub log_likelihood: Vec<f64>,
    /// The whole state (states), when kept.
    pub state: Vec<f64>,
    /// Its covariance (states × states), when kept.
    pub covariance: Vec<f64>,
    /// Contradictions found since the recording's start.
    pub findings: Vec<Finding>,
    /// Reading less prediction (channels), when kept.
    pub innovation: Vec<f64>,
    /// Its standard deviation (channels), when kept.
    pub innovation_std: Vec<f64>,
}

/// States from `first` on, and their standard deviations.
#[inline(always)]
fn write_states(
    mean: &mut [f64],
    std: &mut [f64],
    first: usize,
    state: &[f64],
    covariance: impl Fn(usize, usize) -> f64,
) {
    mean.copy_from_slice(&state[first..][..mean.len()]);
    for (j, std) in std.iter_mut().enumerate() {
        *std = covariance(first + j, first + j).max(0.0).sqrt();
    }
}

impl FilterOutput {
    /// Room for `count` samples.
    ///
    /// # Errors
    /// [`DesignError::Memory`].
    pub fn zeros(count: usize, model: &impl Model, keep: Keep) -> Result<Self, DesignError> {
        let (n, m, states) = (model.robot().len(), model.channels(), model.states());
        let rows = |width: usize| filled(0.0, count, width);
        let tool = if model.robot().tool.is_some() { 3 } else { 0 };
        let innovations = if keep.innovations { m } else { 0 };
        let disturbed = if model.link_disturbance().is_some() { n } else { 0 };
        let wrenches = if model.wrench().is_some() { model.robot().wrench_states() } else { 0 };
        let states = if keep.covariance { states } else { 0 };
        Ok(Self {
            q: rows(n)?,
            dq: rows(n)?,
            ddq: rows(n)?,
            theta: rows(n)?,
            dtheta: rows(n)?,
            q_std: rows(n)?,
            disturbance: rows(disturbed)?,
            disturbance_std: rows(disturbed)?,
            wrench: rows(wrenches)?,
            wrench_std: rows(wrenches)?,
            tool: rows(tool)?,
            tool_std: rows(tool)?,
            status: filled(0, count, 1)?,
            nis: rows(1)?,
            used: filled(0, count, 1)?,
            log_likelihood: rows(1)?,
            state: rows(states)?,
            covariance: rows(states * states)?,
            findings: Vec::new(),
            innovation: rows(innovations)?,
            innovation_std: rows(innovations)?,
        })
    }

    /// How well sample `i` fitted.
    #[inline(always)]
    pub(super) fn write_fit(&mut self, i: usize, correction: &Correction) {
        self.status[i] = correction.status;
        self.nis[i] = correction.nis;
        self.used[i] = correction.used;
        self.log_likelihood[i] = correction.log_likelihood;
    }

    /// The tool at sample `i`, and the standard deviations of links and tool.
    #[inline(always)]
    pub(crate) fn write_links(
        &mut self,
        i: usize,
        robot: &Robot,
        state: &[f64],
        covariance: impl Fn(usize, usize) -> f64,
        tool: &mut Tool,
    ) {
        let n = robot.len();
        for j in 0..n {
            self.q_std[i * n + j] = deviation(covariance(j, j));
        }
        if let Some(position) = tool.set(robot, &state[..n]) {
            self.tool[i * 3..][..3].copy_from_slice(&position);
            for (std, row) in self.tool_std[i * 3..][..3].iter_mut().zip(tool.jacobian.chunks_exact(n)) {
                // σ² = J P Jᵀ of each coordinate, by the exact Jacobian at the estimate.
                let mut variance = 0.0;
                for r in 0..n {
                    for c in 0..n {
                        variance += row[r] * covariance(r, c) * row[c];
                    }
                }
                *std = deviation(variance);
            }
        }
    }

    /// The links' disturbance torques at sample `i`, which are in the state from `first` on, and their deviations.
    #[inline(always)]
    pub(super) fn write_disturbances(
        &mut self,
        i: usize,
        (first, n): (usize, usize),
        state: &[f64],
        covariance: impl Fn(usize, usize) -> f64,
    ) {
        let row = i * n..(i + 1) * n;
        write_states(&mut self.disturbance[row.clone()], &mut self.disturbance_std[row], first, state, covariance);
    }

    /// The same of `n` numbers of varying wrenches.
    #[inline(always)]
    pub(super) fn write_wrenches(
        &mut self,
        i: usize,
        (first, n): (usize, usize),
        state: &[f64],
        covariance: impl Fn(usize, usize) -> f64,
    ) {
        let row = i * n..(i + 1) * n;
        write_states(&mut self.wrench[row.clone()], &mut self.wrench_std[row], first, state, covariance);
    }

    /// The whole state of sample `i`, and its covariance, rows of which are `stride` apart in `covariance`.
    #[inline(always)]
    pub(crate) fn write_state(&mut self, i: usize, state: &[f64], covariance: &[f64], stride: usize) {
        let states = state.len();
        self.state[i * states..][..states].copy_from_slice(state);
        let out = &mut self.covariance[i * states * states..][..states * states];
        for (out, row) in out.chunks_exact_mut(states).zip(covariance.chunks_exact(stride)) {
            out.copy_from_slice(&row[..states]);
        }
    }

    /// Adds to the covariance of sample `i`.
    #[inline(always)]
    pub(crate) fn add_covariance(&mut self, i: usize, more: &[f64]) {
        crate::linear::add_scaled(&mut self.covariance[i * more.len()..][..more.len()], 1.0, more);
    }

    /// This stretch and the one after it.
    ///
    /// # Errors
    /// [`DesignError::Memory`].
    pub(super) fn followed_by(mut self, mut later: Self) -> Result<Self, DesignError> {
        for (mine, others) in self.signals().into_iter().zip(later.signals()) {
            let bytes = 8.0 * (mine.len() + others.len()) as f64;
            mine.try_reserve(others.len()).map_err(|_| DesignError::Memory { bytes })?;
            mine.append(others);
        }
        self.status.append(&mut later.status);
        self.used.append(&mut later.used);
        self.findings = later.findings;
        Ok(self)
    }

    /// All signals of numbers, row by row; taken apart by name, so that a new field is not forgotten here.
    fn signals(&mut self) -> [&mut Vec<f64>; 18] {
        let Self {
            q,
            dq,
            ddq,
            theta,
            dtheta,
            q_std,
            disturbance,
            disturbance_std: torque_std,
            wrench,
            wrench_std,
            tool,
            tool_std,
            nis,
            log_likelihood,
            state,
            covariance,
            innovation,
            innovation_std: std,
            status: _,
            used: _,
            findings: _,
        } = self;
        [
            q,
            dq,
            ddq,
            theta,
            dtheta,
            q_std,
            disturbance,
            torque_std,
            wrench,
            wrench_std,
            tool,
            tool_std,
            nis,
            log_likelihood,
            state,
            covariance,
            innovation,
            std,
        ]
    }
}

/// Of a variance; infinite where that overflowed, and nothing is known.
fn deviation(variance: f64) -> f64 {
    if variance.is_nan() { f64::INFINITY } else { variance.max(0.0).sqrt() }
}

/// The tool centre point and how it moves with the joints.
#[derive(Clone, Debug)]
pub(crate) struct Tool {
    /// Of the tree, positions alone.
    kinematics: Kinematics<f64>,
    /// ∂p/∂q, 3 × n, row-major.
    jacobian: Vec<f64>,
}

impl Tool {
    pub(crate) fn new(robot: &Robot) -> Self {
        Self { kinematics: Kinematics::new(&robot.tree), jacobian: vec![0.0; 3 * robot.len()] }
    }

    /// Position at `q`, the derivative beside; none of a robot without a tool.
    fn set(&mut self, robot: &Robot, q: &[f64]) -> Option<[f64; 3]> {
        simd::phase(SetTool { tool: self, robot, q })
    }

    #[inline(always)]
    fn set_here(&mut self, robot: &Robot, q: &[f64]) -> Option<[f64; 3]> {
        let frame = robot.tool.as_ref()?;
        let Self { kinematics, jacobian } = self;
        kinematics.set_position(&robot.tree, q);
        jacobian.fill(0.0);
        kinematics.position_jacobian(&robot.tree, frame, |joint, column| {
            for (row, value) in jacobian.chunks_exact_mut(q.len()).zip(column.0) {
                row[joint] += value;
            }
        });
        Some(kinematics.position(frame).0)
    }
}

/// [`Tool::set`], to be compiled for each instruction set.
struct SetTool<'a> {
    tool: &'a mut Tool,
    robot: &'a Robot,
    q: &'a [f64],
}

impl Kernel for SetTool<'_> {
    type Output = Option<[f64; 3]>;

    #[inline(always)]
    fn run(self) -> Self::Output {
        self.tool.set_here(self.robot, self.q)
    }
}

#[cfg(test)]
mod tests {
    #[test]
    fn a_variance_that_overflowed_is_not_certainty() {
        assert_eq!(super::deviation(f64::NAN), f64::INFINITY);
        assert_eq!(super::deviation(-1e-30), 0.0);
        assert_eq!(super::deviation(4.0), 2.0);
    }
}
