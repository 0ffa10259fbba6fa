//! Accelerations and biases for a given path of positions and velocities: a normal density, moved and corrected.
//!
//! n = (q, q̇) is drawn, l = (q̈, biases) is not (Schön, Gustafsson and Nordlund 2005). n ← F n + A l + noise with
//! A = (T²/2, T), and l ← l + noise, the [noise](super::motion) of a joint's three entries being one. Taken one joint after
//! the other, the measurements q̇₊ − q̇ = T q̈ + noise give n as a triangular map of standard normal numbers ζ without ever
//! forming n's covariance, whose positions hardly differ from T/2 times its velocities.

use super::output::packed;
use super::process_noise::ProcessNoise;
use crate::scalar::Scalar;

/// The covariance of l, and how l and n change with the numbers ζ (2n) by which n is drawn.
///
/// All of it for the particles of a group side by side, one a lane: nothing branches on a particle's numbers.
#[derive(Clone, Debug)]
pub(super) struct Conditional<T> {
    /// n, and the number of entries of l.
    joints: usize,
    size: usize,
    /// P, upper triangle by rows.
    pub(super) covariance: Vec<T>,
    /// ∂l/∂ζ, size × 2n.
    pub(super) slope: Vec<T>,
    /// ∂q̇/∂ζ of the second n numbers, n × n, lower triangular.
    velocity: Vec<T>,
    /// The last measurement's gain.
    pub(super) gain: Vec<T>,
}

/// How a reading depends on the state.
#[derive(Clone, Copy, Debug)]
pub(super) struct ReadingSlope<'a, T> {
    /// ∂h/∂(q, q̇, q̈) (3n).
    pub(super) links: &'a [T],
    /// Which entry of l adds to it.
    pub(super) bias: Option<usize>,
    /// ∂h/∂biases of a reading that depends on all of them; else empty.
    pub(super) biases: &'a [f64],
}

impl<T: Scalar> Conditional<T> {
    /// Of `size` entries, the first `joints` of which are accelerations.
    pub(super) fn new(joints: usize, size: usize) -> Self {
        let room = |size| vec![T::default(); size];
        Self {
            joints,
            size,
            covariance: room(size * (size + 1) / 2),
            slope: room(size * 2 * joints),
            velocity: room(joints * joints),
            gain: room(size),
        }
    }

    /// Takes over another one of the same size, but for its gain.
    #[inline(always)]
    pub(super) fn copy_from(&mut self, other: &Self) {
        self.covariance.copy_from_slice(&other.covariance);
        self.slope.copy_from_slice(&other.slope);
        self.velocity.copy_from_slice(&other.velocity);
    }

    /// P ← F P Fᵀ + Q, biases alone decaying, less what is known when n is known, and how l then follows ζ.
    #[inline(always)]
    pub(super) fn follow(&mut self, motion: &ProcessNoise) {
        let (n, dt) = (self.joints, motion.dt);
        for (i, bias) in motion.biases.iter().enumerate() {
            self.scale(n + i, bias.decay);
            self.add_variance(n + i, bias.variance);
        }
        self.slope.fill(T::default());
        for (j, noise) in motion.joints.iter().enumerate() {
            for r in 0..self.size {
                self.gain[r] = self.at(r, j) * dt;
            }
            // The measurement q̇₊ − q̇ = T q̈ + noise: its variance T² P_jj + rest, its covariance with l in the gain;
            // the noise of q̈ that goes with it (`cross`) joins.
            let variance = self.gain[j] * dt + noise.rest;
            self.gain[j] += T::constant(noise.cross);
            self.add_variance(j, noise.gained);
            self.scale_gain(variance.map(|v| if v > 0.0 { 1.0 / v.sqrt() } else { 0.0 }));
            self.velocity[j * n + j] = variance.sqrt();
            for i in j + 1..n {
                self.velocity[i * n + j] = self.gain[i] * dt;
            }
            for (row, gain) in self.slope.chunks_exact_mut(2 * n).zip(&self.gain) {
                row[n + j] = *gain;
            }
            self.slope[j * 2 * n + j] = T::constant(noise.acceleration);
            self.remove_gain();
        }
    }

    /// `to` ← (n, l) of `from` moved by ζ, for a slope that nothing was [observed](Self::observe) with.
    #[inline(always)]
    pub(super) fn displace(&self, motion: &ProcessNoise, from: &[T], noise: &[T], to: &mut [T]) {
        let n = self.joints;
        let (own, moves) = noise.split_at(n);
        to.copy_from_slice(from);
        for (j, joint) in motion.joints.iter().enumerate() {
            let mut change = T::default();
            for (velocity, z) in self.velocity[j * n..=j * n + j].iter().zip(moves) {
                change += *velocity * *z;
            }
            to[j] += own[j] * joint.position + change * (0.5 * motion.dt);
            to[n + j] += own[j] * joint.velocity + change;
            to[2 * n + j] += own[j] * joint.acceleration;
        }
        for (entry, slope) in to[2 * n..].iter_mut().zip(self.slope.chunks_exact(2 * n)) {
            for (slope, z) in slope[n..].iter().zip(moves) {
                *entry += *slope * *z;
            }
        }
    }

