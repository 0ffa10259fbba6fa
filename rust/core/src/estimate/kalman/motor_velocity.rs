//! Motor velocity from the latest motor positions, for logs that have none.

/// Samples that a slope is fitted to.
const SAMPLES: usize = 8;
/// Samples over which their scatter about it is averaged.
const LASTING: f64 = 16.0;

/// The latest positions of some motors, and the slope of a parabola through them at the last one.
///
/// Causal: a filter gives the same live as over a recording.
#[derive(Clone, Debug)]
pub(super) struct MotorVelocity {
    /// How many.
    motors: usize,
    /// Times before the latest sample, and positions, the latest first.
    ages: [f64; SAMPLES],
    /// Positions at these ages (SAMPLES × motors), NaN where missing.
    positions: Vec<f64>,
    /// How many of them there are yet.
    count: usize,
    /// Mean squares of what is left of positions (motors), and samples that they are of.
    scatters: Vec<f64>,
    /// Samples that a parabola could be put through.
    taken: f64,
    /// Time since the latest positions, while samples without any pass.
    pending: f64,
}

impl MotorVelocity {
    pub(super) fn new(motors: usize) -> Self {
        Self {
            motors,
            ages: [0.0; SAMPLES],
            positions: vec![0.0; SAMPLES * motors],
            count: 0,
            scatters: vec![0.0; motors],
            taken: 0.0,
            pending: 0.0,
        }
    }

    /// Forgets all positions.
    pub(super) fn reset(&mut self) {
        (self.count, self.taken, self.pending) = (0, 0.0, 0.0);
        self.scatters.fill(0.0);
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
        if self.count > 3 {
            self.taken += 1.0;
        }
    }

    /// Writes the slope of each motor whose entry is NaN, and into `variances` how uncertain it is; it stays NaN while
    /// there are fewer than four positions.
    #[inline(always)]
    pub(super) fn fill(&mut self, velocities: &mut [f64], variances: &mut [f64]) {
        for (j, (velocity, variance)) in velocities.iter_mut().zip(variances).enumerate() {
            *variance = 0.0;
            if let Some((slope, more)) = velocity.is_nan().then(|| self.fit(j)).flatten() {
                (*velocity, *variance) = (slope, more);
            }
        }
    }

    /// Least squares of motor `j`'s positions on 1, s, s² with s the age over the oldest: the slope at age zero, and its
    /// variance by how far the positions were from their parabolas lately, be it for encoder steps or for jerk.
    #[inline(always)]
    fn fit(&mut self, j: usize) -> Option<(f64, f64)> {
        let span = self.ages[self.count.max(1) - 1];
        let there = |i: &usize| !self.positions[i * self.motors + j].is_nan();
        let first = (0..self.count).find(there)?;
        // Positions from the latest one, ages in the whole span: sums of powers that keep their digits.
        let from = self.positions[first * self.motors + j];
        let at = |i: usize| (self.ages[i] / span, self.positions[i * self.motors + j] - from);
        let (mut sums, mut right, mut square, mut count) = ([0.0; 5], [0.0; 3], 0.0, 0.0);
        for i in (first..self.count).filter(there) {
            let (s, y) = at(i);
            for (sum, power) in sums.iter_mut().zip([1.0, s, s * s, s * s * s, s * s * s * s]) {
                *sum += power;
            }
            for (sum, power) in right.iter_mut().zip([y, s * y, s * s * y]) {
                *sum += power;
            }
            (square, count) = (square + y * y, count + 1.0);
        }
        if count < 4.0 {
            return None;
        }
        let inverse = inverse(sums);
        let parabola = inverse.map(|row| row[0] * right[0] + row[1] * right[1] + row[2] * right[2]);
        // What is left about the parabola, over its degrees of freedom, is the variance of a position.
        let explained: f64 = parabola.iter().zip(right).map(|(c, r)| c * r).sum();
        let scatter = &mut self.scatters[j];
        *scatter += ((square - explained).max(0.0) / (count - 3.0) - *scatter) / self.taken.min(LASTING);
        // Age runs backwards in time.
        Some((-parabola[1] / span, *scatter * inverse[1][1] / (span * span)))
    }
}

/// Of the symmetric matrix whose anti-diagonals are `sums`, by cofactors.
#[inline(always)]
fn inverse([a, b, c, d, e]: [f64; 5]) -> [[f64; 3]; 3] {
    let (x, y, z) = (c * e - d * d, c * d - b * e, b * d - c * c);
    let determinant = a * x + b * y + c * z;
    let (u, v, w) = (a * e - c * c, b * c - a * d, a * c - b * b);
    [[x, y, z], [y, u, v], [z, v, w]].map(|row| row.map(|entry| entry / determinant))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_parabola_is_differentiated_exactly_at_uneven_times_though_some_are_missing() {
        let mut slope = MotorVelocity::new(1);
        let (mut t, at) = (0.0, |t: f64| 1.0 - 3.0 * t + 7.0 * t * t);
        for k in 0..20 {
            let dt = 1e-3 * (1.0 + 0.3 * f64::from(k % 7) / 7.0);
            t += dt;
            slope.push(dt, &[if k == 9 { f64::NAN } else { at(t) }]);
            let (mut velocity, mut variance) = ([f64::NAN], [f64::NAN]);
            slope.fill(&mut velocity, &mut variance);
            if k >= 3 && k != 9 {
                assert!((velocity[0] - (-3.0 + 14.0 * t)).abs() < 1e-9, "{k} {velocity:?}");
                assert!(variance[0] < 1e-11, "{k} {variance:?}");
            }
        }
    }

    #[test]
    fn a_slope_is_as_uncertain_as_encoder_steps_make_it() {
        let (mut slope, step, dt) = (MotorVelocity::new(1), 1e-4, 1e-3);
        let (mut squares, mut variances) = (0.0, 0.0);
        for k in 0..4000 {
            let t = f64::from(k) * dt;
            slope.push(dt, &[((0.7 * t + 0.3 * t * t) / step).round() * step]);
            let (mut velocity, mut variance) = ([f64::NAN], [0.0]);
            slope.fill(&mut velocity, &mut variance);
            if k > 20 {
                squares += (velocity[0] - 0.7 - 0.6 * t).powi(2);
                variances += variance[0];
            }
        }
        let ratio: f64 = squares / variances;
        assert!((0.7..1.4).contains(&ratio), "{ratio}");
    }
}
