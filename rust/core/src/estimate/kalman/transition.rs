//! A step of time of the elastic-joint model: the mean by Runge and Kutta, the covariance by a matrix exponential.
//!
//! A step from t to t + h, torques τ changing linearly in it, with x = (q, q̇, θ, θ̇, disturbances) and ẋ = a(x, τ). Where jerk moves
//! motors, θ̈ are states as well and τ is their jerk.
//!
//! | part | how |
//! | --- | --- |
//! | x(t + h) | the classical rule of fourth order in 2ᵏ substeps, in each of which the fastest mode turns by at most half a radian |
//! | A | ∂a/∂x at the middle of the step, so that Φ is of second order in what A changes by; at its beginning for [`Discretization::FirstOrder`] |
//! | Φ = e^(A h) | six terms over a substep, doubled k times (N. J. Higham, SIAM J. Matrix Anal. Appl. 26, 2005): `exponential` |
//! | Q = ∫ e^(A s) G Gᵀ e^(Aᵀ s) ds | from the same terms, doubled beside Φ: Q₂ = Q + Φ Q Φᵀ |
//! | ∂x/∂τ, ∂x/∂p | integrals of e^(A s) over the step, likewise doubled |
//!
//! C. Van Loan's (1978) block exponential gives the same Q, and loses it where A h is large: it
//! multiplies e^(−A h) by e^(A h).

use super::elastic::Discretization;
use super::elastic_sensitivity::ElasticSensitivity;
use super::exponential::Exponential;
use super::gaussian::Gaussian;
use super::sigma_points::{SigmaPoints, SigmaRule};
use super::step_noise;
use crate::dynamics::{ElasticDynamics, ElasticLayout, ElementRow};
use crate::linear;
use crate::robot::Robot;

/// The fastest mode may turn, or decay, by this in a substep [rad].
const ANGLE: f64 = 0.5;
/// Terms of the exponential's series; at [`ANGLE`] they leave less than 2e-6 of a mode's turn.
const TERMS: usize = 6;
/// Largest number of doublings of a substep.
const MOST: u32 = 12;

/// Scratch of a step of time.
///
/// The mean goes by the nonlinear equations in substeps that the fastest mode allows; Φ and Q by a series over one
/// substep, then by doubling.
#[derive(Clone, Debug)]
pub(super) struct Transition {
    /// Where in the state each joint's numbers are.
    pub(super) layout: ElasticLayout,
    /// Accelerations and their derivatives where the model was last looked at.
    pub(super) dynamics: ElasticDynamics,
    /// How Φ comes of A.
    discretization: Discretization,
    /// Variance of each torque over a step (n).
    pub(super) torque: Vec<f64>,
    /// States that are others after the next step, independent of all, of these variances.
    pub(super) replaced: Vec<(usize, f64)>,
    /// Upper bound of the fastest mode [rad/s], where the model was last linearised.
    fastest: f64,
    /// Φ and Q.
    pub(super) exponential: Exponential,
    /// The four slopes of Runge and Kutta.
    slopes: [Vec<f64>; 4],
    /// The mean where the step began.
    start: Vec<f64>,
    /// Where the dynamics are evaluated, and the torques there.
    probe: Vec<f64>,
    tau: Vec<f64>,
    /// Where the model was last linearised.
    sensitivity: ElasticSensitivity,
    /// Points that go through the step in place of Φ; none: Φ.
    points: Option<Box<SigmaPoints>>,
}

/// Motor torques, or jerks of motors that jerk moves (n), at the beginning and at the end of a step; in between they change
/// linearly.
pub(super) type Torques<'a> = (&'a [f64], &'a [f64]);

impl Transition {
    /// `sources` are the states that white noise drives, and its densities.
    pub(super) fn new(
        robot: &Robot,
        layout: ElasticLayout,
        discretization: Discretization,
        states: usize,
        sources: Vec<(usize, f64)>,
    ) -> Self {
        let d = layout.dense;
        let nodes = if layout.motor_acceleration.is_some() { step_noise::FIVE } else { step_noise::FOUR };
        Self {
            dynamics: ElasticDynamics::new(robot, &layout),
            discretization,
            torque: vec![0.0; robot.len()],
            replaced: Vec::with_capacity(robot.len()),
            fastest: 0.0,
            exponential: Exponential::new(&layout, states, (sources, nodes)),
            slopes: core::array::from_fn(|_| vec![0.0; d]),
            start: vec![0.0; d],
            probe: vec![0.0; d],
            tau: vec![0.0; robot.len()],
            sensitivity: ElasticSensitivity::default(),
            points: None,
            layout,
        }
    }

    /// Makes room for beliefs of `states`.
    pub(super) fn widen(&mut self, states: usize) {
        self.exponential.widen(states);
    }

