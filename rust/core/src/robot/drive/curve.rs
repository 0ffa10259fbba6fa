//! Springs as a data sheet or a test bench has them.

use crate::check::expect_of;
use crate::error::RobotError;
use crate::scalar::Scalar;

/// Torque over torsion through given points: straight lines, or a cubic spline that rises as they do; straight beyond them.
///
/// ```
/// use linkside_core::robot::{Interpolation, SpringCurve};
/// // One half of a harmonic drive's curve, soft at first: 10 N m at 1 mrad, 60 at 3.
/// let curve = SpringCurve::new(&[[1e-3, 10.0], [3e-3, 60.0]], Interpolation::Monotone)?;
/// assert!((curve.torque(-3e-3_f64) + 60.0).abs() < 1e-9); // odd
/// assert!(curve.slope(5e-4_f64) < curve.slope(3e-3_f64));
/// # Ok::<(), linkside_core::error::RobotError>(())
/// ```
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SpringCurve {
    /// In the order of torsion: the line before the first point, a piece from each point to the next, the line after the last.
    pieces: Vec<Piece>,
}

/// τ + c₀ x + c₁ x² + c₂ x³, x = δ − start.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Piece {
    /// Below it begins the piece before.
    from: f64,
    /// Where x is zero [rad], and the torque there [N m].
    start: f64,
    torque: f64,
    /// c₀, c₁ and c₂.
    rates: [f64; 3],
    /// Up to the start [J].
    energy: f64,
}

/// How a [`SpringCurve`] goes from point to point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Interpolation {
    /// Straight.
    Linear,
    /// By cubics of slopes that keep them rising (Fritsch and Butland 1984).
    Monotone,
}

/// Slopes at a point are at most this many times that of either neighbouring chord: cubics then rise by a quarter of it at
/// least, where three times would let them stand still (Fritsch and Carlson 1980).
const STEEPEST: f64 = 2.5;
/// And at the ends at least this part of it.
const FLATTEST: f64 = 0.25;

impl SpringCurve {
    /// The curve through `points` of torsion [rad] and torque [N m]. Where none is negative they are one half of an odd curve;
    /// else (0, 0) is among them.
    ///
    /// # Errors
    /// Less than two points, numbers that are not finite, torsions or torques that do not rise, a curve that misses (0, 0).
    pub fn new(points: &[[f64; 2]], interpolation: Interpolation) -> Result<Self, RobotError> {
        let check = |bad: Option<f64>, expected| {
            let owner = || "the points of a spring".to_string();
            expect_of(bad.is_none(), "torque over torsion", owner, bad.unwrap_or_default(), expected)
        };
        let mut all: Vec<[f64; 2]> = points.to_vec();
        if points.iter().all(|p| p[0] >= 0.0) {
            all.retain(|p| *p != [0.0, 0.0]);
            let mirrored: Vec<_> = all.iter().rev().map(|p| [-p[0], -p[1]]).collect();
            all = [mirrored, vec![[0.0, 0.0]], all].concat();
        }
        check(all.iter().flatten().copied().find(|x| !x.is_finite()), "finite numbers")?;
        let few = all.len() < 3 || !all.contains(&[0.0, 0.0]);
        check(few.then_some(all.len() as f64), "two points or more, torque 0 at torsion 0")?;
        let falling = all.windows(2).find(|p| p[1][0] <= p[0][0] || p[1][1] <= p[0][1]);
        check(falling.map(|p| p[1][1]), "rising in both")?;
        Ok(Self::through(&all, interpolation))
    }

    /// The pieces between points that have been checked.
    fn through(points: &[[f64; 2]], interpolation: Interpolation) -> Self {
        let last = points.len() - 1;
        let chord = |i: usize| (points[i + 1][1] - points[i][1]) / (points[i + 1][0] - points[i][0]);
        let line = |from: f64, [start, torque]: [f64; 2], rate| Piece {
            from,
            start,
            torque,
            rates: [rate, 0.0, 0.0],
            energy: 0.0,
        };
        let ends = |i: usize| match interpolation {
            Interpolation::Linear => [chord(i), chord(i)],
            Interpolation::Monotone => [slope(points, i), slope(points, i + 1)],
        };
        let mut pieces = vec![line(f64::NEG_INFINITY, points[0], ends(0)[0])];
        for i in 0..last {
            let (width, chord, [a, b]) = (points[i + 1][0] - points[i][0], chord(i), ends(i));
            // Hermite's cubic by its slopes a and b at the ends.
            let rates = [a, (3.0 * chord - 2.0 * a - b) / width, (a + b - 2.0 * chord) / (width * width)];
            let [start, torque] = points[i];
            pieces.push(Piece { from: start, start, torque, rates, energy: 0.0 });
        }
        pieces.push(line(points[last][0], points[last], ends(last - 1)[1]));
        let mut curve = Self { pieces };
        curve.store();
        curve
    }

