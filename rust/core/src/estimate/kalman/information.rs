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
    /// What is in them: row, column, value.
    entries: Vec<(usize, usize, f64)>,
    /// Λ g of each row of noise, then what Λ loses by it.
    projections: Vec<f64>,
    /// U with Uᵀ U = P.
    root: Vec<f64>,
    /// Scratch: Uᵀ, zero above its diagonal, and some rows of U Λ, or (G Λ)ᵀ.
    turned: Vec<f64>,
    product: Vec<f64>,
    /// 1 + U Λ Uᵀ or 1 + G Λ Gᵀ, then its root.
    gram: Vec<f64>,
    /// C⁻ᵀ U, for some columns.
    solved: Vec<f64>,
}

impl Information {
    /// Of `states` and nothing.
    pub(super) fn none(states: usize) -> Self {
        let matrix = Symmetric::zeros(states);
        let square = || vec![0.0; matrix.stride * matrix.stride];
        Self {
            noise: square(),
            entries: Vec::with_capacity(matrix.stride * matrix.stride),
            projections: square(),
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

    /// Λ ← Λ + Σ hᵀh/r, one padded row h/√r for each reading.
    #[inline(always)]
    pub(super) fn learn(&mut self, rows: &[f64]) {
        self.matrix.add_squares(1.0, rows);
    }

    /// Λ ← (Λ⁻¹ + Gᵀ G)⁻¹ for the rows of G that are in `noise`, which are cleared.
    ///
    /// As a filter takes all its readings at once: Λ − (G Λ)ᵀ (1 + G Λ Gᵀ)⁻¹ G Λ, by the root C of the matrix in between.
    #[inline(always)]
    pub(super) fn blur(&mut self) {
        let Self { matrix, noise, entries, projections, product, gram, .. } = self;
        let Symmetric { n, stride, .. } = *matrix;
        let row = |i: usize| i * stride..(i + 1) * stride;
        projections.fill(0.0);
        gram.fill(0.0);
        // Rows of G have a few entries each: G Λ, and above the diagonal 1 + G (G Λ)ᵀ.
        entries.clear();
        for (c, g) in noise.chunks_exact(stride).enumerate().take(n) {
            entries.extend(g.iter().enumerate().filter(|(_, x)| **x != 0.0).map(|(k, x)| (c, k, *x)));
        }
        for &(c, k, x) in &*entries {
            linear::add_scaled(&mut projections[row(c)], x, &matrix.data[row(k)]);
        }
        linear::transpose(projections, stride, product);
        (0..n).for_each(|c| gram[c * stride + c] = 1.0);
        for &(c, k, x) in &*entries {
            linear::add_scaled(&mut gram[row(c)][c..], x, &product[row(k)][c..]);
        }
        linear::upper_factor(gram, n, stride);
        // Where noise is that much larger than what is known, the difference has no digits: row by row, by products.
        if (0..n).any(|c| gram[c * stride + c].powi(2) > SHARP) {
            for g in noise.chunks_exact(stride).take(n) {
                let own = &mut projections[..stride];
                for (own, row) in own.iter_mut().zip(matrix.data.chunks_exact(stride)) {
                    *own = linear::dot(row, g);
                }
                let variance = 1.0 + linear::dot(g, own);
                matrix.condition(g, own, variance, 1.0);
            }
        } else {
            linear::forward(gram, stride, projections, stride);
            matrix.add_squares(-1.0, &projections[..n * stride]);
        }
        noise.fill(0.0);
    }

    /// The first `rows` rows and columns of (P⁻¹ + Λ)⁻¹ = Uᵀ (1 + U Λ Uᵀ)⁻¹ U into `out`, for P = Uᵀ U, which may be
    /// singular.
    #[inline(always)]
    pub(super) fn smooth(&mut self, predicted: &[f64], rows: usize, out: &mut [f64]) {
        let Self { matrix, root, turned, product, gram, solved, .. } = self;
        let Symmetric { n, stride, ref data } = *matrix;
        // A state without variance leaves a row of zeros and stays without.
        root[..n * stride].copy_from_slice(&predicted[..n * stride]);
        linear::upper_factor(root, n, stride);
        linear::congruence(root, data, stride, turned, product, gram);
        // 1 + U Λ Uᵀ has eigenvalues of 1 and more: its root C exists whatever P and Λ are.
        (0..n).for_each(|i| gram[i * stride + i] += 1.0);
        linear::upper_factor(gram, n, stride);
        // The Gram matrix of the columns of C⁻ᵀ U is positive by construction.
        let width = rows.next_multiple_of(linear::LANES);
        for (own, row) in solved.chunks_exact_mut(width).zip(root.chunks_exact(stride)) {
            own.copy_from_slice(&row[..width]);
        }
        let solved = &mut solved[..stride * width];
        linear::forward(gram, stride, solved, width);
        let gramian = &mut product[..width * width];
        gramian.fill(0.0);
        linear::add_squares(1.0, solved, width, gramian);
        for (out, row) in out.chunks_exact_mut(stride).zip(gramian.chunks_exact(width)).take(rows) {
            out[..rows].copy_from_slice(&row[..rows]);
        }
    }
}