    /// From now on sigma points go through the step; none: Φ does.
    pub(super) fn set_points(&mut self, rule: Option<SigmaRule>) {
        let d = self.layout.dense;
        self.points = rule.map(|rule| Box::new(SigmaPoints::new(rule, d, d)));
    }

    /// Some numbers of the robot are known to a tolerance only; see [`drive`](Self::drive).
    pub(super) fn consider(&mut self, sensitivity: ElasticSensitivity) {
        let n = self.layout.joints;
        self.exponential.noise.set_inputs(if sensitivity.is_empty() { n } else { 3 * n });
        self.exponential.reserve(sensitivity.tolerances().len().next_multiple_of(linear::LANES));
        self.sensitivity = sensitivity;
    }

    /// Learns how fast the robot is at `x`.
    pub(super) fn start(&mut self, robot: &Robot, x: &[f64], tau: &[f64]) {
        self.probe.copy_from_slice(&x[..self.layout.dense]);
        self.tau.copy_from_slice(tau);
        self.linearise(robot);
    }

    /// Moves `belief` by `dt` [s], its noise included.
    #[inline(always)]
    pub(super) fn advance(&mut self, robot: &Robot, belief: &mut Gaussian, torques: Torques<'_>, dt: f64) {
        let d = self.layout.dense;
        self.layout.confine(robot, &mut belief.mean[..d]);
        self.start.copy_from_slice(&belief.mean[..d]);
        if self.discretization == Discretization::FirstOrder {
            self.probe.copy_from_slice(&self.start);
            self.interpolate(torques, 0.0);
            self.linearise(robot);
        }
        // Number of halvings after which the fastest mode turns by no more than ANGLE in a substep: for the mean that is
        // accuracy (the rule of Runge and Kutta is of order 4), for the covariance the radius within which the
        // exponential's series is short.
        let short = |k: &u32| f64::from(1_u32 << k) * ANGLE < dt * self.fastest;
        let doublings = (0..MOST).take_while(short).count() as u32;
        let (substeps, length) = (1_u32 << doublings, 1.0 / f64::from(1_u32 << doublings));
        // The mean, nonlinear and in substeps; the covariance below, once, about the middle of what the mean went
        // through.
        self.integrate(robot, &mut belief.mean[..d], torques, substeps, dt);
        match self.discretization {
            // As printed: Φ = 1 + A dt at the step's beginning, whatever the stiffness.
            Discretization::FirstOrder => self.expand(robot, dt, 1),
            Discretization::Exact => {
                // A at the middle of the step: Φ is then of second order in what A changes by.
                for ((probe, a), b) in self.probe.iter_mut().zip(&self.start).zip(&belief.mean) {
                    *probe = 0.5 * (a + b);
                }
                self.interpolate(torques, 0.5);
                self.linearise(robot);
                // Scaling and squaring (Higham 2005) with Q beside: series over one substep, then doubled to the whole
                // step.
                self.expand(robot, dt * length, TERMS);
                self.exponential.square(doublings);
            }
        }
        // Taken out while it is used, for each point goes through the same step.
        if let Some(mut points) = self.points.take() {
            self.regress(robot, &mut points, belief, torques, substeps, dt);
            self.points = Some(points);
        }
        // A torque's reading is one number for the whole step: its noise enters by Ψ Ψᵀ and not as white noise.
        self.exponential.noise.add_torques(&self.torque);
        // A disturbance that ends with an outage: no longer correlated with anything, so its row of Φ goes as well.
        for &(state, variance) in &self.replaced {
            self.exponential.replace(state, variance);
        }
        // P ← Φ P Φᵀ + Q, biases beyond the dense states included.
        self.exponential.propagate(&mut belief.covariance);
    }

    /// The mean at the step's end, Φ and Q by sigma points: Φ is corrected to the slope of the regression, and Q gets what that
    /// leaves.
    #[inline(always)]
    fn regress(
        &mut self,
        robot: &Robot,
        points: &mut SigmaPoints,
        belief: &mut Gaussian,
        torques: Torques<'_>,
        substeps: u32,
        dt: f64,
    ) {
        let d = self.layout.dense;
        let start = core::mem::take(&mut self.start);
        points.evaluate(&start, &belief.covariance, |from, to| {
            to.copy_from_slice(from);
            self.layout.confine(robot, to);
            self.integrate(robot, to, torques, substeps, dt);
        });
        self.start = start;
        belief.mean[..d].copy_from_slice(&points.mean);
        self.layout.confine(robot, &mut belief.mean[..d]);
        self.exponential.correct(points);
    }

    /// The torques after a `part` of the step.
    #[inline(always)]
    fn interpolate(&mut self, (before, after): Torques<'_>, part: f64) {
        for ((tau, a), b) in self.tau.iter_mut().zip(before).zip(after) {
            *tau = a + part * (b - a);
        }
    }

