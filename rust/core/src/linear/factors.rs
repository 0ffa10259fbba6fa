//! Triangular factors of matrices with padded rows, and solutions by them.
//!
//! All have a multiple of four rows. A zero on the diagonal of a factor stands for a row of zeros in a solution: padding, or
//! what depends on the rows before it.

use super::LANES;
use super::block::{
    Any, Block, Lane, WIDE, Width, accumulate, add, by_columns, by_width, inside, kernel, outer_block, product_block,
};
use crate::simd;
use core::hint::black_box;

/// X of Uᵀ X = B, in place: `upper` has rows of `size` numbers, what is below its diagonal is not looked at; B has as many rows
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

kernel!(Forward<'_>, |self, MOST| by_width!(self.stride, |width| self.run_with::<MOST>(width)));

impl Forward<'_> {
    #[inline(always)]
    fn run_with<const MOST: usize>(self, width: impl Width) {
        let Self { upper, size, b, stride } = self;
        let tall = Any(size / LANES);
        for r in 0..b.len() / (LANES * stride) {
            let i = r * LANES;
            let (done, own) = b.split_at_mut(i * stride);
            let above = (tall, tall.rows(upper, i + LANES));
            let triangle: [Lane; LANES] = core::array::from_fn(|s| tall.row(above.1, i + s)[r]);
            let inverse = core::array::from_fn(|s| inverse(triangle[s][s]));
            let done = (width, width.rows(done, i));
            by_columns!(MOST, 0, width.registers(), |c, W| {
                let sums = outer_block::<W, _, _>(above, done, r, c);
                substitute(&sums, (&triangle, &inverse), width.block_mut(own, 0), inside::<W>(width, c));
            });
        }
    }
}

/// 1/x, or 0 where there is none.
#[inline(always)]
fn inverse(x: f64) -> f64 {
    if x == 0.0 { 0.0 } else { 1.0 / x }
}

/// Four rows of X of Uᵀ X = B from register `c` on, by those of B, less `sums`, by the triangle that U has there, and what to
/// multiply by in place of dividing by its diagonal.
#[inline(always)]
fn substitute<const W: usize>(
    sums: &Block<LANES, W>,
    (triangle, inverse): (&[Lane; LANES], &[f64; LANES]),
    own: [&mut [Lane]; LANES],
    c: usize,
) {
    for w in 0..W {
        let mut x = [[0.0; LANES]; LANES];
        for l in 0..LANES {
            let whole = own[l][c + w];
            for k in 0..LANES {
                x[l][k] = whole[k] - sums[l][w][k];
            }
            for s in 0..l {
                let above = x[s];
                accumulate(&mut x[l], -triangle[s][l], &above);
            }
            for k in 0..LANES {
                x[l][k] *= inverse[l];
            }
            own[l][c + w] = x[l];
        }
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

kernel!(Backward<'_>, |self, MOST| self.run_with::<MOST>());

impl Backward<'_> {
    #[inline(always)]
    fn run_with<const MOST: usize>(self) {
        let Self { upper, size, b, stride } = self;
        let (rows, width) = (b.len() / stride, Any(stride / LANES));
        for i in (0..rows).step_by(LANES).rev() {
            let (own, done) = b.split_at_mut((i + LANES) * stride);
            let (own, below) = (&mut own[i * stride..], rows - i - LANES);
            let factors = core::array::from_fn(|l| &upper[(i + l) * size + i + LANES..][..below]);
            let done = (width, width.rows(done, below));
            by_columns!(MOST, 0, width.registers(), |c, W| {
                let sums = product_block::<LANES, W, _>(factors, done, below, c);
                add(-1.0, &sums, width.block_mut(own, 0), c);
            });
            for r in (0..LANES).rev() {
                let (own, after) = own[r * stride..].split_at_mut(stride);
                let factors = &upper[(i + r) * size + i + r..][..LANES - r];
                for (row, factor) in after.chunks_exact(stride).zip(&factors[1..]) {
                    super::add_scaled(own, -factor, row);
                }
                let inverse = inverse(factors[0]);
                own.iter_mut().for_each(|x| *x *= inverse);
            }
        }
    }
}

/// U of A = Uᵀ U over A's upper triangle, zero below the diagonal, for A of `n` rows, and padding, of `stride`; and U⁻ᵀ B of
/// what B follows it in its rows.
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

kernel!(UpperFactor<'_>, |self, MOST| by_width!(self.stride, |width| self.run_with::<MOST>(width)));

impl UpperFactor<'_> {
    #[inline(always)]
    fn run_with<const MOST: usize>(self, width: impl Width) {
        let Self { a, n, stride } = self;
        // A pivot that is smaller than this part of what it was is rounding: the row depends on those above it.
        let lost = (n as f64) * f64::EPSILON;
        for r in 0..a.len() / (LANES * stride) {
            let i = r * LANES;
            let (done, own) = a.split_at_mut(i * stride);
            let done = (width, width.rows(done, i));
            // That both sides are the same rows is not for the compiler to know: it would compute each sum once, and shuffle.
            let sums = outer_block::<1, _, _>(done, done, black_box(r), r);
            let (triangle, scale) = pivots(&sums, width.block_mut(own, 0), inside::<1>(width, r), lost);
            by_columns!(MOST, r + 1, width.registers(), |c, W| {
                let sums = outer_block::<W, _, _>(done, done, r, c);
                substitute(&sums, (&triangle, &scale), width.block_mut(own, 0), inside::<W>(width, c));
            });
        }
    }
}

/// The rows of U in the block on the diagonal, which is that of A, in register `r`, less `sums`; and what they were multiplied
/// by.
#[inline(always)]
fn pivots(sums: &Block<LANES, 1>, own: [&mut [Lane]; LANES], r: usize, lost: f64) -> ([Lane; LANES], [f64; LANES]) {
    let (mut u, mut scale) = ([[0.0; LANES]; LANES], [0.0; LANES]);
    for l in 0..LANES {
        let whole = own[l][r];
        for k in 0..LANES {
            u[l][k] = whole[k] - sums[l][0][k];
        }
        for s in 0..l {
            let above = u[s];
            accumulate(&mut u[l], -above[l], &above);
        }
        let pivot = u[l][l];
        scale[l] = if pivot <= whole[l] * lost { 0.0 } else { 1.0 / pivot.sqrt() };
        for k in 0..LANES {
            u[l][k] = if k < l { 0.0 } else { u[l][k] * scale[l] };
        }
        own[l][..r].fill([0.0; LANES]);
        own[l][r] = u[l];
    }
    (u, scale)
}
