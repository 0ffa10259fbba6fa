//! Small dense products on rows padded to a multiple of [`LANES`], accumulated in registers.
//!
//! Two families, for two sizes of problem. Filters have matrices of tens of rows in `f64`: padded rows, blocks of rows
//! that share what is loaded, no allocation, and one order of summation on every processor ([`product`],
//! [`subtract_outer`]). Dynamics have matrices of a few rows in any scalar: plain loops, so that the same text serves
//! derivative numbers and lanes ([`factorise`], [`solve`]).

use crate::scalar::Scalar;
use crate::simd::{self, Kernel};

/// Columns that one vector register holds, and to a multiple of which rows are padded.
pub(crate) const LANES: usize = 4;
/// Rows that share what is loaded.
const ROWS: usize = 4;

/// What one vector register holds.
type Lane = [f64; LANES];

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

/// `out[i] = Σⱼ left[i][j] · right[j]`: `left` has rows of `inner` numbers, `right` at least `inner` rows of `stride`.
///
/// Four rows share each load of `right`. A filter's matrices fit into the nearest cache as they are: nothing is blocked
/// for one, and nothing is copied.
pub(crate) fn product(left: &[f64], inner: usize, right: &[f64], stride: usize, out: &mut [f64]) {
    simd::phase(Product { left, inner, right, stride, out });
}

/// [`product`], to be compiled for each instruction set.
struct Product<'a> {
    left: &'a [f64],
    inner: usize,
    right: &'a [f64],
    stride: usize,
    out: &'a mut [f64],
}

impl Kernel for Product<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { left, inner, right, stride, out } = self;
        let rows = left.len() / inner;
        let whole = rows / ROWS * ROWS;
        for i in (0..whole).step_by(ROWS) {
            product_rows::<ROWS>(&left[i * inner..], inner, right, stride, &mut out[i * stride..]);
        }
        for i in whole..rows {
            product_rows::<1>(&left[i * inner..], inner, right, stride, &mut out[i * stride..]);
        }
    }
}

/// R rows of a product: two registers wide while there are two.
#[inline(always)]
fn product_rows<const R: usize>(left: &[f64], inner: usize, right: &[f64], stride: usize, out: &mut [f64]) {
    let left = &left[..R * inner];
    let (right, step) = (lanes(right), stride / LANES);
    let whole = step / 2 * 2;
    for c in (0..whole).step_by(2) {
        product_block::<R, 2>(left, inner, right, step, c, out);
    }
    if whole < step {
        product_block::<R, 1>(left, inner, right, step, whole, out);
    }
}

/// R rows by W lanes of a product, from lane `c` on.
#[inline(always)]
fn product_block<const R: usize, const W: usize>(
    left: &[f64],
    inner: usize,
    right: &[Lane],
    step: usize,
    c: usize,
    out: &mut [f64],
) {
    // R × W sums stay in registers over the whole inner loop; each loaded row of `right` serves R rows of `left`.
    let mut sums = [[[0.0; LANES]; W]; R];
    for (j, row) in right.chunks_exact(step).take(inner).enumerate() {
        let row = &row[c..c + W];
        for r in 0..R {
            for w in 0..W {
                accumulate(&mut sums[r][w], left[r * inner + j], &row[w]);
            }
        }
    }
    for (r, sum) in sums.iter().enumerate() {
        out[(r * step + c) * LANES..][..W * LANES].copy_from_slice(sum.as_flattened());
    }
}

/// `p −= Σᵢ aᵢ bᵢᵀ + bᵢ aᵢᵀ` on and above the diagonal, the lower triangle then copied from the upper.
///
/// `p` has `n` rows of `stride`, `a` and `b` one row of `stride` for each i.
pub(crate) fn subtract_outer(p: &mut [f64], n: usize, stride: usize, a: &[f64], b: &[f64]) {
    simd::phase(SubtractOuter { p, n, stride, a, b });
}

/// [`subtract_outer`], likewise.
struct SubtractOuter<'a> {
    p: &'a mut [f64],
    n: usize,
    stride: usize,
    a: &'a [f64],
    b: &'a [f64],
}

impl Kernel for SubtractOuter<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { p, n, stride, a, b } = self;
        let step = stride / LANES;
        for r in 0..step {
            let rows = LANES.min(n - r * LANES);
            let mut c = r;
            while c + 2 <= step {
                outer_block::<2>(p, step, (lanes(a), lanes(b)), r, c, rows);
                c += 2;
            }
            if c < step {
                outer_block::<1>(p, step, (lanes(a), lanes(b)), r, c, rows);
            }
        }
        mirror(p, n, stride);
    }
}

/// `rows` rows from lane `r` on by W lanes from lane `c` on.
#[inline(always)]
fn outer_block<const W: usize>(
    p: &mut [f64],
    step: usize,
    (a, b): (&[Lane], &[Lane]),
    r: usize,
    c: usize,
    rows: usize,
) {
    let mut sums = [[[0.0; LANES]; W]; LANES];
    for (a, b) in a.chunks_exact(step).zip(b.chunks_exact(step)) {
        let (ar, br, ac, bc) = (&a[r], &b[r], &a[c..c + W], &b[c..c + W]);
        for k in 0..LANES {
            for w in 0..W {
                accumulate(&mut sums[k][w], ar[k], &bc[w]);
                accumulate(&mut sums[k][w], br[k], &ac[w]);
            }
        }
    }
    for (k, sum) in sums.iter().enumerate().take(rows) {
        let out = &mut p[((r * LANES + k) * step + c) * LANES..][..W * LANES];
        for (out, sum) in out.iter_mut().zip(sum.as_flattened()) {
            *out -= sum;
        }
    }
}

/// Copies the upper triangle of n rows onto the lower.
#[inline(always)]
pub(crate) fn mirror(p: &mut [f64], n: usize, stride: usize) {
    for i in 0..n {
        for j in i + 1..n {
            p[j * stride + i] = p[i * stride + j];
        }
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
