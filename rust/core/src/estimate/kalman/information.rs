//! What later readings say of a state: Fraser and Potter's (1969) backward filter, as an information matrix.
//!
//! Λ of the readings from a sample on is a sum of squares, and a step of time back is the update of a Kalman filter with
//! the noise's columns for rows. The smoothed covariance (P⁻¹ + Λ)⁻¹ then has no difference in it: it is positive, and
//! right to the digits of P and Λ even where P, after a long time without readings, is 10¹³ times as large. Bierman's
//! P − PΛ̂P is not there: Λ̂ = (P + Λ⁻¹)⁻¹ has lost what Λ says.

use super::gaussian::{SHARP, Symmetric};
use crate::linear;

/// Λ and the scratch of what is done with it.
///
/// A step back costs about two measurement updates of as many channels as the step's noise has directions.
#[derive(Clone, Debug)]
pub(super) struct Information {
    /// Λ (states × states).
    pub(super) matrix: Symmetric,
    /// Rows of the root of a step's noise, at most one a state (states, padded).
    pub(super) noise: Vec<f64>,
    /// Λ g of each row of noise over the root of its s, and half of that.
    projections: Vec<f64>,
    halves: Vec<f64>,
    /// S with S Sᵀ = P.
    root: Vec<f64>,
    /// Sᵀ, and Sᵀ Λ.
    turned: Vec<f64>,
    product: Vec<f64>,
    /// 1 + Sᵀ Λ S, then its root.
    gram: Vec<f64>,
    /// Rows of S C⁻ᵀ.
    solved: Vec<f64>,
}

impl Information {
    /// Of `states` and nothing.
    pub(super) fn none(states: usize) -> Self {
        let matrix = Symmetric::zeros(states);
        let square = || vec![0.0; matrix.stride * matrix.stride];
        Self {
            noise: square(),
            projections: square(),
            halves: square(),
            root: square(),
            turned: square(),
            product: square(),
            gram: square(),
            solved: square(),
            matrix,
        }
    }

    /// Forgets everything.
    pub(super) fn clear(&mut self) {
        self.matrix.data.fill(0.0);
    }

    /// Λ ← Σ hᵀh/r + Λ, one padded row h and one −h/2r of `halves` for each reading.
    #[inline(always)]
    pub(super) fn learn(&mut self, rows: &[f64], halves: &[f64]) {
        self.matrix.subtract_outer(rows, halves);
    }

    /// Λ ← (Λ⁻¹ + G Gᵀ)⁻¹ for the rows of Gᵀ that are in `noise`, which are cleared.
    ///
    /// As a filter takes readings: for one g, Λ − k mᵀ − m kᵀ with k = Λg/s, s = 1 + gᵀΛg and m = Λg − s k/2; Λ is touched
    /// once, and until then each Λg is corrected by those before it.
    #[inline(always)]
    pub(super) fn blur(&mut self) {
        let Self { matrix, noise, projections, halves, .. } = self;
        let Symmetric { n, stride, .. } = *matrix;
        let mut sharp = false;
        for c in 0..n {
            let g = &noise[c * stride..][..stride];
            let (before, own) = projections.split_at_mut(c * stride);
            let own = &mut own[..stride];
            own.fill(0.0);
            for (k, factor) in g.iter().enumerate().filter(|(_, x)| **x != 0.0) {
                linear::add_scaled(own, *factor, &matrix.data[k * stride..][..stride]);
            }
            // Rows before this one were left as they are over the root of their s.
            for earlier in before.chunks_exact(stride) {
                linear::add_scaled(own, -linear::dot(g, earlier), earlier);
            }
            let variance = 1.0 + linear::dot(g, own);
            sharp |= variance > SHARP;
            let scale = 1.0 / variance.sqrt();
            for (half, x) in halves[c * stride..][..stride].iter_mut().zip(own) {
                *x *= scale;
                *half = 0.5 * *x;
            }
        }
        if sharp {
            for g in noise.chunks_exact(stride).take(n) {
                let own = &mut projections[..stride];
                for (own, row) in own.iter_mut().zip(matrix.data.chunks_exact(stride)) {
                    *own = linear::dot(row, g);
                }
                let variance = 1.0 + linear::dot(g, own);
                matrix.condition(g, own, variance, 1.0);
            }
        } else {
            matrix.subtract_outer(&projections[..n * stride], &halves[..n * stride]);
        }
        noise.fill(0.0);
    }

    /// The first `rows` rows and columns of (P⁻¹ + Λ)⁻¹ = S (1 + Sᵀ Λ S)⁻¹ Sᵀ into `out`, for P = S Sᵀ, which may be
    /// singular.
    #[inline(always)]
    pub(super) fn smooth(&mut self, predicted: &[f64], rows: usize, out: &mut [f64]) {
        let Self { matrix, root, turned, product, gram, solved, .. } = self;
        let Symmetric { n, stride, ref data } = *matrix;
        // P = S Sᵀ; a state without variance leaves a column of zeros and stays without.
        root[..n * stride].copy_from_slice(&predicted[..n * stride]);
        linear::cholesky(root, n, stride);
        for i in 0..n {
            for k in 0..n {
                turned[i * stride + k] = root[k * stride + i];
            }
        }
        linear::product(&turned[..n * stride], stride, data, stride, product);
        linear::product(&product[..n * stride], stride, root, stride, gram);
        // 1 + Sᵀ Λ S has eigenvalues of 1 and more: its root exists whatever P and Λ are.
        for i in 0..n {
            gram[i * stride + i] += 1.0;
        }
        linear::cholesky(gram, n, stride);
        for r in 0..rows {
            // C y = Sᵀ e_r; then P̂ is the Gram matrix of these, positive by construction.
            let y = &mut solved[r * stride..][..stride];
            for i in 0..n {
                let known = linear::dot(&gram[i * stride..][..i], &y[..i]);
                y[i] = (root[r * stride + i] - known) / gram[i * stride + i];
            }
        }
        for r in 0..rows {
            for c in r..rows {
                let entry = linear::dot(&solved[r * stride..][..n], &solved[c * stride..][..n]);
                (out[r * stride + c], out[c * stride + r]) = (entry, entry);
            }
        }
    }
}
