//! Blocks: R rows by W vector registers of a product, whose sums stay in registers over the whole inner loop.
//!
//! Four rows share each load. A filter's matrices fit into the nearest cache as they are: nothing is blocked for one, and
//! nothing is copied.

use super::LANES;
use core::ops::Range;

/// Rows that share what is loaded.
pub(super) const ROWS: usize = LANES;

/// What one vector register holds.
pub(super) type Lane = [f64; LANES];

/// The sums of a block: R rows by W registers.
pub(super) type Block<const R: usize, const W: usize> = [[Lane; W]; R];

/// A padded row by registers.
#[inline(always)]
pub(super) fn lanes(values: &[f64]) -> &[Lane] {
    values.as_chunks().0
}

/// `sum += a · b`, lane by lane.
#[inline(always)]
pub(super) fn accumulate(sum: &mut Lane, a: f64, b: &Lane) {
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
pub(super) use by_columns;

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
pub(super) use by_rows;

/// R rows by W registers of a product, from register `c` on, over the rows `inner` of `right`.
#[inline(always)]
pub(super) fn product_block<const R: usize, const W: usize>(
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

/// Four rows from register `r` of `a` on, by W registers of `b` from `c` on, of Σᵢ aᵢ bᵢᵀ over the first `inner` rows.
#[inline(always)]
pub(super) fn outer_block<const W: usize>(
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

/// What is done with a block's sums.
pub(super) trait BlockSums {
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
