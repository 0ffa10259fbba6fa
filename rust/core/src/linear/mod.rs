//! Small dense matrices.
//!
//! Two families, for two sizes of problem. Filters have matrices of tens of rows in `f64`: padded rows, blocks of rows
//! that share what is loaded, no allocation, and one order of summation on every processor ([`products`], [`factors`]). Dynamics have
//! matrices of a few rows in any scalar: plain loops, so that the same text serves derivative numbers and lanes
//! ([`factorise`], [`solve`]).

mod block;
mod downdate;
mod factors;
mod products;
#[cfg(test)]
mod tests;

pub(crate) use downdate::{downdate, downdate_rest};
pub(crate) use factors::{backward, forward, upper_factor};
pub(crate) use products::{
    Part, add_outer, add_squares, add_symmetric, add_symmetric_part, congruence, mirror, product, product_part,
    product_upper, transpose,
};

use crate::scalar::Scalar;
use core::ops::{Add, AddAssign, Mul, MulAssign};

/// Columns that one vector register holds, and to a multiple of which rows are padded.
pub(crate) const LANES: usize = 4;

/// A number of double or of single precision.
pub(crate) trait Real: Copy + Default + Add<Output = Self> + AddAssign + Mul<Output = Self> + MulAssign {
    /// To its precision.
    fn of(value: f64) -> Self;
}

impl Real for f64 {
    #[inline(always)]
    fn of(value: f64) -> Self {
        value
    }
}

impl Real for f32 {
    #[inline(always)]
    fn of(value: f64) -> Self {
        value as Self
    }
}

/// Σ aᵢ bᵢ over the shorter of the two, in [`LANES`] partial sums.
#[inline(always)]
pub(crate) fn dot(a: &[f64], b: &[f64]) -> f64 {
    let n = a.len().min(b.len());
    let (a, b) = (&a[..n], &b[..n]);
    let mut sums = [0.0; LANES];
    let ((quads, rest), (others, last)) = (a.as_chunks::<LANES>(), b.as_chunks::<LANES>());
    for (x, y) in quads.iter().zip(others) {
        for l in 0..LANES {
            sums[l] += x[l] * y[l];
        }
    }
    let mut sum = (sums[0] + sums[1]) + (sums[2] + sums[3]);
    for (x, y) in rest.iter().zip(last) {
        sum += x * y;
    }
    sum
}

/// `y += factor · x`.
#[inline(always)]
pub(crate) fn add_scaled<T: Scalar>(y: &mut [T], factor: T, x: &[T]) {
    for (y, x) in y.iter_mut().zip(x) {
        *y += factor * *x;
    }
}

/// L and D of A = L D Lᵀ over A's lower triangle and diagonal, row-major n × n. Without square roots, for any scalar.
#[inline(always)]
pub(crate) fn factorise<T: Scalar>(a: &mut [T], n: usize) {
    for j in 0..n {
        for k in 0..j {
            let (l, d) = (a[j * n + k], a[k * n + k]);
            // Above the diagonal: L D of this row, which the rows below want.
            a[k * n + j] = l * d;
            let below = a[k * n + j];
            for i in j..n {
                let own = a[i * n + k];
                a[i * n + j] -= own * below;
            }
        }
        // Pivots are not exchanged: matrices here are positive definite, and an LDLᵀ of these is stable without.
        let inverse = T::constant(1.0) / a[j * n + j];
        for i in j + 1..n {
            a[i * n + j] = a[i * n + j] * inverse;
        }
    }
}

/// Does `$work` with a constant in place of `$n` up to seven, where loops of known length pay.
macro_rules! of_known_size {
    ($n:expr, |$known:ident| $work:expr) => {
        match $n {
            1 => of_known_size!(@ 1, $known, $work),
            2 => of_known_size!(@ 2, $known, $work),
            3 => of_known_size!(@ 3, $known, $work),
            4 => of_known_size!(@ 4, $known, $work),
            5 => of_known_size!(@ 5, $known, $work),
            6 => of_known_size!(@ 6, $known, $work),
            7 => of_known_size!(@ 7, $known, $work),
            $known => $work,
        }
    };
    (@ $size:literal, $known:ident, $work:expr) => {{
        let $known = $size;
        $work
    }};
}

