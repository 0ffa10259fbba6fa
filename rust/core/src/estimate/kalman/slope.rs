//! Motor velocity from the latest motor positions, for logs that have none.

/// Samples that a slope is fitted to.
const SAMPLES: usize = 8;

/// The latest positions of some motors, and the slope of a parabola through them at the last one.
///
/// Causal: a filter gives the same live as over a recording.
#[derive(Clone, Debug)]
pub(super) struct Slope {
    motors: usize,
    /// Times before the latest sample, and positions, the latest first.
    ages: [f64; SAMPLES],
    positions: Vec<f64>,
    count: usize,
    /// Time since the latest positions, while samples without any pass.
    pending: f64,
}

impl Slope {
    pub(super) fn new(motors: usize) -> Self {
        Self { motors, ages: [0.0; SAMPLES], positions: vec![0.0; SAMPLES * motors], count: 0, pending: 0.0 }
    }

    pub(super) fn reset(&mut self) {
        (self.count, self.pending) = (0, 0.0);
    }

    /// Takes positions that came `dt` after the last ones.
    #[inline(always)]
    pub(super) fn push(&mut self, dt: f64, positions: &[f64]) {
        let n = self.motors;
        if positions.iter().all(|p| p.is_nan()) {
            self.pending += dt;
            return;
        }
        self.positions.copy_within(..(SAMPLES - 1) * n, n);
        self.positions[..n].copy_from_slice(positions);
        for i in (1..SAMPLES).rev() {
            self.ages[i] = self.ages[i - 1] + self.pending + dt;
        }
        self.pending = 0.0;
        self.count = (self.count + 1).min(SAMPLES);
    }

    /// Writes the slope of each motor whose entry is NaN; it stays NaN while there are too few positions, or one is missing.
    #[inline(always)]
    pub(super) fn fill(&self, velocities: &mut [f64]) {
        if self.count < 4 || !velocities.iter().any(|v| v.is_nan()) {
            return;
        }
        let weights = self.weights();
        for (j, velocity) in velocities.iter_mut().enumerate().filter(|(_, v)| v.is_nan()) {
            *velocity = (0..self.count).map(|i| weights[i] * self.positions[i * self.motors + j]).sum();
        }
    }

    /// Least squares on 1, s, s² with s the age over the oldest: the weights of the first derivative at age zero.
    #[inline(always)]
    fn weights(&self) -> [f64; SAMPLES] {
        let span = self.ages[self.count - 1];
        let powers = |i: usize| {
            let s = self.ages[i] / span;
            [1.0, s, s * s]
        };
        let mut m = [[0.0; 3]; 3];
        for i in 0..self.count {
            let p = powers(i);
            for a in 0..3 {
                for b in 0..3 {
                    m[a][b] += p[a] * p[b];
                }
            }
        }
        // The second row of the inverse, by cofactors.
        let [a, b, c] = m;
        let cofactors = [b[2] * c[0] - b[0] * c[2], a[0] * c[2] - a[2] * c[0], a[2] * b[0] - a[0] * b[2]];
        let determinant = m[0][1] * cofactors[0] + m[1][1] * cofactors[1] + m[2][1] * cofactors[2];
        // Age runs backwards in time.
        core::array::from_fn(|i| {
            let p = powers(i.min(self.count - 1));
            -(cofactors[0] * p[0] + cofactors[1] * p[1] + cofactors[2] * p[2]) / (determinant * span)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_parabola_is_differentiated_exactly_at_uneven_times() {
        let mut slope = Slope::new(1);
        let (mut t, at) = (0.0, |t: f64| 1.0 - 3.0 * t + 7.0 * t * t);
        for k in 0..20 {
            let dt = 1e-3 * (1.0 + 0.3 * f64::from(k % 7) / 7.0);
            t += dt;
            slope.push(dt, &[at(t)]);
            let mut velocity = [f64::NAN];
            slope.fill(&mut velocity);
            if k >= 3 {
                assert!((velocity[0] - (-3.0 + 14.0 * t)).abs() < 1e-9, "{k} {velocity:?}");
            }
        }
    }
}
