//! Symmetric matrices less the squares of rows that come one after the other, each known only once those before it are taken off.

use super::LANES;
use super::block::{Lane, WIDE, Width, accumulate, by_columns, by_width, inside, kernel, outer_block};
use super::products::mirror_with;
use crate::simd::{self, Kernel};

/// Of `p −= w wᵀ` as many first rows as h has numbers, and h times what is left of these into `out`, in one pass: `p` has rows as
/// long as w and `out`.
///
/// Entries on both sides of the diagonal are the same to the last bit.
pub(crate) fn downdate(p: &mut [f64], w: &[f64], h: &[f64], out: &mut [f64]) {
    simd::phase(Downdate { p, w, h, out });
}

/// [`downdate`], to be compiled for each instruction set.
struct Downdate<'a> {
    p: &'a mut [f64],
    w: &'a [f64],
    h: &'a [f64],
    out: &'a mut [f64],
}

impl Kernel for Downdate<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        by_width!(self.w.len(), |width| self.run_with(width));
    }
}

impl Downdate<'_> {
    #[inline(always)]
    fn run_with(self, width: impl Width) {
        let Self { p, w, h, out } = self;
        let (lanes, out) = (width.row(width.rows(w, 1), 0), width.block_mut::<1>(out, 0));
        let [out] = out;
        by_columns!(WIDE, 0, width.registers(), |c, W| {
            let c = inside::<W>(width, c);
            // Taken out, so that the compiler knows that they stay as they are.
            let own: [Lane; W] = core::array::from_fn(|i| lanes[c + i]);
            let mut sums = [[0.0; LANES]; W];
            for ((row, &w), &h) in width.each_mut(p).zip(w).zip(h) {
                for i in 0..W {
                    let left = core::array::from_fn(|l| row[c + i][l] - w * own[i][l]);
                    accumulate(&mut sums[i], h, &left);
                    row[c + i] = left;
                }
            }
            out[c..c + W].copy_from_slice(&sums);
        });
    }
}

/// The other rows of that, from the `first` on, for all of `rows`; and what is below the diagonal.
pub(crate) fn downdate_rest(p: &mut [f64], rows: &[f64], first: usize, stride: usize) {
    simd::phase(DowndateRest { p, rows, first, stride });
}

/// [`downdate_rest`], likewise.
struct DowndateRest<'a> {
    p: &'a mut [f64],
    rows: &'a [f64],
    first: usize,
    stride: usize,
}

kernel!(DowndateRest<'_>, |self, MOST| by_width!(self.stride, |width| self.run_with::<MOST>(width)));

impl DowndateRest<'_> {
    #[inline(always)]
    fn run_with<const MOST: usize>(self, width: impl Width) {
        let Self { p, rows, first, stride } = self;
        let rows = (width, width.rows(rows, rows.len() / stride));
        for r in first / LANES..width.registers() {
            by_columns!(MOST, r, width.registers(), |c, W| {
                let (sums, c) = (outer_block::<W, _, _>(rows, rows, r, c), inside::<W>(width, c));
                let own = width.block_mut::<LANES>(p, r * LANES).into_iter().zip(&sums);
                for (own, sums) in own.skip(first.saturating_sub(r * LANES)) {
                    for w in 0..W {
                        accumulate(&mut own[c + w], -1.0, &sums[w]);
                    }
                }
            });
        }
        mirror_with(width, width.registers(), p);
    }
}