/// [`factorise`] for a robot's joints.
#[inline(always)]
pub(crate) fn factorise_joints<T: Scalar>(a: &mut [T], n: usize) {
    if T::LANES {
        return factorise(a, n); // longer than its loops anyway
    }
    of_known_size!(n, |n| factorise(&mut a[..n * n], n));
}

/// [`solve`] for one number a joint.
#[inline(always)]
pub(crate) fn solve_joints<T: Scalar>(a: &[T], b: &mut [T]) {
    if T::LANES {
        return solve(a, b.len(), b, 1);
    }
    of_known_size!(b.len(), |n| solve(&a[..n * n], n, &mut b[..n], 1));
}

/// Whether the matrix that was [factorised](factorise) is positive definite.
#[inline(always)]
pub(crate) fn is_definite<T: Scalar>(a: &[T], n: usize) -> bool {
    a.iter().step_by(n + 1).all(|pivot| pivot.map(|p| f64::from(p > 0.0)) == T::constant(1.0))
}

/// L √D over L and D of [`factorise`], the factor of Cholesky.
#[inline(always)]
pub(crate) fn root<T: Scalar>(a: &mut [T], n: usize) {
    for j in 0..n {
        let pivot = a[j * n + j].sqrt();
        for i in j + 1..n {
            a[i * n + j] = a[i * n + j] * pivot;
        }
        a[j * n + j] = pivot;
    }
}

/// L of A = L Lᵀ over A's lower triangle, zero above the diagonal, for n rows of `stride`.
///
/// A may be singular: a pivot that is lost to rounding leaves a column of zeros.
#[inline(always)]
pub(crate) fn cholesky(a: &mut [f64], n: usize, stride: usize) {
    for i in 0..n {
        let (done, own) = a.split_at_mut(i * stride);
        let own = &mut own[..stride];
        for (j, row) in done.chunks_exact(stride).enumerate() {
            let pivot = row[j];
            let rest = own[j] - dot(&own[..j], &row[..j]);
            own[j] = if pivot > 0.0 { rest / pivot } else { 0.0 };
        }
        let whole = own[i];
        let pivot = whole - dot(&own[..i], &own[..i]);
        // What is left of the diagonal is rounding: the row depends on those above it.
        own[i] = if pivot > whole * (n as f64) * f64::EPSILON { pivot.sqrt() } else { 0.0 };
        own[i + 1..].fill(0.0);
    }
}

/// X of L D Lᵀ X = B, in place, after [`factorise`]: B has n rows of `width`.
///
/// Row by row, all columns of B side by side, so that a wide B is as fast as it can be.
#[inline(always)]
pub(crate) fn solve<T: Scalar>(a: &[T], n: usize, b: &mut [T], width: usize) {
    let subtract = |own: &mut [T], row: &[T], factor: T| {
        for (x, y) in own.iter_mut().zip(row) {
            *x -= *y * factor;
        }
    };
    for i in 1..n {
        let (done, rest) = b.split_at_mut(i * width);
        for (k, row) in done.chunks_exact(width).enumerate() {
            subtract(&mut rest[..width], row, a[i * n + k]);
        }
    }
    for (i, row) in b.chunks_exact_mut(width).enumerate() {
        let inverse = T::constant(1.0) / a[i * n + i];
        for x in row {
            *x = *x * inverse;
        }
    }
    for i in (0..n).rev() {
        let (rest, done) = b.split_at_mut((i + 1) * width);
        for (k, row) in done.chunks_exact(width).enumerate() {
            subtract(&mut rest[i * width..], row, a[(i + 1 + k) * n + i]);
        }
    }
}
