//! A step of time of the elastic-joint model: the mean by Runge and Kutta, the covariance by a matrix exponential.
//!
//! A step from t to t + h, torques τ changing linearly in it, with x = (q, q̇, θ, θ̇, disturbances) and ẋ = a(x, τ). Where jerk moves
//! motors, θ̈ are states as well and τ is their jerk.
//!
//! | part | how |
//! | --- | --- |
//! | x(t + h) | the classical rule of fourth order in 2ᵏ substeps, in each of which the fastest mode turns by at most half a radian |
//! | A | ∂a/∂x at the middle of the step, so that Φ is of second order in what A changes by; at its beginning for [`Discretization::FirstOrder`] |
//! | Φ = e^(A h) | six terms over a substep, doubled k times (N. J. Higham, SIAM J. Matrix Anal. Appl. 26, 2005) |
//! | Q = ∫ e^(A s) G Gᵀ e^(Aᵀ s) ds | from the same terms, doubled beside Φ: Q₂ = Q + Φ Q Φᵀ |
//! | ∂x/∂τ, ∂x/∂p | integrals of e^(A s) over the step, likewise doubled |
//!
//! A has the structure of a second-order system (rows of q and θ are unit vectors), so that a product with it costs 2n rows of
//! n columns and not all of it. C. Van Loan's (1978) block exponential gives the same Q, and loses it where A h is large: it
//! multiplies e^(−A h) by e^(A h).