    /// Energies at the starts of all pieces, zero at rest.
    fn store(&mut self) {
        for i in 2..self.pieces.len() {
            self.pieces[i].energy = self.pieces[i - 1].energy(self.pieces[i].start);
        }
        self.pieces[0].energy = self.pieces[1].energy;
        let rest = self.energy(0.0);
        self.pieces.iter_mut().for_each(|piece| piece.energy -= rest);
    }

    /// Whether there is none: the spring is one of rates.
    #[inline(always)]
    pub fn is_none(&self) -> bool {
        self.pieces.is_empty()
    }

    /// The piece that a torsion is on.
    fn at(&self, torsion: f64) -> &Piece {
        let after = self.pieces.partition_point(|piece| piece.from <= torsion);
        &self.pieces[after.saturating_sub(1)]
    }

    /// What is known of the piece at a torsion, in each lane.
    #[inline(always)]
    fn piece<T: Scalar>(&self, torsion: T) -> (T, T, [T; 3]) {
        let of = |part: fn(&Piece) -> f64| torsion.map(|x| part(self.at(x)));
        let rates = [of(|p| p.rates[0]), of(|p| p.rates[1]), of(|p| p.rates[2])];
        (torsion - of(|p| p.start), of(|p| p.torque), rates)
    }

    /// Torque at torsion δ [rad] [N m].
    #[inline(always)]
    pub fn torque<T: Scalar>(&self, torsion: T) -> T {
        let (x, torque, [a, b, c]) = self.piece(torsion);
        torque + x * (a + x * (b + x * c))
    }

    /// Its slope there [N m/rad].
    #[inline(always)]
    pub fn slope<T: Scalar>(&self, torsion: T) -> T {
        let (x, _, [a, b, c]) = self.piece(torsion);
        a + x * (b * 2.0 + x * c * 3.0)
    }

    /// Torsion at which the spring holds `torque` [N m] [rad]: Newton's method on the piece, bisection where it leaves it.
    pub fn torsion(&self, torque: f64) -> f64 {
        let first = self.pieces[1..].partition_point(|piece| piece.torque <= torque);
        let piece = &self.pieces[first];
        let end = self.pieces.get(first + 1).map_or(f64::INFINITY, |next| next.start);
        if first == 0 || piece.rates[1..] == [0.0; 2] {
            return piece.start + (torque - piece.torque) / piece.rates[0];
        }
        let (mut low, mut high) = (piece.start, end);
        let mut torsion = low + (torque - piece.torque) / (self.pieces[first + 1].torque - piece.torque) * (end - low);
        for _ in 0..100 {
            let excess = self.torque(torsion) - torque;
            if excess > 0.0 {
                high = torsion
            } else {
                low = torsion
            }
            let next = torsion - excess / self.slope(torsion);
            let next = if next > low && next < high { next } else { 0.5 * (low + high) };
            let settled = (next - torsion).abs() <= 1e-16 * torsion.abs();
            torsion = next;
            if settled {
                break;
            }
        }
        torsion
    }

    /// Energy at torsion δ [rad] [J].
    pub fn energy(&self, torsion: f64) -> f64 {
        self.at(torsion).energy(torsion)
    }

    /// The least slope [N m/rad]; positive.
    pub fn least_slope(&self) -> f64 {
        let widths = self.pieces.windows(2).map(|p| p[1].start - p[0].start).chain([0.0]);
        self.pieces.iter().zip(widths).map(|(piece, width)| piece.least_slope(width)).fold(f64::INFINITY, f64::min)
    }
}

impl Piece {
    fn energy(&self, torsion: f64) -> f64 {
        let (x, [a, b, c]) = (torsion - self.start, self.rates);
        self.energy + x * (self.torque + x * (a / 2.0 + x * (b / 3.0 + x * c / 4.0)))
    }

    fn least_slope(&self, width: f64) -> f64 {
        let [a, b, c] = self.rates;
        let slope = |x: f64| a + x * (2.0 * b + 3.0 * c * x);
        let ends = slope(0.0).min(slope(width));
        let lowest = -b / (3.0 * c);
        if c > 0.0 && lowest > 0.0 && lowest < width { ends.min(slope(lowest)) } else { ends }
    }
}

