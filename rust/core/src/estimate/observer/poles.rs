//! Sets of poles that a real system can have.

use crate::error::DesignError;

/// A complex number, for poles.
pub type Complex = nalgebra::Complex<f64>;

/// Poles of one joint's error dynamics: stable, and closed under conjugation.
///
/// ```
/// use linkside_core::estimate::observer::{Complex, Poles};
/// let pair = [Complex::new(-3.0, 4.0), Complex::new(-3.0, -4.0)];
/// assert_eq!(Poles::new(0, &pair, 2)?.polynomial(), [25.0, 6.0, 1.0]); // s² + 6 s + 25
/// assert!(Poles::new(0, &pair[..1], 1).is_err()); // half a pair is no real system
/// # Ok::<(), linkside_core::error::DesignError>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Poles {
    /// Those on the real axis.
    real: Vec<f64>,
    /// One of each pair, the one with positive imaginary part.
    pairs: Vec<Complex>,
}

/// Poles whose imaginary parts differ by less than this, relative to their magnitude, count as conjugate.
const SAME: f64 = 1e-9;

impl Poles {
    /// Checks and sorts the `poles` [1/s] of joint `joint`, of which `expected` are needed.
    ///
    /// # Errors
    /// A wrong number, a real part that is not negative, a complex pole without its conjugate.
    pub fn new(joint: usize, poles: &[Complex], expected: usize) -> Result<Self, DesignError> {
        let found = poles.len();
        if found != expected {
            return Err(DesignError::PoleCount { joint, found, expected });
        }
        for Complex { re, im } in poles.iter().copied() {
            if re.is_nan() || re >= 0.0 || !re.is_finite() || !im.is_finite() {
                return Err(DesignError::UnstablePole { joint, re, im });
            }
        }
        let is_real = |p: &Complex| p.im.abs() <= SAME * p.norm();
        let (real, complex): (Vec<_>, Vec<_>) = poles.iter().copied().partition(is_real);
        let (pairs, mut mirrored): (Vec<_>, Vec<_>) = complex.into_iter().partition(|p| p.im > 0.0);
        for p in &pairs {
            let twin = mirrored.iter().position(|m| (m.conj() - p).norm() <= SAME * p.norm());
            let twin = twin.ok_or(DesignError::UnpairedPole { joint, re: p.re, im: p.im })?;
            mirrored.swap_remove(twin);
        }
        if let Some(p) = mirrored.first() {
            return Err(DesignError::UnpairedPole { joint, re: p.re, im: p.im });
        }
        Ok(Self { real: real.iter().map(|p| p.re).collect(), pairs })
    }

    /// The largest magnitude [rad/s].
    pub fn fastest(&self) -> f64 {
        self.pairs.iter().map(|p| p.norm()).chain(self.real.iter().map(|r| r.abs())).fold(0.0, f64::max)
    }

    /// Each pole λ mapped by `f`, which commutes with conjugation.
    pub(super) fn map(&self, f: impl Fn(Complex) -> Complex) -> Self {
        let real = self.real.iter().map(|&r| f(Complex::new(r, 0.0)).re).collect();
        Self { real, pairs: self.pairs.iter().map(|&p| f(p)).collect() }
    }

    /// Real factors of the monic polynomial with these roots: `[c0, 1, 0]` for s + c0, `[c0, c1, 1]` for s² + c1 s + c0.
    pub(super) fn factors(&self) -> impl Iterator<Item = [f64; 3]> + '_ {
        let single = self.real.iter().map(|&r| [-r, 1.0, 0.0]);
        single.chain(self.pairs.iter().map(|p| [p.norm_sqr(), -2.0 * p.re, 1.0]))
    }

    /// Coefficients of the monic polynomial with these roots, the constant one first, the leading 1 last.
    pub fn polynomial(&self) -> Vec<f64> {
        self.factors().fold(vec![1.0], |product, factor| {
            let degree = if factor[2] == 0.0 { 1 } else { 2 };
            let mut next = vec![0.0; product.len() + degree];
            for (i, a) in product.iter().enumerate() {
                for (j, b) in factor.iter().take(degree + 1).enumerate() {
                    next[i + j] += a * b;
                }
            }
            next
        })
    }
}
