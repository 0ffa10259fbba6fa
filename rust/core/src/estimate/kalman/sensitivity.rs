//! Effect on the state of errors that a filter does not estimate: columns that are propagated with it.

use super::correction::{Correction, observe};
use super::model::Model;
use crate::linear;

/// Σ = ∂(x − x̂)/∂e for errors e that last, and what they do to the innovations.
///
/// Predicted by the model's [`carry`](Model::carry), corrected by Σ = (1 − K H) Σ⁻ − K N, N being what the errors do to the
/// readings themselves. As products of whole matrices, which keep sums in registers.
#[derive(Clone, Debug)]
pub(super) struct Sensitivity {
    /// Numbers between rows: errors, padded.
    pub(super) stride: usize,
    /// Σ (states × stride, padded).
    pub(super) columns: Vec<f64>,
    /// N before an update; after it s = U⁻ᵀ (H Σ⁻ + N), of each channel after those before it, in its standard deviations
    /// (channels × stride, padded).
    pub(super) signatures: Vec<f64>,
    /// H Σ⁻.
    products: Vec<f64>,
}

impl Sensitivity {
    /// To this many errors; zero.
    pub(super) fn new(model: &impl Model, errors: usize) -> Self {
        let stride = errors.next_multiple_of(linear::LANES);
        Self {
            stride,
            columns: vec![0.0; model.states().next_multiple_of(linear::LANES) * stride],
            signatures: vec![0.0; model.channels().next_multiple_of(linear::LANES) * stride],
            products: vec![0.0; model.channels() * stride],
        }
    }

    /// Through the update that `correction` has done.
    #[inline(always)]
    pub(super) fn update(&mut self, model: &impl Model, correction: &Correction) {
        let Self { stride: p, columns, signatures, products } = self;
        let (p, m) = (*p, correction.innovations.len());
        observe(model, columns, p, products);
        let rows = signatures.chunks_exact_mut(p).zip(products.chunks_exact(p));
        for ((own, product), innovation) in rows.zip(&correction.innovations) {
            if innovation.is_used() {
                linear::add_scaled(own, 1.0, product);
            } else {
                own.fill(0.0);
            }
        }
        linear::forward(correction.factor(), correction.width(), signatures, p);
        let (rows, width) = (correction.rows(), correction.rows().len() / m);
        linear::add_outer(-1.0, (rows, width), &signatures[..m * p], p, columns);
    }
}