    /// A at the probe under the present torques, and how fast its modes can be at most.
    #[inline(always)]
    fn linearise(&mut self, robot: &Robot) {
        let Self { layout, dynamics, probe, tau, sensitivity, .. } = self;
        dynamics.accelerate(robot, layout, probe, tau);
        dynamics.differentiate(robot, layout, probe);
        if !sensitivity.is_empty() {
            sensitivity.set(robot, layout, dynamics, probe, tau);
        }
        let give = |row: &ElementRow<f64>| row.entries[3].1.abs();
        self.fastest = self.dynamics.elements.iter().map(give).fold(self.bound(), f64::max);
    }

    /// Of ẍ = −P x − V ẋ, |λ|² ≤ ‖P‖ + ‖V‖ |λ| in the norm of absolute row sums.
    #[inline(always)]
    fn bound(&self) -> f64 {
        let Self { layout: ElasticLayout { joints: n, theta, dtheta, dense: d, .. }, dynamics, .. } = self;
        let (mut stiff, mut damped) = (0.0_f64, 0.0_f64);
        for row in dynamics.ddq_by.chunks_exact(*d).chain(dynamics.ddtheta_by.chunks_exact(*d)) {
            let sum = |first: usize, motors: &[usize]| -> f64 {
                let links: f64 = row[first..first + n].iter().map(|x| x.abs()).sum();
                // An element follows its torsion at no more than twice its rate.
                let elements: f64 = dynamics.elements.iter().map(|e| 2.0 * row[e.state].abs()).sum();
                links
                    + elements * f64::from(first == 0)
                    + motors.iter().filter(|&&k| k >= 2 * n).map(|&k| row[k].abs()).sum::<f64>()
            };
            stiff = stiff.max(sum(0, theta));
            damped = damped.max(sum(*n, dtheta));
        }
        0.5 * damped + (0.25 * damped * damped + stiff).sqrt()
    }

    /// `x` through a step of `dt` [s].
    #[inline(always)]
    fn integrate(&mut self, robot: &Robot, x: &mut [f64], torques: Torques<'_>, substeps: u32, dt: f64) {
        let length = 1.0 / f64::from(substeps);
        for i in 0..substeps {
            self.substep(robot, x, torques, f64::from(i) * length, length, dt * length);
        }
    }

    /// One step of the classical fourth-order rule, from a `part` of the step on.
    #[inline(always)]
    fn substep(&mut self, robot: &Robot, x: &mut [f64], torques: Torques<'_>, part: f64, length: f64, h: f64) {
        for (stage, (node, carry)) in [(0.0, 0.0), (0.5, 0.5 * h), (0.5, 0.5 * h), (1.0, h)].into_iter().enumerate() {
            self.probe.copy_from_slice(x);
            if stage > 0 {
                linear::add_scaled(&mut self.probe, carry, &self.slopes[stage - 1]);
            }
            self.interpolate(torques, part + node * length);
            let Self { layout, dynamics, probe, tau, slopes, .. } = self;
            dynamics.accelerate(robot, layout, probe, tau);
            dynamics.rate_into(robot, layout, probe, &mut slopes[stage]);
            if let Some(first) = layout.motor_acceleration {
                slopes[stage][first..][..tau.len()].copy_from_slice(tau);
            }
        }
        for (stage, weight) in [1.0, 2.0, 2.0, 1.0].into_iter().enumerate() {
            linear::add_scaled(x, weight * h / 6.0, &self.slopes[stage]);
        }
        self.layout.confine(robot, x);
    }

    /// Φ and Q over `h` [s] by this many terms, A being where the model was last looked at.
    #[inline(always)]
    fn expand(&mut self, robot: &Robot, h: f64, terms: usize) {
        let Self { layout, dynamics, exponential, .. } = self;
        exponential.expand(robot, layout, dynamics, h, terms);
    }

    /// What parameters do over the step, to columns (states × `stride`): Σ ← Σ + ∫ e^(As) ds ∂ẋ/∂p, ∂ẋ/∂p where the model
    /// was linearised.
    #[inline(always)]
    pub(super) fn drive(&self, columns: &mut [f64], stride: usize) {
        let Self {
            layout: ElasticLayout { joints: n, theta, dense, motor_acceleration, .. },
            sensitivity,
            exponential,
            ..
        } = self;
        let (links, motors) = (sensitivity.links.chunks_exact(stride), sensitivity.motors.chunks_exact(stride));
        // Motors that jerk moves feel none of it.
        let elastic = motors.enumerate().map(|(j, motor)| (motor, theta[j] >= 2 * n && motor_acceleration.is_none()));
        for ((by, there), response) in
            links.map(|link| (link, true)).chain(elastic).zip(exponential.noise.responses(*n))
        {
            for (column, r) in columns.chunks_exact_mut(stride).zip(&response[..*dense]).filter(|_| there) {
                linear::add_scaled(column, *r, by);
            }
        }
    }
}
