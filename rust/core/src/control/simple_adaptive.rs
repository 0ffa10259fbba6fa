//! Direct adaptive control of the tool by the transposed Jacobian.
//!
//! Each controlled axis of the tool follows a reference model ẍ_m + 2ζω ẋ_m + ω² x_m = ω² x_ref. Gains need no model of the robot: they
//! rise with the squared error, and leak, so that noise does not make them grow for ever. Damping between motor and link, which
//! the transposed Jacobian alone lacks, is a gain of its own.

use super::{Controller, Reference, Refused, RobotState};
use crate::check::{expect, expect_each, expect_length};
use crate::dynamics::Kinematics;
use crate::error::DesignError;
use crate::robot::Robot;
use nalgebra::Matrix2;
use std::sync::Arc;

/// Gains of [`SimpleAdaptive`].
#[derive(Clone, Copy, Debug)]
pub struct AdaptiveGains {
    /// Γ_pp, Γ_pi: proportional and integral adaptation of K_p [N/m³, N/m³/s].
    pub position: [f64; 2],
    /// Γ_dp, Γ_di: of K_d [N s³/m³, N s²/m³].
    pub velocity: [f64; 2],
    /// σ_p, σ_d: leakage of the integral gains [1/s].
    pub leakage: [f64; 2],
    /// K_v: damping of motors relative to their links [N m s/rad].
    pub joint_damping: f64,
    /// ω_n of the reference model [rad/s].
    pub bandwidth: f64,
    /// ζ of the reference model.
    pub damping_ratio: f64,
}

impl AdaptiveGains {
    /// # Errors
    /// A gain or a leakage that is negative, a reference model that is none.
    fn check(&self) -> Result<(), DesignError> {
        let [adaptation, leakage] = [[self.position, self.velocity].concat(), self.leakage.to_vec()];
        for (what, values) in [("adaptation gain", adaptation), ("leakage", leakage)] {
            expect_each(what, &values, |v| v >= 0.0 && v.is_finite(), "a finite number of at least 0")?;
        }
        for (what, value) in [("bandwidth", self.bandwidth), ("damping_ratio", self.damping_ratio)] {
            expect(value > 0.0 && value.is_finite(), what, value, "a finite number greater than 0")?;
        }
        expect(self.joint_damping.is_finite(), "joint_damping", self.joint_damping, "a finite number")
    }
}

/// One axis of the tool: reference model and integral gains.
#[derive(Clone, Copy, Debug, Default)]
struct Axis {
    /// Position and velocity of the reference model, and what it follows.
    model: [f64; 2],
    command: f64,
    /// Of K_p and K_d.
    integral: [f64; 2],
    /// On the tool along this axis [N].
    force: f64,
}

/// τ = Jᵀ(K_p e + K_d ė) + K_v (q̇ − θ̇), e the tool's distance to a reference model of second order that follows the
/// command, and gains that grow with squared errors: K = Γ_p e² + K_i, K̇_i = Γ_i e² − σ K_i.
///
/// A reconstruction: Ulrich and Sasiadek, ACC 2011, name the gains, and refer for the equations to Ulrich, Sasiadek and
/// Barkana, JGCD 35(3), 2012, which was not at hand; this is the standard form of simple adaptive control with them.
#[derive(Clone, Debug)]
pub struct SimpleAdaptive {
    robot: Arc<Robot>,
    gains: AdaptiveGains,
    reference: Reference,
    /// Which coordinates of the tool are controlled, 0 to 2 for x to z.
    coordinates: Vec<usize>,
    /// Of the tool, with ∂p/∂q by columns (n × 3).
    kinematics: Kinematics<f64>,
    jacobian: Vec<f64>,
    /// One a coordinate.
    axes: Vec<Axis>,
    /// Of the reference model over a period.
    transition: Matrix2<f64>,
    /// What leakage leaves of integral gains after a period, and what it makes of a constant input.
    decay: [[f64; 2]; 2],
    started: bool,
}

