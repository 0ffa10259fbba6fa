//! Regressions of earlier states on later ones, which make a fixed lag as cheap as a short one.
//!
//! Given the readings before it, a later state z says of an earlier one x
//!
//! x = m + G (z − r) + e, Cov\[e\] = D,
//!
//! the step back of H. E. Rauch, F. Tung and C. T. Striebel (1965) before anything after z is known. Two such steps after one another are one
//! again, and it does not matter which of many are joined first (S. Särkkä and Á. F. García-Fernández 2021): a step over a whole lag comes of
//! a few that are kept. D is a sum of squares, and so is what is added to it: covariances stay positive and accurate after a
//! long time without readings.

use super::consider::Consider;
use super::gaussian::{Gaussian, Symmetric};
use super::model::Model;
use crate::linear;

/// Mean of a state beside its sensitivities to parameters, and its covariance without these.
#[derive(Clone, Debug)]
pub(super) struct Belief {
    /// Numbers between rows of `columns`: parameters, padded, and then the mean's, padded.
    width: usize,
    /// Σ and then x (states × width, padded).
    columns: Vec<f64>,
    /// P.
    pub(super) covariance: Symmetric,
}

impl Belief {
    pub(super) fn new(states: usize, parameters: usize) -> Self {
        let width = parameters + linear::LANES;
        let covariance = Symmetric::zeros(states);
        Self { width, columns: vec![0.0; covariance.stride * width], covariance }
    }

    /// Takes over what a filter knows.
    pub(super) fn take(&mut self, belief: &Gaussian, consider: Option<&Consider>) {
        self.covariance.data.copy_from_slice(&belief.covariance.data);
        let parameters = self.width - linear::LANES;
        for (i, (row, mean)) in self.columns.chunks_exact_mut(self.width).zip(&belief.mean).enumerate() {
            if let Some(consider) = consider {
                row[..parameters].copy_from_slice(&consider.sensitivity.columns[i * parameters..][..parameters]);
            }
            row[parameters] = *mean;
        }
    }

    fn copy_from(&mut self, other: &Self) {
        self.columns.copy_from_slice(&other.columns);
        self.covariance.data.copy_from_slice(&other.covariance.data);
    }

    /// x (states), and Σ (states × parameters).
    pub(super) fn write(&self, mean: &mut [f64], sensitivities: &mut [f64]) {
        let parameters = self.width - linear::LANES;
        for (i, (row, mean)) in self.columns.chunks_exact(self.width).zip(mean).enumerate() {
            sensitivities[i * parameters..][..parameters].copy_from_slice(&row[..parameters]);
            *mean = row[parameters];
        }
    }
}

/// See the module.
#[derive(Clone, Debug)]
pub(super) struct Regression {
    /// Gᵀ (states × states, padded).
    gain: Vec<f64>,
    /// r, with its sensitivities as [`Belief`] has them.
    reference: Vec<f64>,
    /// m and D.
    own: Belief,
}

/// Room to compute in.
#[derive(Clone, Debug)]
pub(super) struct RegressionRoom {
    /// states × states each, padded.
    root: Vec<f64>,
    rest: Vec<f64>,
    noise: Vec<f64>,
    driven: Vec<f64>,
    /// As `columns` of a [`Belief`].
    moved: Vec<f64>,
}

impl RegressionRoom {
    pub(super) fn new(states: usize, parameters: usize) -> Self {
        let square = || Symmetric::zeros(states).data;
        let moved = Belief::new(states, parameters).columns;
        Self { root: square(), rest: square(), noise: square(), driven: square(), moved }
    }
}

impl Regression {
    pub(super) fn new(states: usize, parameters: usize) -> Self {
        let own = Belief::new(states, parameters);
        Self { gain: own.covariance.data.clone(), reference: own.columns.clone(), own }
    }

    pub(super) fn copy_from(&mut self, other: &Self) {
        self.gain.copy_from_slice(&other.gain);
        self.reference.copy_from_slice(&other.reference);
        self.own.copy_from(&other.own);
    }

    /// Of the state before the step of time that `model` last predicted, on the one after it.
    ///
    /// `before` is what was known before the step and `predicted` after it, `memory` what the model
    /// [remembers](Model::remember) of it.
    pub(super) fn of_step(
        &mut self,
        model: &mut impl Model,
        (memory, dt): (&[f64], f64),
        before: &Belief,
        predicted: &Belief,
        scratch: &mut RegressionRoom,
    ) {
        let Symmetric { n, stride, .. } = before.covariance;
        let RegressionRoom { root, rest, noise, driven, .. } = scratch;
        self.reference.copy_from_slice(&predicted.columns);
        // Gᵀ = (P⁻)⁻¹ F P.
        self.gain.copy_from_slice(&before.covariance.data);
        model.carry_noise_free(&mut self.gain, stride, dt);
        root.copy_from_slice(&predicted.covariance.data);
        // What is known of a state, or follows from those before it, says nothing more: its row is zero, here and below.
        linear::upper_factor(root, n, stride);
        linear::forward(root, stride, &mut self.gain, stride);
        linear::backward(root, stride, &mut self.gain, stride);
        // D = (1 − G F) P (1 − G F)ᵀ + G Q Gᵀ, which is P − G F P without a difference.
        rest.copy_from_slice(&self.gain);
        model.carry_back_sensors(memory, rest, stride);
        noise.fill(0.0);
        model.noise_rows(memory, dt, noise, stride);
        driven.fill(0.0);
        for (driven, row) in driven.chunks_exact_mut(stride).zip(noise.chunks_exact(stride)) {
            // Rows of G have a few entries each.
            for (x, gain) in row.iter().zip(rest.chunks_exact(stride)).filter(|(x, _)| **x != 0.0) {
                linear::add_scaled(driven, *x, gain);
            }
        }
        model.carry_back_process(memory, rest, stride, dt);
        for (i, row) in rest.chunks_exact_mut(stride).enumerate().take(n) {
            row.iter_mut().for_each(|x| *x = -*x);
            row[i] += 1.0;
        }
        self.own.columns.copy_from_slice(&before.columns);
        let spread = &mut self.own.covariance;
        spread.data.fill(0.0);
        linear::product(&before.covariance.data, stride, rest, stride, root);
        linear::add_symmetric(rest, root, stride, &mut spread.data);
        spread.add_squares(1.0, driven);
    }

    /// What `later` says of the earlier state.
    pub(super) fn apply(&self, later: &Belief, scratch: &mut RegressionRoom, earlier: &mut Belief) {
        let stride = later.covariance.stride;
        let RegressionRoom { root: product, moved, .. } = scratch;
        earlier.copy_from(&self.own);
        // m + G (z − r), for the mean and its sensitivities alike.
        for ((moved, z), r) in moved.iter_mut().zip(&later.columns).zip(&self.reference) {
            *moved = z - r;
        }
        linear::add_outer(1.0, (&self.gain, stride), moved, later.width, &mut earlier.columns);
        // D + G P Gᵀ.
        linear::product(&later.covariance.data, stride, &self.gain, stride, product);
        linear::add_symmetric(&self.gain, product, stride, &mut earlier.covariance.data);
    }

    /// The regression over this step and `then` the one after it.
    pub(super) fn join(&self, then: &Self, scratch: &mut RegressionRoom, whole: &mut Self) {
        let stride = self.own.covariance.stride;
        self.apply(&then.own, scratch, &mut whole.own);
        linear::product(&then.gain, stride, &self.gain, stride, &mut whole.gain);
        whole.reference.copy_from_slice(&then.reference);
    }
}
