//! One joint's observer in discrete time.
//!
//! The innovation is used at the sampling instants only: a θ held inside an integration step would be wrong by up to
//! one period of motion, times gains of 10⁸. Between samples the model is integrated exactly: torque held, as an
//! amplifier holds it, and acceleration interpolated.

use super::gains::JointModel;
use super::poles::Poles;
use crate::robot::Drive;
use crate::scalar::{Scalar, exp_m1};
use nalgebra::{DMatrix, DVector};

/// The largest order of a joint's model.
pub(super) const ORDER: usize = 5;
/// A joint's state, padded with zeros.
pub(super) type JointState = [f64; ORDER];

/// Exact one-period map of a joint's model, and the gain that maps the poles exactly, z = e^{λh}.
#[derive(Clone, Debug)]
pub struct Sampled {
    /// Φ = e^(A h).
    transition: [JointState; ORDER],
    /// Response to a torque and an acceleration held over the period…
    held: [JointState; 2],
    /// …and to their change over it, on a straight line.
    ramp: [JointState; 2],
    /// Φ⁻¹L_d: what an innovation adds to the predicted state.
    gain: JointState,
}

impl Sampled {
    /// Discretises `model` of `drive` with period `h` [s], error poles e^{λh} for λ in `poles`.
    pub fn new(model: JointModel, drive: &Drive, poles: &Poles, h: f64) -> Self {
        let (a, input) = model.matrices(drive);
        let (n, inputs) = input.shape();
        // exp of [A B 0; 0 0 1; 0 0 0]h holds the transition, the step response and the ramp response.
        let mut augmented = DMatrix::zeros(n + 2 * inputs, n + 2 * inputs);
        augmented.view_mut((0, 0), (n, n)).copy_from(&(&a * h));
        augmented.view_mut((0, n), (n, inputs)).copy_from(&(&input * h));
        augmented.view_mut((n, n + inputs), (inputs, inputs)).fill_with_identity();
        let response = augmented.exp();
        let column = |j: usize| padded(response.view((0, j), (n, 1)).iter());
        let transition = response.view((0, 0), (n, n)).into_owned();
        let mut rows = [JointState::default(); ORDER];
        for (row, values) in rows.iter_mut().zip(transition.row_iter()) {
            *row = padded(values.iter());
        }
        Self {
            transition: rows,
            held: [column(n), column(n + 1)],
            ramp: [column(n + 2), column(n + 3)],
            gain: padded(current_gain(&a, poles, h).iter()),
        }
    }

    /// Φ (order × order), the responses to a held and to a ramped torque and acceleration (order × 2 each) and Φ⁻¹L_d
    /// (order), row-major, for who analyses a loop that this observer is part of.
    pub fn matrices(&self, order: usize) -> [Vec<f64>; 4] {
        let inputs = |responses: &[JointState; 2]| (0..2 * order).map(|k| responses[k % 2][k / 2]).collect();
        let transition = self.transition[..order].iter().flat_map(|row| &row[..order]).copied().collect();
        [transition, inputs(&self.held), inputs(&self.ramp), self.gain[..order].to_vec()]
    }

    /// State one period on, under a held torque and acceleration.
    #[inline(always)]
    pub(super) fn predict(&self, x: &JointState, torque: f64, acceleration: f64) -> JointState {
        let mut out = JointState::default();
        for (i, out) in out.iter_mut().enumerate() {
            *out = self.held[0][i] * torque + self.held[1][i] * acceleration;
            for j in 0..ORDER {
                *out += self.transition[i][j] * x[j];
            }
        }
        out
    }

    /// Adds what the torque's and the acceleration's change over the period does to a held prediction.
    #[inline(always)]
    pub(super) fn interpolate(&self, x: &mut JointState, torque: f64, acceleration: f64) {
        for i in 0..ORDER {
            x[i] += self.ramp[0][i] * torque + self.ramp[1][i] * acceleration;
        }
    }

    /// What an innovation adds to a predicted state, where there is a position in every sample.
    #[inline(always)]
    pub(super) fn gain(&self) -> &JointState {
        &self.gain
    }

    /// What a torque and an acceleration held over a period add to the state.
    pub(super) fn held(&self) -> &[JointState; 2] {
        &self.held
    }

    /// From one sample to the next.
    #[inline(always)]
    pub(super) fn transition(&self) -> &[JointState; ORDER] {
        &self.transition
    }