use super::elastic::Discretization;
use super::elastic_sensitivity::ElasticSensitivity;
use super::gaussian::{Gaussian, Symmetric};
use super::sigma_points::{SigmaPoints, SigmaRule};
use super::step_noise::{self, StepNoise};
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
    /// Q and the responses to torques, built up beside Φ.
    pub(super) noise: StepNoise,
    /// Variance of each torque over a step (n).
    pub(super) torque: Vec<f64>,
    /// States that are others after the next step, independent of all, of these variances.
    pub(super) replaced: Vec<(usize, f64)>,
    /// Upper bound of the fastest mode [rad/s], where the model was last linearised.
    fastest: f64,
    /// Numbers between rows of the matrices.
    stride: usize,
    /// Φ, dense × dense.
    phi: Vec<f64>,
    /// (A h)ᵏ/k!, later Φᵀ.
    term: Vec<f64>,
    /// Scratch of products, as large as Φ.
    product: Vec<f64>,
    /// The root of Q.
    root: Vec<f64>,
    /// The dense rows of a covariance.
    wide: Vec<f64>,
    /// The four slopes of Runge and Kutta.
    slopes: [Vec<f64>; 4],
    /// The mean where the step began.
    start: Vec<f64>,
    /// Where the dynamics are evaluated, and the torques there.
    probe: Vec<f64>,
    tau: Vec<f64>,
    /// Scratch of columns on their way through Φ.
    carried: Vec<f64>,
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
        let stride = d.next_multiple_of(linear::LANES);
        let matrix = || vec![0.0; d * stride];
        let nodes = if layout.motor_acceleration.is_some() { step_noise::FIVE } else { step_noise::FOUR };
        Self {
            dynamics: ElasticDynamics::new(robot, &layout),
            discretization,
            noise: StepNoise::new(d, sources, nodes, robot.len()),
            torque: vec![0.0; robot.len()],
            replaced: Vec::with_capacity(robot.len()),
            fastest: 0.0,
            stride,
            phi: matrix(),
            term: matrix(),
            product: matrix(),
            root: vec![0.0; stride * stride],
            wide: vec![0.0; d * states.next_multiple_of(linear::LANES)],
            slopes: core::array::from_fn(|_| vec![0.0; d]),
            start: vec![0.0; d],
            probe: vec![0.0; d],
            tau: vec![0.0; robot.len()],
            carried: Vec::new(),
            sensitivity: ElasticSensitivity::default(),
            points: None,
            layout,
        }
    }

    /// Makes room for beliefs of `states`.
    pub(super) fn widen(&mut self, states: usize) {
        self.wide = vec![0.0; self.layout.dense * states.next_multiple_of(linear::LANES)];
    }

    /// From now on sigma points go through the step; none: Φ does.
    pub(super) fn set_points(&mut self, rule: Option<SigmaRule>) {
        let d = self.layout.dense;
        self.points = rule.map(|rule| Box::new(SigmaPoints::new(rule, d, d)));
    }

    /// Some numbers of the robot are known to a tolerance only; see [`drive`](Self::drive).
    pub(super) fn consider(&mut self, sensitivity: ElasticSensitivity) {
        let n = self.layout.joints;
        self.noise.set_inputs(if sensitivity.is_empty() { n } else { 3 * n });
        self.carried = vec![0.0; self.layout.dense * sensitivity.tolerances().len().next_multiple_of(linear::LANES)];
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
                self.square(doublings);
            }
        }
        // Taken out while it is used, for each point goes through the same step.
        if let Some(mut points) = self.points.take() {
            self.regress(robot, &mut points, belief, torques, substeps, dt);
            self.points = Some(points);
        }
        // A torque's reading is one number for the whole step: its noise enters by Ψ Ψᵀ and not as white noise.
        self.noise.add_torques(&self.torque);
        // A disturbance that ends with an outage: no longer correlated with anything, so its row of Φ goes as well.
        for &(state, variance) in &self.replaced {
            self.noise.replace(state, variance);
            self.phi[state * self.stride..][..d].fill(0.0);
        }
        // P ← Φ P Φᵀ + Q, biases beyond the dense states included.
        self.congruence(&mut belief.covariance, false);
        let (p, q) = (&mut belief.covariance, self.noise.covariance());
        for (row, noise) in p.data.chunks_exact_mut(p.stride).zip(q.data.chunks_exact(q.stride)) {
            linear::add_scaled(&mut row[..d], 1.0, noise);
        }
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
        points.correct(&mut self.phi, self.stride);
        self.noise.add(&points.residual);
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

    /// Φ = Σ (A h)ᵏ/k!, k up to `terms`, and what noise does meanwhile.
    #[inline(always)]
    fn expand(&mut self, robot: &Robot, h: f64, terms: usize) {
        let Self { layout, dynamics, noise, stride, phi, term, product, .. } = self;
        let d = &layout.dense;
        noise.clear();
        // k = 0: the identity.
        for matrix in [&mut *phi, &mut *term] {
            matrix.fill(0.0);
            for i in 0..*d {
                matrix[i * *stride + i] = 1.0;
            }
        }
        noise.term(0, term);
        for k in 1..=terms {
            apply(layout, dynamics, term, *stride, product);
            for (term, value) in term.iter_mut().zip(product.iter()) {
                *term = value * (h / k as f64);
            }
            linear::add_scaled(phi, 1.0, term);
            noise.term(k, term);
        }
        // Inputs: torques, then, where parameters count, unit rates of links' and of motors' velocities.
        let n = layout.joints;
        noise.substep(h, |input, rate| match input / n {
            0 => dynamics.rate_by_torque_into(robot, layout, input, rate),
            1 => rate[input] = 1.0,
            _ => rate[layout.dtheta[input - 2 * n]] = 1.0,
        });
    }

    /// Φ ← Φ², `doublings` times.
    #[inline(always)]
    fn square(&mut self, doublings: u32) {
        let d = self.layout.dense;
        for _ in 0..doublings {
            transpose(&self.phi, d, self.stride, &mut self.term);
            self.noise.double(&self.phi, &self.term, &mut self.product, &mut self.wide[..d * self.stride]);
            linear::product(&self.phi, self.stride, &self.phi, self.stride, &mut self.product);
            self.phi.copy_from_slice(&self.product);
        }
    }

    /// P ← Φ P Φᵀ, or Φᵀ P Φ where `transposed`, Φ being the identity beyond its own rows.
    #[inline(always)]
    fn congruence(&mut self, p: &mut Symmetric, transposed: bool) {
        let Self { layout: ElasticLayout { dense: d, .. }, stride, phi, term, product, wide, .. } = self;
        transpose(phi, *d, *stride, term);
        let (left, right) = if transposed { (&*term, &*phi) } else { (&*phi, &*term) };
        let rows = *d * p.stride;
        linear::product(left, *stride, &p.data[..rows], p.stride, wide);
        p.data[..rows].copy_from_slice(wide);
        linear::product(wide, p.stride, right, *stride, product);
        for (row, block) in p.data.chunks_exact_mut(p.stride).zip(product.chunks_exact(*stride)) {
            row[..*d].copy_from_slice(&block[..*d]);
        }
        p.mirror();
    }

    /// Φ and Q, row by row without padding.
    #[inline(always)]
    pub(super) fn remember(&self, memory: &mut Vec<f64>) {
        let d = self.layout.dense;
        for matrix in [&self.phi, &self.noise.covariance().data] {
            for row in matrix.chunks_exact(self.stride).take(d) {
                memory.extend_from_slice(&row[..d]);
            }
        }
    }

    /// Rows of the root of Q that [`remember`](Self::remember) wrote.
    #[inline(always)]
    pub(super) fn noise_rows(&mut self, memory: &[f64], rows: &mut [f64], width: usize) {
        let (d, stride) = (self.layout.dense, self.stride);
        for (row, values) in self.root.chunks_exact_mut(stride).zip(memory[d * d..].chunks_exact(d)) {
            row[..d].copy_from_slice(values);
        }
        // Q of a step may be singular, where a state has no noise of its own: such a row is zero.
        linear::upper_factor(&mut self.root, d, stride);
        for (out, row) in rows.chunks_exact_mut(width).zip(self.root.chunks_exact(stride)).take(d) {
            out[..d].copy_from_slice(&row[..d]);
        }
    }

    /// Columns (states × `stride`) through the step: Σ ← Φ Σ.
    #[inline(always)]
    pub(super) fn carry(&mut self, columns: &mut [f64], stride: usize) {
        let (d, rows) = (self.layout.dense, self.layout.dense * stride);
        self.carried.resize(rows, 0.0);
        for (out, row) in self.carried.chunks_exact_mut(stride).zip(self.phi.chunks_exact(self.stride)) {
            out.fill(0.0);
            for (factor, column) in row[..d].iter().zip(columns.chunks_exact(stride)) {
                linear::add_scaled(out, *factor, column);
            }
        }
        columns[..rows].copy_from_slice(&self.carried);
    }

    /// What parameters do over the step, to columns (states × `stride`): Σ ← Σ + ∫ e^(As) ds ∂ẋ/∂p, ∂ẋ/∂p where the model
    /// was linearised.
    #[inline(always)]
    pub(super) fn drive(&self, columns: &mut [f64], stride: usize) {
        let Self {
            layout: ElasticLayout { joints: n, theta, dense, motor_acceleration, .. }, sensitivity, noise, ..
        } = self;
        let (links, motors) = (sensitivity.links.chunks_exact(stride), sensitivity.motors.chunks_exact(stride));
        // Motors that jerk moves feel none of it.
        let elastic = motors.enumerate().map(|(j, motor)| (motor, theta[j] >= 2 * n && motor_acceleration.is_none()));
        for ((by, there), response) in links.map(|link| (link, true)).chain(elastic).zip(noise.responses(*n)) {
            for (column, r) in columns.chunks_exact_mut(stride).zip(&response[..*dense]).filter(|_| there) {
                linear::add_scaled(column, *r, by);
            }
        }
    }

    /// The adjoint of [`carry`](Self::carry) by a step that [`remember`](Self::remember) wrote: Λ ← Φᵀ Λ.
    #[inline(always)]
    pub(super) fn carry_back(&mut self, memory: &[f64], columns: &mut [f64], stride: usize) {
        let d = self.layout.dense;
        self.carried.resize(d * stride, 0.0);
        self.carried.fill(0.0);
        for (row, column) in memory[..d * d].chunks_exact(d).zip(columns.chunks_exact(stride)) {
            for (factor, out) in row.iter().zip(self.carried.chunks_exact_mut(stride)) {
                linear::add_scaled(out, *factor, column);
            }
        }
        columns[..d * stride].copy_from_slice(&self.carried);
    }

    /// The adjoint of a step that [`remember`](Self::remember) wrote: λ ← Φᵀ λ, Λ ← Φᵀ Λ Φ.
    #[inline(always)]
    pub(super) fn retreat(&mut self, memory: &[f64], lambda: &mut [f64], big: &mut Symmetric) {
        let (d, stride) = (self.layout.dense, self.stride);
        for (row, values) in self.phi.chunks_exact_mut(stride).zip(memory.chunks_exact(d)) {
            row[..d].copy_from_slice(values);
        }
        self.start.fill(0.0);
        for (row, value) in self.phi.chunks_exact(stride).zip(&lambda[..d]) {
            linear::add_scaled(&mut self.start, *value, row);
        }
        lambda[..d].copy_from_slice(&self.start);
        self.congruence(big, true);
    }
}

