//! Parameters that count, on a smoother's way back.

use super::consider::{Consider, Held, spread_of};
use super::gaussian::{Innovation, Symmetric};
use super::model::Model;
use crate::linear;

/// Σ⁻ and s at each sample of a stretch.
#[derive(Clone, Debug, Default)]
pub(super) struct ConsiderHistory {
    /// Σ⁻ (states × stride a sample, padded).
    columns: Vec<f64>,
    /// s (channels × stride a sample, padded).
    signatures: Vec<f64>,
    swings: Vec<f64>,
}

impl ConsiderHistory {
    /// After a sample's time update.
    pub(super) fn push_prediction(&mut self, consider: &Consider) {
        self.columns.extend_from_slice(&consider.sensitivity.columns);
    }

    /// After its measurement update.
    pub(super) fn push_update(&mut self, consider: &Consider) {
        self.signatures.extend_from_slice(&consider.sensitivity.signatures);
        self.swings.extend_from_slice(&consider.swings);
    }
}

/// How the adjoint state depends on the parameters: λ's own recursion, driven by s in place of the innovations.
///
/// The smoothed error's sensitivity is Σˢ = Σ⁻ + P⁻ ∂λ/∂p, since the smoothed state is x⁻ − P⁻λ.
#[derive(Clone, Debug)]
pub(super) struct ConsiderBack {
    /// Numbers between rows: parameters, padded.
    stride: usize,
    joints: usize,
    /// ∂λ/∂p (states × stride, padded).
    lambda: Vec<f64>,
    /// Σˢ of some states.
    columns: Vec<f64>,
    /// E[p pᵀ] by the whole recording.
    moment: Option<Symmetric>,
    /// Scratch: what each reading takes from ∂λ/∂p (channels × stride), and Σˢ E[p pᵀ].
    pulls: Vec<f64>,
    wide: Vec<f64>,
    /// Σˢ E[p pᵀ] Σˢᵀ of the first states.
    pub(super) total: Vec<f64>,
    held: Held,
}

impl ConsiderBack {
    pub(super) fn new(consider: &Consider, states: usize) -> Self {
        let room = || vec![0.0; consider.sensitivity.columns.len()];
        Self {
            stride: consider.sensitivity.stride,
            joints: consider.swings.len(),
            lambda: room(),
            columns: room(),
            moment: None,
            pulls: vec![0.0; consider.sensitivity.signatures.len()],
            wide: room(),
            total: vec![0.0; states * states],
            held: Held::new(consider.swings.len()),
        }
    }

    /// The next stretch is a recording's last.
    pub(super) fn finish(&mut self) {
        self.lambda.fill(0.0);
        self.held.reset();
        self.moment = None;
    }

    /// Takes what the filter knows of the parameters at the end of a stretch, unless a later stretch has said it.
    pub(super) fn learn(&mut self, consider: &Consider) {
        self.moment.get_or_insert_with(|| consider.moment().clone());
    }

    /// ∂λ/∂p from after sample `i`'s readings to before them: ← (1 − k h)ᵀ ∂λ/∂p − hᵀ s/√S, k being W/√S, the last reading first.
    #[inline(always)]
    pub(super) fn back(
        &mut self,
        history: &ConsiderHistory,
        i: usize,
        innovations: &[Innovation],
        rows: &[f64],
        corrections: &[f64],
    ) {
        let (p, m) = (self.stride, innovations.len());
        let width = rows.len() / m;
        // W ∂λ/∂p of all readings at once; each is then short of what the readings after it have taken.
        linear::product(corrections, width, &self.lambda, p, &mut self.pulls);
        for a in (0..m).rev().filter(|&a| innovations[a].is_used()) {
            let (before, after) = self.pulls.split_at_mut((a + 1) * p);
            let own = &mut before[a * p..];
            // In λ's recursion the innovation ν stands where s stands here: ∂ν/∂p = s as readings do not depend on p.
            let signature = &history.signatures[(i * m.next_multiple_of(linear::LANES) + a) * p..][..p];
            linear::add_scaled(own, 1.0, signature);
            for (later, row) in after.chunks_exact(p).zip(rows[(a + 1) * width..].chunks_exact(width)) {
                linear::add_scaled(own, -linear::dot(row, &corrections[a * width..][..width]), later);
            }
            own.iter_mut().for_each(|pull| *pull /= innovations[a].std);
        }
        linear::add_outer(-1.0, (rows, width), &self.pulls[..m * p], p, &mut self.lambda);
    }

    /// The parameters' share of the smoothed covariance of the first `rows` states at sample `i`, `predicted` being
    /// P⁻ in rows of `width`.
    #[inline(always)]
    pub(super) fn sum_up(
        &mut self,
        history: &ConsiderHistory,
        i: usize,
        predicted: &[f64],
        width: usize,
        rows: usize,
        dt: f64,
    ) {
        let (p, size) = (self.stride, self.lambda.len());
        let (states, n) = (size / p, self.joints);
        let most = rows.max(2 * n);
        let columns = &mut self.columns[..most * p];
        linear::product(&predicted[..most * width], width, &self.lambda[..states * p], p, columns);
        linear::add_scaled(columns, 1.0, &history.columns[i * size..]);
        if let Some(moment) = &self.moment {
            let swings = &history.swings[i * n..][..n];
            spread_of(&self.columns, swings, moment, rows, &mut self.wide, &mut self.total);
            self.held.raise(swings, dt, &mut self.total, rows);
        }
    }

    /// The adjoint of a step of time.
    #[inline(always)]
    pub(super) fn retreat(&mut self, model: &mut impl Model, memory: &[f64], dt: f64) {
        model.carry_back(memory, &mut self.lambda, self.stride, dt);
    }
}
