//! Triangular factors of matrices with padded rows, and solutions by them.

use super::LANES;
use super::block::{BlockSums, ROWS, accumulate, by_columns, by_rows, lanes, outer_block, product_block};
use crate::simd::{self, Kernel};

/// X of Uᵀ X = B, in place: `upper` has n rows of `size` numbers, what is below its diagonal is not looked at; B has n rows
/// of `stride`.
pub(crate) fn forward(upper: &[f64], size: usize, b: &mut [f64], stride: usize) {
    simd::phase(Forward { upper, size, b, stride });
}

/// [`forward`], likewise.
struct Forward<'a> {
    upper: &'a [f64],
    size: usize,
    b: &'a mut [f64],
    stride: usize,
}

impl Kernel for Forward<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { upper, size, b, stride } = self;
        let rows = b.len() / stride;
        by_rows!(rows, |i, R| {
            by_columns!(0, stride / LANES, |c, W| forward_block::<R, W>(upper, size, b, stride, i, c));
        });
    }
}

/// Rows `i` to `i + R` of X, those above being done.
#[inline(always)]
fn forward_block<const R: usize, const W: usize>(
    upper: &[f64],
    size: usize,
    b: &mut [f64],
    stride: usize,
    i: usize,
    c: usize,
) {
    let (done, own) = b.split_at_mut(i * stride);
    let (done, step) = (lanes(done), stride / LANES);
    let mut sums = [[[0.0; LANES]; W]; R];
    for j in 0..i {
        let (row, factors) = (&done[j * step + c..][..W], &upper[j * size + i..][..R]);
        for r in 0..R {
            for w in 0..W {
                accumulate(&mut sums[r][w], factors[r], &row[w]);
            }
        }
    }
    sums.add(-1.0, own, stride, c, R);
    for r in 0..R {
        let (before, own) = own.split_at_mut(r * stride);
        let own = &mut own[c * LANES..][..W * LANES];
        for s in 0..r {
            super::add_scaled(own, -upper[(i + s) * size + i + r], &before[s * stride + c * LANES..][..W * LANES]);
        }
        let inverse = 1.0 / upper[(i + r) * size + i + r];
        own.iter_mut().for_each(|x| *x *= inverse);
    }
}

/// X of U X = B, otherwise as [`forward`].
pub(crate) fn backward(upper: &[f64], size: usize, b: &mut [f64], stride: usize) {
    simd::phase(Backward { upper, size, b, stride });
}

/// [`backward`], likewise.
struct Backward<'a> {
    upper: &'a [f64],
    size: usize,
    b: &'a mut [f64],
    stride: usize,
}

impl Kernel for Backward<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { upper, size, b, stride } = self;
        let mut end = b.len() / stride;
        while end >= ROWS {
            end -= ROWS;
            backward_block::<ROWS>(upper, size, b, stride, end);
        }
        while end > 0 {
            end -= 1;
            backward_block::<1>(upper, size, b, stride, end);
        }
    }
}

/// Rows `i` to `i + R` of X, those below being done.
#[inline(always)]
fn backward_block<const R: usize>(upper: &[f64], size: usize, b: &mut [f64], stride: usize, i: usize) {
    let (own, done) = b.split_at_mut((i + R) * stride);
    let (own, below) = (&mut own[i * stride..], done.len() / stride);
    if below > 0 {
        let factors = (&upper[i * size + i + R..], size);
        by_columns!(0, stride / LANES, |c, W| {
            product_block::<R, W>(factors, 0..below, done, stride, c).add(-1.0, own, stride, c, R);
        });
    }
    for r in (0..R).rev() {
        let (own, after) = own[r * stride..].split_at_mut(stride);
        for (s, row) in after.chunks_exact(stride).enumerate() {
            super::add_scaled(own, -upper[(i + r) * size + i + r + 1 + s], row);
        }
        let inverse = 1.0 / upper[(i + r) * size + i + r];
        own.iter_mut().for_each(|x| *x *= inverse);
    }
}

/// U of A = Uᵀ U over A's upper triangle, zero below the diagonal, for n rows of `stride`.
///
/// A may be singular: a pivot that is lost to rounding leaves a row of zeros.
pub(crate) fn upper_factor(a: &mut [f64], n: usize, stride: usize) {
    simd::phase(UpperFactor { a, n, stride });
}

/// [`upper_factor`], likewise.
struct UpperFactor<'a> {
    a: &'a mut [f64],
    n: usize,
    stride: usize,
}

impl Kernel for UpperFactor<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { a, n, stride } = self;
        for i in (0..n).step_by(LANES) {
            let rows = LANES.min(n - i);
            let (done, own) = a.split_at_mut(i * stride);
            let mut whole = [0.0; LANES];
            (0..rows).for_each(|r| whole[r] = own[r * stride + i + r]);
            by_columns!(i / LANES, stride / LANES, |c, W| {
                outer_block::<W>((done, stride), (done, stride), i, i / LANES, c).add(-1.0, own, stride, c, rows)
            });
            for r in 0..rows {
                let (before, own) = own.split_at_mut(r * stride);
                for s in 0..r {
                    let earlier = &before[s * stride..][i..stride];
                    super::add_scaled(&mut own[i..stride], -earlier[r], earlier);
                }
                let pivot = own[i + r];
                // What is left of the diagonal is rounding: the row depends on those above it.
                let lost = pivot <= whole[r] * (n as f64) * f64::EPSILON;
                let scale = if lost { 0.0 } else { 1.0 / pivot.sqrt() };
                own[..i + r].fill(0.0);
                own[i + r..stride].iter_mut().for_each(|x| *x *= scale);
            }
        }
    }
}
