//! Products of matrices with padded rows. Where half of a matrix is zero, the inner loop leaves that half out.
//!
//! What is written block by block has a multiple of four rows, the last of them zero.

use super::LANES;
use super::block::{
    Any, Block, WIDE, Width, add, by_columns, by_rows, by_width, inside, kernel, outer_block, product_block, put,
    transposed,
};
use crate::simd::{self, Kernel};

/// Calls `$body` with the [`Width`] of a [`Part`]'s rows and how many registers of them belong to it: where these are all, the
/// compiler knows both.
macro_rules! by_part {
    ($part:expr, |$width:ident, $to:ident| $body:expr) => {{
        let part: Part = $part;
        if part.registers() * LANES == part.stride {
            by_width!(part.stride, |$width| {
                let $to = $width.registers();
                $body
            });
        } else {
            let ($width, $to) = (Any(part.stride / LANES), part.registers());
            $body;
        }
    }};
}

/// `out[i] = Σⱼ left[i][j] · right[j]`: `left` has rows of `width` numbers, of which the first meet the rows of `right`, each
/// of `stride`.
pub(crate) fn product(left: &[f64], width: usize, right: &[f64], stride: usize, out: &mut [f64]) {
    product_part(left, width, right, Part::whole(stride), out);
}

/// Of [`product`] the columns of that part of `right`.
pub(crate) fn product_part(left: &[f64], width: usize, right: &[f64], part: Part, out: &mut [f64]) {
    simd::phase(Product { left, width, right, part, upper: false, out });
}

/// Of [`product`] what is on and above the diagonal, and what of its registers is below.
pub(crate) fn product_upper(left: &[f64], width: usize, right: &[f64], stride: usize, out: &mut [f64]) {
    simd::phase(Product { left, width, right, part: Part::whole(stride), upper: true, out });
}

/// The first columns of a matrix whose rows are `stride` numbers apart.
#[derive(Clone, Copy)]
pub(crate) struct Part {
    pub(crate) stride: usize,
    pub(crate) columns: usize,
}

impl Part {
    fn whole(stride: usize) -> Self {
        Self { stride, columns: stride }
    }

    /// As registers.
    fn registers(self) -> usize {
        self.columns.div_ceil(LANES)
    }
}

/// [`product`], to be compiled for each instruction set.
struct Product<'a> {
    left: &'a [f64],
    width: usize,
    right: &'a [f64],
    part: Part,
    upper: bool,
    out: &'a mut [f64],
}

kernel!(Product<'_>, |self, MOST| by_part!(self.part, |columns, to| self.run_with::<MOST>(columns, to)));

impl Product<'_> {
    #[inline(always)]
    fn run_with<const MOST: usize>(self, columns: impl Width, to: usize) {
        let Self { left, width, right, part: Part { stride, .. }, upper, out } = self;
        let inner = width.min(right.len() / stride);
        let right = (columns, columns.rows(right, inner));
        by_rows!(left.len() / width, |i, L| {
            let left = left_rows::<L>(&left[i * width..], width);
            by_columns!(MOST, if upper { i / LANES } else { 0 }, to, |c, W| put(
                &product_block::<L, W, _>(left, right, inner, c),
                columns.block_mut(out, i),
                c
            ));
        });
    }
}

/// The first L rows of `width` numbers.
#[inline(always)]
fn left_rows<const L: usize>(left: &[f64], width: usize) -> [&[f64]; L] {
    core::array::from_fn(|l| &left[l * width..][..width])
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

kernel!(AddOuter<'_>, |self, MOST| by_width!(self.stride, |columns| self.run_with::<MOST>(columns)));

impl AddOuter<'_> {
    #[inline(always)]
    fn run_with<const MOST: usize>(self, columns: impl Width) {
        let Self { factor, a, width, b, stride, out } = self;
        let (inner, wide) = (b.len() / stride, Any(width / LANES));
        let (a, b) = ((wide, wide.rows(a, inner)), (columns, columns.rows(b, inner)));
        for r in 0..wide.registers() {
            by_columns!(MOST, 0, columns.registers(), |c, W| add(
                factor,
                &outer_block::<W, _, _>(a, b, r, c),
                columns.block_mut(out, r * LANES),
                c
            ));
        }
    }
}

/// `p += factor · Σᵢ aᵢ aᵢᵀ`, the upper triangle computed and then copied onto the lower.
///
/// `p` is square with rows of `stride`, `a` has one row of `stride` for each i.
pub(crate) fn add_squares(factor: f64, a: &[f64], stride: usize, p: &mut [f64]) {
    simd::phase(AddSymmetric { factor, a, b: a, part: Part::whole(stride), p });
}

/// `p += Σᵢ aᵢ bᵢᵀ` where that sum is symmetric, otherwise as [`add_squares`].
pub(crate) fn add_symmetric(a: &[f64], b: &[f64], stride: usize, p: &mut [f64]) {
    add_symmetric_part(a, b, Part::whole(stride), p);
}

/// Of [`add_symmetric`] that part of the columns, and as many rows.
pub(crate) fn add_symmetric_part(a: &[f64], b: &[f64], part: Part, p: &mut [f64]) {
    simd::phase(AddSymmetric { factor: 1.0, a, b, part, p });
}

/// [`add_squares`] and [`add_symmetric`], likewise.
struct AddSymmetric<'a> {
    factor: f64,
    a: &'a [f64],
    b: &'a [f64],
    part: Part,
    p: &'a mut [f64],
}

