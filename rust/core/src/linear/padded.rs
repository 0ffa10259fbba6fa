//! Products and factors of matrices whose rows are padded to a multiple of [`LANES`], accumulated in registers.
//!
//! Everything is done by blocks of four rows and two vector registers: their sums stay in registers over the whole inner
//! loop, and four rows share each load. A filter's matrices fit into the nearest cache as they are: nothing is blocked
//! for one, and nothing is copied. Where half of a matrix is zero, the inner loop leaves that half out.

use super::LANES;
use crate::simd::{self, Kernel};
use core::ops::Range;

/// Rows that share what is loaded.
const ROWS: usize = LANES;

/// What one vector register holds.
type Lane = [f64; LANES];

/// The sums of a block: R rows by W registers.
type Block<const R: usize, const W: usize> = [[Lane; W]; R];

/// A padded row by registers.
#[inline(always)]
fn lanes(values: &[f64]) -> &[Lane] {
    values.as_chunks().0
}

/// `sum += a · b`, lane by lane.
#[inline(always)]
fn accumulate(sum: &mut Lane, a: f64, b: &Lane) {
    for l in 0..LANES {
        sum[l] += a * b[l];
    }
}

/// Calls `$body` with `$w` = 2 registers from `$c` on while there are two up to `$to`, then with one.
macro_rules! by_columns {
    ($from:expr, $to:expr, |$c:ident, $w:ident| $body:expr) => {
        let mut $c = $from;
        while $c + 2 <= $to {
            const $w: usize = 2;
            $body;
            $c += 2;
        }
        if $c < $to {
            const $w: usize = 1;
            $body;
        }
    };
}

/// Calls `$body` with `$r` = 4 rows from `$i` on while there are as many up to `$to`, then with what is left.
macro_rules! by_rows {
    ($to:expr, |$i:ident, $r:ident| $body:expr) => {
        let mut $i = 0;
        while $i + ROWS <= $to {
            const $r: usize = ROWS;
            $body;
            $i += ROWS;
        }
        match $to - $i {
            3 => {
                const $r: usize = 3;
                $body;
            }
            2 => {
                const $r: usize = 2;
                $body;
            }
            1 => {
                const $r: usize = 1;
                $body;
            }
            _ => (),
        }
    };
}

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

/// R rows by W registers of a product, from register `c` on, over the rows `inner` of `right`.
#[inline(always)]
fn product_block<const R: usize, const W: usize>(
    (left, width): (&[f64], usize),
    inner: Range<usize>,
    right: &[f64],
    stride: usize,
    c: usize,
) -> Block<R, W> {
    let step = stride / LANES;
    let left: [&[f64]; R] = core::array::from_fn(|r| &left[r * width..][inner.clone()]);
    let right = &lanes(right)[inner.start * step + c..];
    let mut sums = [[[0.0; LANES]; W]; R];
    for j in 0..inner.len() {
        let row = &right[j * step..][..W];
        for r in 0..R {
            for w in 0..W {
                accumulate(&mut sums[r][w], left[r][j], &row[w]);
            }
        }
    }
    sums
}

/// What is done with a block's sums.
trait BlockSums {
    /// Into the first rows of `out`, from register `c` on.
    fn put(&self, out: &mut [f64], stride: usize, c: usize);
    /// Times `factor`, added to the first `rows` rows of `out`.
    fn add(&self, factor: f64, out: &mut [f64], stride: usize, c: usize, rows: usize);
}

impl<const R: usize, const W: usize> BlockSums for Block<R, W> {
    #[inline(always)]
    fn put(&self, out: &mut [f64], stride: usize, c: usize) {
        for (r, sum) in self.iter().enumerate() {
            out[r * stride + c * LANES..][..W * LANES].copy_from_slice(sum.as_flattened());
        }
    }

    #[inline(always)]
    fn add(&self, factor: f64, out: &mut [f64], stride: usize, c: usize, rows: usize) {
        for (r, sum) in self.iter().enumerate().take(rows) {
            for (out, sum) in out[r * stride + c * LANES..][..W * LANES].iter_mut().zip(sum.as_flattened()) {
                *out += factor * sum;
            }
        }
    }
}

/// Four rows from register `r` of `a` on, by W registers of `b` from `c` on, of Σᵢ aᵢ bᵢᵀ over the first `inner` rows.
#[inline(always)]
fn outer_block<const W: usize>(
    (a, width): (&[f64], usize),
    (b, stride): (&[f64], usize),
    inner: usize,
    r: usize,
    c: usize,
) -> Block<LANES, W> {
    let mut sums = [[[0.0; LANES]; W]; LANES];
    let (a, b) = (lanes(a), lanes(b));
    for i in 0..inner {
        let (left, right) = (&a[i * (width / LANES) + r], &b[i * (stride / LANES) + c..][..W]);
        for k in 0..LANES {
            for w in 0..W {
                accumulate(&mut sums[k][w], left[k], &right[w]);
            }
        }
    }
    sums
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
    simd::phase(AddSquares { factor, a, n, stride, p });
}

/// [`add_squares`], likewise.
struct AddSquares<'a> {
    factor: f64,
    a: &'a [f64],
    n: usize,
    stride: usize,
    p: &'a mut [f64],
}

impl Kernel for AddSquares<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { factor, a, n, stride, p } = self;
        let inner = a.len() / stride;
        for r in 0..stride / LANES {
            let (out, rows) = (&mut p[r * LANES * stride..], LANES.min(n - r * LANES));
            by_columns!(r, stride / LANES, |c, W| outer_block::<W>((a, stride), (a, stride), inner, r, c)
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

/// The lower triangle of U M Uᵀ into `out`, for upper U and whole M of n rows of `stride`; `turned` receives Uᵀ and
/// `scratch` U M.
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
            by_columns!(0, i / LANES + 1, |c, W| {
                let block = product_block::<ROWS, W>((product, stride), c * LANES..n, turned, stride, c);
                for (row, sum) in out.chunks_exact_mut(stride).zip(&block).take(rows) {
                    row[c * LANES..][..W * LANES].copy_from_slice(sum.as_flattened());
                }
            });
        }
    }
}
