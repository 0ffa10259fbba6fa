//! Products of matrices with padded rows. Where half of a matrix is zero, the inner loop leaves that half out.

use super::LANES;
use super::block::{BlockSums, Lane, ROWS, by_columns, by_rows, lanes, outer_block, product_block};
use crate::simd::{self, Kernel};

/// `out[i] = Σⱼ left[i][j] · right[j]`: `left` has rows of `width` numbers, of which the first meet the rows of `right`, each
/// of `stride`.
pub(crate) fn product(left: &[f64], width: usize, right: &[f64], stride: usize, out: &mut [f64]) {
    simd::phase(Product { left, width, right, stride, out });
}

/// [`product`], to be compiled for each instruction set.
struct Product<'a> {
    left: &'a [f64],
    width: usize,
    right: &'a [f64],
    stride: usize,
    out: &'a mut [f64],
}

impl Kernel for Product<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { left, width, right, stride, out } = self;
        let inner = width.min(right.len() / stride);
        by_rows!(left.len() / width, |i, R| {
            let left = (&left[i * width..], width);
            by_columns!(0, stride / LANES, |c, W| product_block::<R, W>(left, 0..inner, right, stride, c).put(
                &mut out[i * stride..],
                stride,
                c
            ));
        });
    }
}

/// `out += factor · Σᵢ aᵢ bᵢᵀ`: one row of `width` of `a` and of `stride` of `b` for each i; `out` has rows of `stride`.
pub(crate) fn add_outer(factor: f64, (a, width): (&[f64], usize), b: &[f64], stride: usize, out: &mut [f64]) {
    simd::phase(AddOuter { factor, a, width, b, stride, out });
}

/// [`add_outer`], likewise.
struct AddOuter<'a> {
    factor: f64,
    a: &'a [f64],
    width: usize,
    b: &'a [f64],
    stride: usize,
    out: &'a mut [f64],
}

impl Kernel for AddOuter<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { factor, a, width, b, stride, out } = self;
        let (rows, inner) = (out.len() / stride, b.len() / stride);
        for i in (0..rows).step_by(LANES) {
            let (out, count) = (&mut out[i * stride..], LANES.min(rows - i));
            by_columns!(0, stride / LANES, |c, W| outer_block::<W>((a, width), (b, stride), inner, i / LANES, c)
                .add(factor, out, stride, c, count));
        }
    }
}

/// `p += factor · Σᵢ aᵢ aᵢᵀ` on and above the diagonal, the lower triangle then copied from the upper.
///
/// `p` has `n` rows of `stride`, `a` one row of `stride` for each i.
pub(crate) fn add_squares(factor: f64, a: &[f64], n: usize, stride: usize, p: &mut [f64]) {
    simd::phase(AddSymmetric { factor, a, b: a, n, stride, p });
}

/// `p += Σᵢ aᵢ bᵢᵀ` where that sum is symmetric, otherwise as [`add_squares`].
pub(crate) fn add_symmetric(a: &[f64], b: &[f64], n: usize, stride: usize, p: &mut [f64]) {
    simd::phase(AddSymmetric { factor: 1.0, a, b, n, stride, p });
}

/// [`add_squares`] and [`add_symmetric`], likewise.
struct AddSymmetric<'a> {
    factor: f64,
    a: &'a [f64],
    b: &'a [f64],
    n: usize,
    stride: usize,
    p: &'a mut [f64],
}

impl Kernel for AddSymmetric<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { factor, a, b, n, stride, p } = self;
        let inner = a.len() / stride;
        for r in 0..stride / LANES {
            let (out, rows) = (&mut p[r * LANES * stride..], LANES.min(n - r * LANES));
            by_columns!(r, stride / LANES, |c, W| outer_block::<W>((a, stride), (b, stride), inner, r, c)
                .add(factor, out, stride, c, rows));
        }
        mirror(p, n, stride);
    }
}

/// Copies the upper triangle of n rows onto the lower.
#[inline(always)]
pub(crate) fn mirror(p: &mut [f64], n: usize, stride: usize) {
    let whole = n / LANES * LANES;
    for i in (0..whole).step_by(LANES) {
        // Block by block: four rows of a register each, turned.
        for j in (i + LANES..whole).step_by(LANES) {
            let rows: [Lane; LANES] = core::array::from_fn(|r| lanes(&p[(i + r) * stride + j..][..LANES])[0]);
            for k in 0..LANES {
                let turned: Lane = core::array::from_fn(|r| rows[r][k]);
                p[(j + k) * stride + i..][..LANES].copy_from_slice(&turned);
            }
        }
        for r in i..i + LANES {
            for c in r + 1..i + LANES {
                p[c * stride + r] = p[r * stride + c];
            }
        }
    }
    for j in whole..n {
        for i in 0..j {
            p[j * stride + i] = p[i * stride + j];
        }
    }
}

/// The upper triangle of U M Uᵀ into `out`, for upper U and whole M of n rows of `stride`; `turned` receives Uᵀ and
/// `scratch` some rows of U M.
pub(crate) fn congruence(
    upper: &[f64],
    matrix: &[f64],
    stride: usize,
    turned: &mut [f64],
    scratch: &mut [f64],
    out: &mut [f64],
) {
    simd::phase(Congruence { upper, matrix, stride, turned, scratch, out });
}

/// [`congruence`], likewise.
struct Congruence<'a> {
    upper: &'a [f64],
    matrix: &'a [f64],
    stride: usize,
    turned: &'a mut [f64],
    scratch: &'a mut [f64],
    out: &'a mut [f64],
}

impl Kernel for Congruence<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { upper, matrix, stride, turned, scratch, out } = self;
        let n = matrix.len() / stride;
        for (i, row) in upper.chunks_exact(stride).enumerate().take(n) {
            for (k, x) in row.iter().enumerate().take(n) {
                turned[k * stride + i] = *x;
            }
        }
        let step = stride / LANES;
        // Rows i and further of U begin at column i, and columns k and further of Uᵀ at row k.
        for i in (0..n).step_by(LANES) {
            let rows = LANES.min(n - i);
            let product = &mut scratch[..LANES * stride];
            by_columns!(0, step, |c, W| product_block::<ROWS, W>(
                (&upper[i * stride..], stride),
                i..n,
                matrix,
                stride,
                c
            )
            .put(product, stride, c));
            let out = &mut out[i * stride..];
            by_columns!(i / LANES, step, |c, W| {
                let block = product_block::<ROWS, W>((product, stride), c * LANES..n, turned, stride, c);
                for (row, sum) in out.chunks_exact_mut(stride).zip(&block).take(rows) {
                    row[c * LANES..][..W * LANES].copy_from_slice(sum.as_flattened());
                }
            });
        }
    }
}