    /// The innovation that a lasting error `acceleration` of the measured acceleration [rad/s²] makes, of `order` states.
    pub(super) fn innovation(&self, order: usize, acceleration: f64) -> f64 {
        let left = DMatrix::identity(order, order) - self.error_matrix(order);
        let input = DVector::from_fn(order, |i, _| self.held[1][i] * acceleration);
        left.lu().solve(&input).map_or(0.0, |error| error[0].abs())
    }

    /// The matrix that takes the error of one prediction to the next, Φ(1 − gain·C), for the first `order` states.
    pub fn error_matrix(&self, order: usize) -> DMatrix<f64> {
        let phi = DMatrix::from_fn(order, order, |i, j| self.transition[i][j]);
        let mut corrected = DMatrix::identity(order, order);
        for i in 0..order {
            corrected[(i, 0)] -= self.gain[i];
        }
        phi * corrected
    }
}

/// Zeros behind the model's own states, so that loops have one length for all joints.
fn padded<'a>(values: impl Iterator<Item = &'a f64>) -> JointState {
    let mut out = JointState::default();
    for (slot, value) in out.iter_mut().zip(values) {
        *slot = *value;
    }
    out
}

/// Φ⁻¹L_d by Ackermann's formula for Δ = (Φ − 1)/h, whose poles are (e^{λh} − 1)/h.
///
/// Φ itself is close to the identity and its observability matrix close to singular; Δ stays as well conditioned as A.
fn current_gain(a: &DMatrix<f64>, poles: &Poles, h: f64) -> DVector<f64> {
    let n = a.nrows();
    // In units of time of one over the fastest pole, and for each state its own, so that its neighbours have the
    // size that the observer expects of them.
    let omega = poles.fastest();
    let scale = scales(a, omega);
    let a = DMatrix::from_fn(n, n, |i, j| a[(i, j)] * scale[i] / scale[j] / omega);
    let h = h * omega;
    // exp of [A 1; 0 0]h holds ∫e^(As) ds, with which Δ = A ∫e^(As) ds / h has no difference in it.
    let mut integral = DMatrix::zeros(2 * n, 2 * n);
    integral.view_mut((0, 0), (n, n)).copy_from(&(&a * h));
    integral.view_mut((0, n), (n, n)).fill_with_identity();
    let delta = &a * integral.exp().view((0, n), (n, n));
    let poles = poles.map(|p| super::Complex::new(expm1_re(p, omega, h), expm1_im(p, omega, h)) / h);

    let mut characteristic = DMatrix::identity(n, n);
    for [c0, c1, c2] in poles.factors() {
        let factor = &delta * &delta * c2 + &delta * c1 + DMatrix::identity(n, n) * c0;
        characteristic = factor * characteristic;
    }
    let mut observability = DMatrix::zeros(n, n);
    let mut row = DMatrix::zeros(1, n);
    row[0] = 1.0;
    for i in 0..n {
        observability.view_mut((i, 0), (1, n)).copy_from(&row);
        row = &row * &delta;
    }
    let mut last = DVector::zeros(n);
    last[n - 1] = 1.0;
    // Stiffness is positive, so θ observes every state and both factorisations exist.
    let first = observability.lu().solve(&last).unwrap_or_else(|| DVector::zeros(n));
    let transition = DMatrix::identity(n, n) + delta * h;
    let gain = transition.lu().solve(&(characteristic * first * h)).unwrap_or_else(|| DVector::zeros(n));
    DVector::from_fn(n, |i, _| gain[i] / scale[i])
}

/// What to multiply each state by: derivatives by 1/ω, and the link's side by what of it reaches θ, K/(Bω²).
fn scales(a: &DMatrix<f64>, omega: f64) -> Vec<f64> {
    match a.nrows() {
        3 => vec![1.0, 1.0 / omega, 1.0 / omega.powi(2)],
        n => {
            let reach = a[(2, 1)] / omega.powi(2);
            vec![1.0, reach, 1.0 / omega, reach / omega, reach / omega.powi(2)][..n].to_vec()
        }
    }
}

/// Real part of e^{λh} − 1 without cancellation, λh = p/ω · h.
fn expm1_re(p: super::Complex, omega: f64, h: f64) -> f64 {
    let (x, y) = (p.re / omega * h, p.im / omega * h);
    let half = Scalar::sin_cos(0.5 * y).0;
    exp_m1(x) * Scalar::sin_cos(y).1 - 2.0 * half * half
}

/// Imaginary part of e^{λh} − 1.
fn expm1_im(p: super::Complex, omega: f64, h: f64) -> f64 {
    Scalar::exp(p.re / omega * h) * Scalar::sin_cos(p.im / omega * h).0
}