impl SimpleAdaptive {
    /// For commands of some `coordinates` of the tool (0 to 2 for x to z) [m], called every `period` [s].
    ///
    /// # Errors
    /// A robot without a tool, gains out of range, coordinates that do not fit the reference.
    pub fn new(
        robot: Arc<Robot>,
        reference: Reference,
        coordinates: Vec<usize>,
        gains: AdaptiveGains,
        period: f64,
    ) -> Result<Self, DesignError> {
        gains.check()?;
        expect_length("command", reference.width(), coordinates.len())?;
        for &axis in &coordinates {
            expect(axis <= 2, "axis", axis as f64, "0, 1 or 2")?;
        }
        expect(robot.tool.is_some(), "number of tools", 0.0, "1: control is of the tool")?;
        let (w, z) = (gains.bandwidth, gains.damping_ratio);
        let decay = gains.leakage.map(|leak| {
            // K̇_i = Γ e² − σ K_i over a period, e held: exact, so that any leakage is stable.
            let left = (-leak * period).exp();
            [left, if leak == 0.0 { period } else { (1.0 - left) / leak }]
        });
        Ok(Self {
            kinematics: Kinematics::new(&robot.tree),
            jacobian: vec![0.0; 3 * robot.len()],
            axes: vec![Axis::default(); coordinates.len()],
            transition: (Matrix2::new(0.0, 1.0, -w * w, -2.0 * z * w) * period).exp(),
            decay,
            started: false,
            robot,
            gains,
            reference,
            coordinates,
        })
    }

    /// Output of the reference model (coordinates) [m].
    pub fn model(&self) -> impl Iterator<Item = f64> + '_ {
        self.axes.iter().map(|axis| axis.model[0])
    }

    /// The tool's position, the derivative left in `jacobian`.
    #[inline(always)]
    fn locate(&mut self, q: &[f64]) -> [f64; 3] {
        let Self { robot, kinematics, jacobian, .. } = self;
        let Some(tool) = &robot.tool else { return [0.0; 3] };
        kinematics.set_position(&robot.tree, q);
        jacobian.fill(0.0);
        kinematics.position_jacobian(&robot.tree, tool, |joint, column| {
            jacobian[3 * joint..][..3].iter_mut().zip(column.0).for_each(|(out, by)| *out += by);
        });
        kinematics.position(tool).0
    }

    /// Force on one axis for errors `e` of position and velocity; then the gains move on by a period.
    #[inline(always)]
    fn adapt(&mut self, axis: usize, e: [f64; 2]) {
        let Self { gains, decay, axes, .. } = self;
        let own = &mut axes[axis];
        own.force = 0.0;
        for (i, [proportional, integral]) in [gains.position, gains.velocity].into_iter().enumerate() {
            let square = e[i] * e[i];
            own.force += (proportional * square + own.integral[i]) * e[i];
            own.integral[i] = decay[i][0] * own.integral[i] + decay[i][1] * integral * square;
        }
    }
}

impl Controller for SimpleAdaptive {
    #[inline(always)]
    fn torque(&mut self, t: f64, state: &RobotState, out: &mut [f64]) -> Result<(), Refused> {
        let position = self.locate(&state.q);
        let Self { reference, axes, .. } = self;
        reference.at(t, |i, value, _| axes[i].command = value);
        for i in 0..self.coordinates.len() {
            let c = self.coordinates[i];
            let velocity: f64 = state.dq.iter().enumerate().map(|(j, dq)| self.jacobian[3 * j + c] * dq).sum();
            if !self.started {
                self.axes[i].model = [position[c], velocity];
            }
            let [p, v] = self.axes[i].model;
            self.adapt(i, [p - position[c], v - velocity]);
            let r = self.axes[i].command;
            // The reference model's state about its command, which is held over the period: exact as well.
            let next = self.transition * nalgebra::Vector2::new(p - r, v);
            self.axes[i].model = [next[0] + r, next[1]];
        }
        self.started = true;
        for (j, out) in out.iter_mut().enumerate() {
            let pull: f64 =
                self.coordinates.iter().zip(&self.axes).map(|(c, a)| self.jacobian[3 * j + c] * a.force).sum();
            *out = pull + self.gains.joint_damping * (state.dq[j] - state.dtheta[j]);
        }
        Ok(())
    }
}