    /// How a reading, by l's mean as it now is, changes with ζ.
    #[inline(always)]
    pub(super) fn by_noise(&self, motion: &ProcessNoise, row: ReadingSlope<'_, T>, out: &mut [T]) {
        let n = self.joints;
        let (q, dq) = (&row.links[..n], &row.links[n..2 * n]);
        for (j, joint) in motion.joints.iter().enumerate() {
            out[j] = q[j] * joint.position + dq[j] * joint.velocity;
            out[n + j] = T::default();
            for i in j..n {
                out[n + j] += (dq[i] + q[i] * (0.5 * motion.dt)) * self.velocity[i * n + j];
            }
        }
        let mut add = |factor: Option<T>, entry: usize| {
            for (out, slope) in out.iter_mut().zip(&self.slope[entry * 2 * n..][..2 * n]) {
                *out += factor.map_or(*slope, |f| *slope * f);
            }
        };
        for (j, h) in row.links[2 * n..].iter().enumerate() {
            add(Some(*h), j);
        }
        if let Some(bias) = row.bias {
            add(None, bias);
        }
        for (b, h) in row.biases.iter().enumerate() {
            add(Some(T::constant(*h)), n + b);
        }
    }

    /// Takes a reading h l + noise of `variance`: P ← P − K s Kᵀ; returns s, and leaves the gain K.
    #[inline(always)]
    pub(super) fn observe(&mut self, row: ReadingSlope<'_, T>, variance: f64) -> T {
        let by_ddq = &row.links[2 * self.joints..];
        for r in 0..self.size {
            let mut sum = row.bias.map_or(T::default(), |b| self.at(r, b));
            for (j, h) in by_ddq.iter().enumerate() {
                sum += self.at(r, j) * *h;
            }
            for (b, h) in row.biases.iter().enumerate() {
                sum += self.at(r, self.joints + b) * *h;
            }
            self.gain[r] = sum;
        }
        let mut total = row.bias.map_or(T::default(), |b| self.gain[b]) + variance;
        for (h, gain) in by_ddq.iter().zip(&self.gain) {
            total += *h * *gain;
        }
        for (h, gain) in row.biases.iter().zip(&self.gain[self.joints..]) {
            total += *gain * *h;
        }
        let inverse = (T::constant(1.0) / total).sqrt();
        self.scale_gain(inverse);
        self.remove_gain();
        self.scale_gain(inverse);
        total
    }

    /// What a reading that depends on ζ by `by_noise` does to the slope: the mean moves by K (ε − B ζ).
    #[inline(always)]
    pub(super) fn tilt(&mut self, by_noise: &[T]) {
        for (row, gain) in self.slope.chunks_exact_mut(by_noise.len()).zip(&self.gain) {
            for (slope, b) in row.iter_mut().zip(by_noise) {
                *slope -= *gain * *b;
            }
        }
    }

    /// The row and column of an entry times `factor`.
    #[inline(always)]
    fn scale(&mut self, entry: usize, factor: f64) {
        for other in 0..self.size {
            let at = packed(entry.min(other), entry.max(other), self.size);
            self.covariance[at] = self.covariance[at] * (if other == entry { factor * factor } else { factor });
        }
    }

    /// Independent noise of one entry.
    #[inline(always)]
    fn add_variance(&mut self, entry: usize, variance: f64) {
        let diagonal = packed(entry, entry, self.size);
        self.covariance[diagonal] += T::constant(variance);
    }

    /// Entry (r, c) of P, whichever triangle it is in.
    #[inline(always)]
    fn at(&self, r: usize, c: usize) -> T {
        self.covariance[packed(r.min(c), r.max(c), self.size)]
    }

    /// The gain times a number of each particle.
    #[inline(always)]
    fn scale_gain(&mut self, factor: T) {
        for gain in &mut self.gain {
            *gain = *gain * factor;
        }
    }

    /// P ← P − k kᵀ.
    #[inline(always)]
    fn remove_gain(&mut self) {
        let mut entries = self.covariance.iter_mut();
        for r in 0..self.size {
            for (c, entry) in (r..self.size).zip(&mut entries) {
                *entry -= self.gain[r] * self.gain[c];
            }
        }
    }
}

#[cfg(test)]
mod tests;
