//! Channels one after the other, each by what those before it leave (scalar updates; Bierman 1977).

use super::super::gaussian::{Gaussian, Innovation, SHARP, Symmetric};
use super::super::model::Model;
use super::{Correction, row};
use crate::linear;

impl Correction {
    /// One channel after the other: with g = H P and s = g hᵀ + r of what those before it leave, W is g/√s and P loses Wᵀ W.
    ///
    /// In the same pass the next channel's g is found, of rows that channels depend on. The others lose all at the end: what
    /// g has of them is corrected by the W before. Where a reading tells far more than is known, the difference has no digits:
    /// from there on P is updated by Joseph's form.
    #[inline(always)]
    pub(super) fn use_each(&mut self, model: &impl Model, belief: &mut Gaussian, gate: Option<f64>) {
        let (m, d, stride) = (self.raw.len(), model.dense(), self.row.len());
        let mut joseph = self.sharp;
        self.change.fill(0.0);
        self.project_dense(model, belief, 0);
        for i in 0..m {
            if joseph {
                self.project_anew(model, belief, i);
            } else {
                self.project_bias(model, belief, i);
            }
            let (row, own) = (row(model, i), &self.rows[i * stride..][..stride]);
            let (known, value) = (row.dot(own), self.raw[i] - row.dot(&self.change));
            let variance = known + self.variances[i];
            self.gated[i] |= gate.is_some_and(|gate| value * value > gate * gate * variance);
            let open = !(value.is_nan() || self.gated[i]);
            if open && !joseph && known > SHARP * self.variances[i] {
                linear::downdate_rest(&mut belief.covariance.data, &self.rows[..i * stride], d, stride);
                joseph = true;
            }
            if open && joseph {
                self.load_row(model, i);
                let own = &self.rows[i * stride..][..stride];
                belief.covariance.condition(&self.row, own, variance, self.variances[i]);
            }
            let std = variance.sqrt();
            self.innovations[i] = match open {
                true if std.is_finite() => Innovation { value: value / std, std },
                true => Innovation { value: f64::NAN, std: 1.0 }, // which the likelihood shows
                false => Innovation::NONE,
            };
            self.settle(i);
            match joseph {
                true => (),
                false if open => self.downdate(model, belief, i),
                false => self.project_dense(model, belief, i + 1),
            }
        }
        if !joseph {
            linear::downdate_rest(&mut belief.covariance.data, self.rows(), d, stride);
        }
        self.write_factor(model);
    }

    /// H P of channel `i`, if there is one, of what it depends on beside its bias.
    #[inline(always)]
    fn project_dense(&mut self, model: &impl Model, belief: &Gaussian, i: usize) {
        let (d, Symmetric { stride, data, .. }) = (model.dense(), &belief.covariance);
        if i < self.raw.len() {
            linear::product(row(model, i).dense, d, data, *stride, &mut self.rows[i * stride..][..*stride]);
        }
    }

    /// The same of its bias, whose row of P is as it was before all channels.
    #[inline(always)]
    fn project_bias(&mut self, model: &impl Model, belief: &Gaussian, i: usize) {
        let Some(b) = model.biases()[i] else { return };
        let stride = self.row.len();
        let (before, own) = self.rows.split_at_mut(i * stride);
        linear::add_scaled(&mut own[..stride], 1.0, belief.covariance.row(b));
        for w in before.chunks_exact(stride) {
            linear::add_scaled(&mut own[..stride], -w[b], w);
        }
    }

    /// P without what channel `i` tells, and the next channel's H P.
    #[inline(always)]
    fn downdate(&mut self, model: &impl Model, belief: &mut Gaussian, i: usize) {
        let (last, stride) = (self.raw.len() - 1, self.row.len());
        let (before, after) = self.rows.split_at_mut((i + 1) * stride);
        let next = if i < last { &mut after[..stride] } else { &mut self.row };
        let dense = row(model, last.min(i + 1)).dense;
        linear::downdate(&mut belief.covariance.data, &before[i * stride..], dense, next);
    }

    /// Channel `i`'s row of W, and what it does to the mean.
    #[inline(always)]
    fn settle(&mut self, i: usize) {
        let (Innovation { value, std }, own) =
            (self.innovations[i], &mut self.rows[i * self.row.len()..][..self.row.len()]);
        let factor = 1.0 / std;
        if factor == 0.0 {
            return own.fill(0.0);
        }
        own.iter_mut().for_each(|g| *g *= factor);
        linear::add_scaled(&mut self.change, value, own);
    }

    /// U: what the rows of W share with those of H.
    #[inline(always)]
    fn write_factor(&mut self, model: &impl Model) {
        self.share(model);
        let (own, width) = (self.own(), self.width());
        let rows = self.factor.chunks_exact_mut(width).zip(self.shares.chunks_exact(own));
        for (j, (row, shares)) in rows.enumerate().take(self.raw.len()) {
            row[..own].copy_from_slice(shares);
            row[j] = if self.innovations[j].is_used() { self.innovations[j].std } else { 1.0 };
        }
        for i in (0..self.raw.len()).filter(|&i| !self.innovations[i].is_used()) {
            (0..i).for_each(|j| self.factor[j * width + i] = 0.0);
        }
    }

    /// Channel `i`'s row of H P, by the covariance as it is now.
    #[inline(always)]
    fn project_anew(&mut self, model: &impl Model, belief: &Gaussian, i: usize) {
        let Symmetric { stride, ref data, .. } = belief.covariance;
        self.load_row(model, i);
        for (x, column) in self.rows[i * stride..][..stride].iter_mut().zip(data.chunks_exact(stride)) {
            *x = linear::dot(column, &self.row);
        }
    }

    /// Channel `i`'s row of H.
    #[inline(always)]
    fn load_row(&mut self, model: &impl Model, i: usize) {
        let (d, own) = (model.dense(), &mut self.row);
        own.fill(0.0);
        own[..d].copy_from_slice(row(model, i).dense);
        if let Some(b) = model.biases()[i] {
            own[b] = 1.0;
        }
    }
}