kernel!(AddSymmetric<'_>, |self, MOST| by_part!(self.part, |width, to| self.run_with::<MOST>(width, to)));

impl AddSymmetric<'_> {
    #[inline(always)]
    fn run_with<const MOST: usize>(self, width: impl Width, to: usize) {
        let Self { factor, a, b, part: Part { stride, .. }, p } = self;
        let inner = a.len() / stride;
        let (a, b) = ((width, width.rows(a, inner)), (width, width.rows(b, inner)));
        for r in 0..to {
            by_columns!(MOST, r, to, |c, W| add(
                factor,
                &outer_block::<W, _, _>(a, b, r, c),
                width.block_mut(p, r * LANES),
                c
            ));
        }
        mirror_with(width, to, p);
    }
}

/// Copies the upper triangle of a square matrix with rows of `stride` onto the lower.
#[inline(always)]
pub(crate) fn mirror(p: &mut [f64], stride: usize) {
    by_width!(stride, |width| mirror_with(width, width.registers(), p));
}

/// Four rows of a register each, turned, at a time, `to` registers of each row.
#[inline(always)]
pub(super) fn mirror_with(width: impl Width, to: usize, p: &mut [f64]) {
    for r in 0..to {
        let own = width.block_mut::<LANES>(p, r * LANES);
        let r = inside::<1>(width, r);
        let block: Block<LANES, 1> = core::array::from_fn(|l| [own[l][r]]);
        let turned = transposed(&block);
        for k in 0..LANES {
            own[k][r] = core::array::from_fn(|l| if l < k { turned[k][0][l] } else { block[k][0][l] });
        }
        for c in r + 1..to {
            let own = width.block_mut::<LANES>(p, r * LANES);
            let block = core::array::from_fn(|l| [own[l][c]]);
            put(&transposed(&block), width.block_mut::<LANES>(p, c * LANES), r);
        }
    }
}

/// `out` ← `matrix`ᵀ, square with rows of `stride`.
pub(crate) fn transpose(matrix: &[f64], stride: usize, out: &mut [f64]) {
    simd::phase(Transpose { matrix, stride, out });
}

/// [`transpose`], likewise.
struct Transpose<'a> {
    matrix: &'a [f64],
    stride: usize,
    out: &'a mut [f64],
}

impl Kernel for Transpose<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        by_width!(self.stride, |width| turn_with(width, |_| 0, self.matrix, self.out));
    }
}

/// The upper triangle of U M Uᵀ into `out`, for upper U and M with rows of `stride`; `turned`, which is zero above its diagonal
/// before as well, receives Uᵀ and `scratch` some rows of U M.
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

kernel!(Congruence<'_>, |self, MOST| by_width!(self.stride, |width| self.run_with::<MOST>(width)));

impl Congruence<'_> {
    #[inline(always)]
    fn run_with<const MOST: usize>(self, width: impl Width) {
        let Self { upper, matrix, stride, turned, scratch, out } = self;
        let (step, product) = (width.registers(), &mut scratch[..LANES * stride]);
        turn_with(width, |r| r, upper, turned);
        // Rows i and further of U begin at column i, and columns k and further of Uᵀ at row k.
        for r in 0..step {
            let i = r * LANES;
            let (left, inner) = (left_rows::<LANES>(&upper[i * stride..], stride).map(|row| &row[i..]), stride - i);
            let right = (width, width.rows(&matrix[i * stride..], inner));
            by_columns!(MOST, 0, step, |c, W| put(
                &product_block::<LANES, W, _>(left, right, inner, c),
                width.block_mut(product, 0),
                c
            ));
            by_columns!(MOST, r, step, |c, W| {
                let (k, inner) = (c * LANES, stride - c * LANES);
                let left = left_rows::<LANES>(product, stride).map(|row| &row[k..]);
                let right = (width, width.rows(&turned[k * stride..], inner));
                put(&product_block::<LANES, W, _>(left, right, inner, c), width.block_mut(out, i), c);
            });
        }
    }
}

/// The transpose of a matrix of whose rows all is zero before some register.
#[inline(always)]
fn turn_with(width: impl Width, first: impl Fn(usize) -> usize, matrix: &[f64], turned: &mut [f64]) {
    let rows = width.rows(matrix, width.registers() * LANES);
    for r in 0..width.registers() {
        for c in first(r)..width.registers() {
            let block = core::array::from_fn(|l| [width.row(rows, r * LANES + l)[c]]);
            put(&transposed(&block), width.block_mut::<LANES>(turned, c * LANES), r);
        }
    }
}