/// A · `right`: velocities are copied, accelerations multiplied, the rest stays as it is.
#[inline(always)]
fn apply(layout: &ElasticLayout, dynamics: &ElasticDynamics, right: &[f64], stride: usize, out: &mut [f64]) {
    let (n, d) = (layout.joints, layout.dense);
    out.fill(0.0);
    linear::product(&dynamics.ddq_by, d, right, stride, &mut out[n * stride..]);
    out[..n * stride].copy_from_slice(&right[n * stride..2 * n * stride]);
    for j in (0..n).filter(|&j| layout.theta[j] >= 2 * n) {
        let (theta, dtheta) = (layout.theta[j] * stride, layout.dtheta[j] * stride);
        linear::product(&dynamics.ddtheta_by[j * d..][..d], d, right, stride, &mut out[dtheta..]);
        out[theta..theta + stride].copy_from_slice(&right[dtheta..dtheta + stride]);
    }
    for row in &dynamics.elements {
        for (k, by) in row.entries {
            linear::add_scaled(&mut out[row.state * stride..][..stride], by, &right[k * stride..][..stride]);
        }
    }
    if let Some(first) = layout.link_disturbance.filter(|_| layout.forgetting > 0.0) {
        let rows = first * stride..(first + n) * stride;
        linear::add_scaled(&mut out[rows.clone()], -layout.forgetting, &right[rows]);
    }
}

/// `out` ← `matrix`ᵀ, d × d in rows of `stride`.
#[inline(always)]
fn transpose(matrix: &[f64], d: usize, stride: usize, out: &mut [f64]) {
    for (i, row) in matrix.chunks_exact(stride).enumerate() {
        for (j, value) in row[..d].iter().enumerate() {
            out[j * stride + i] = *value;
        }
    }
}