/// Slope of the rising spline at point `i`: the weighted harmonic mean of the chords beside it, at the ends that of the
/// parabola through three points.
fn slope(points: &[[f64; 2]], i: usize) -> f64 {
    let last = points.len() - 1;
    let width = |k: usize| points[k + 1][0] - points[k][0];
    let chord = |k: usize| (points[k + 1][1] - points[k][1]) / width(k);
    if i == 0 || i == last {
        let (near, far) = if i == 0 { (0, 1) } else { (last - 1, last - 2) };
        let (h, k) = (width(near), width(far));
        let parabola = ((2.0 * h + k) * chord(near) - h * chord(far)) / (h + k);
        return parabola.clamp(FLATTEST * chord(near), STEEPEST * chord(near));
    }
    let (before, after) = (width(i - 1), width(i));
    let (v, w) = (2.0 * after + before, after + 2.0 * before);
    let mean = (v + w) / (v / chord(i - 1) + w / chord(i));
    mean.min(STEEPEST * chord(i - 1)).min(STEEPEST * chord(i))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scalar::{Dual, Lanes};

    fn curves() -> [SpringCurve; 3] {
        let half = [[1e-3, 10.0], [3e-3, 45.0], [8e-3, 300.0]];
        let whole = [[-4e-3, -30.0], [-1e-3, -20.0], [0.0, 0.0], [2e-3, 10.0], [2.5e-3, 100.0]];
        [
            SpringCurve::new(&half, Interpolation::Linear).unwrap(),
            SpringCurve::new(&half, Interpolation::Monotone).unwrap(),
            SpringCurve::new(&whole, Interpolation::Monotone).unwrap(),
        ]
    }

    const TORSIONS: [f64; 9] = [-0.02, -4e-3, -2e-3, -1e-4, 0.0, 1e-3, 1.7e-3, 2.4e-3, 0.03];

    #[test]
    fn slope_inverse_and_energy_belong_to_the_law() {
        for curve in curves() {
            for x in TORSIONS {
                let near = |a: f64, b: f64| assert!((a - b).abs() <= 1e-10 * (1e-3 + b.abs()), "{x}: {a} {b}");
                let torque = curve.torque(Dual::<1>::variable(x, 0));
                near(torque.gradient[0], curve.slope(x));
                near(curve.torsion(torque.value), x);
                assert!(curve.slope(x) >= curve.least_slope() && curve.least_slope() > 0.0);
                assert_eq!(curve.torque(Lanes([x, 1e-3])).0[0], torque.value);
                let (n, mut sum) = (20_000, 0.0);
                let h = x / f64::from(n);
                for i in 0..n {
                    let at = h * f64::from(i);
                    sum += h / 6.0 * (curve.torque(at) + 4.0 * curve.torque(at + 0.5 * h) + curve.torque(at + h));
                }
                assert!((curve.energy(x) - sum).abs() <= 1e-6 * (1e-9 + sum), "{x}: {} {sum}", curve.energy(x));
            }
            assert!(curve.torque(0.0).abs() < 1e-12);
        }
    }

    #[test]
    fn halves_are_odd_and_pass_through_their_points() {
        for curve in &curves()[..2] {
            for (x, torque) in [(1e-3, 10.0), (3e-3, 45.0), (8e-3, 300.0)] {
                assert!((curve.torque(x) - torque).abs() < 1e-12 * torque);
                assert!((curve.torque(0.7 * x) + curve.torque(-0.7 * x)).abs() < 1e-12 * torque);
            }
        }
    }

    #[test]
    fn the_flattest_torsion_is_found() {
        for curve in curves() {
            let grid = (0..60_000).map(|i| curve.slope(-0.03 + 1e-6 * f64::from(i)));
            let least = grid.fold(f64::INFINITY, f64::min);
            assert!((curve.least_slope() - least).abs() < 1e-4 * least, "{} {least}", curve.least_slope());
        }
    }

    #[test]
    fn points_that_make_no_spring_are_refused() {
        let refused = |points: &[[f64; 2]]| SpringCurve::new(points, Interpolation::Monotone).unwrap_err().to_string();
        assert!(refused(&[]).contains("two points or more"));
        assert!(refused(&[[-1.0, -1.0], [1.0, 1.0], [2.0, 2.0]]).contains("torque 0 at torsion 0"));
        assert!(refused(&[[1.0, 2.0], [2.0, 1.0]]).contains("rising in both"));
        assert!(refused(&[[1.0, f64::NAN]]).contains("finite numbers"));
    }
}
