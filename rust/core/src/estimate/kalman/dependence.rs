//! Readings whose errors depend on each other, on a smoother's way back.
//!
//! A [regression on sigma points](super::sigma_points) leaves errors of covariance Ω, which is not diagonal, beside the readings'
//! own noise R. With R + Ω = L D Lᵀ, L of unit diagonal, the readings L⁻¹ y are independent, of rows L⁻¹ H and variances D. Used one
//! after the other they have the same gains and normalised innovations as the readings themselves used at once: both come
//! of one factor of S. So the adjoint of scalar updates (Bierman 1973) holds as it is, and the smoother is the
//! unscented or cubature one of S. Särkkä (IEEE Trans. Automatic Control 53, 2008), whose gain P Aᵀ (P⁻)⁻¹ has
//! the cross-covariance of consecutive states in A, the slope of the regression over the step.

use super::correction::Correction;
use super::model::Model;
use crate::error::DesignError;
use crate::linear;
use crate::memory::room;

/// L of each sample (channels × channels); empty where readings are linearised by derivatives.
#[derive(Clone, Debug)]
pub(super) struct DependenceHistory(Vec<f64>);

impl DependenceHistory {
    /// Numbers a sample.
    pub(super) fn size(model: &impl Model) -> usize {
        if model.has_points() { model.channels() * model.channels() } else { 0 }
    }

    pub(super) fn with_capacity(count: usize, model: &impl Model) -> Result<Self, DesignError> {
        Ok(Self(room(count, Self::size(model))?))
    }

    /// Keeps L after a sample's measurement update; the last of `variances`, which are R, become D.
    pub(super) fn push(&mut self, model: &impl Model, correction: &Correction, variances: &mut [f64]) {
        let Some(left) = model.residual() else { return };
        let m = model.channels();
        let (first, last) = (self.0.len(), variances.len() - m);
        self.0.resize(first + m * m, 0.0);
        if correction.sharp {
            return;
        }
        let (factor, d) = (&mut self.0[first..], &mut variances[last..]);
        let used = |i: usize| correction.innovations[i].is_used();
        for a in (0..m).filter(|&a| used(a)) {
            let mut more = left.at(a, a);
            for b in (0..a).filter(|&b| used(b)) {
                let shared: f64 = (0..b).map(|c| factor[a * m + c] * d[c] * factor[b * m + c]).sum();
                let share = left.at(a, b) - shared;
                factor[a * m + b] = share / d[b];
                more -= share * factor[a * m + b];
            }
            // Never below zero but for rounding: no combination of other readings knows a reading's own noise.
            d[a] += more.max(0.0);
        }
    }

    /// H ← L⁻¹ H of sample `i`, with `m` padded rows.
    #[inline(always)]
    pub(super) fn separate(&self, i: usize, m: usize, rows: &mut [f64]) {
        let Some(factor) = self.0.get(i * m * m..(i + 1) * m * m) else { return };
        let stride = rows.len() / m;
        for a in 1..m {
            let (before, own) = rows.split_at_mut(a * stride);
            for (share, row) in factor[a * m..].iter().zip(before.chunks_exact(stride)) {
                linear::add_scaled(&mut own[..stride], -share, row);
            }
        }
    }
}
