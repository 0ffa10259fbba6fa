//! Blocks: L rows by W vector registers of a product, whose sums stay in registers over the whole inner loop.
//!
//! Four rows share each load. A filter's matrices fit into the nearest cache as they are: nothing is blocked for one, and
//! nothing is copied. The compiler knows the size of rows of up to twelve registers ([`KnownWidth`]), so that a block is its
//! arithmetic and little else.

use super::LANES;

/// How many registers of a row a block has: twelve sums of four numbers stay in sixteen registers of as many, four where these hold
/// but two.
pub(super) const WIDE: usize = 3;
pub(super) const NARROW: usize = 1;

/// What one vector register holds.
pub(super) type Lane = [f64; LANES];

/// The sums of a block: L rows by W registers.
pub(super) type Block<const L: usize, const W: usize> = [[Lane; W]; L];

/// A padded row by registers.
#[inline(always)]
fn lanes(values: &[f64]) -> &[Lane] {
    values.as_chunks().0
}

/// The same, to be written.
#[inline(always)]
fn lanes_mut(values: &mut [f64]) -> &mut [Lane] {
    values.as_chunks_mut().0
}

/// `sum += a · b`, lane by lane.
#[inline(always)]
pub(super) fn accumulate(sum: &mut Lane, a: f64, b: &Lane) {
    for l in 0..LANES {
        sum[l] += a * b[l];
    }
}

/// How many registers a row of a matrix has.
pub(super) trait Width: Copy {
    /// Rows, one after the other.
    type Rows<'a>: Copy;

    fn registers(self) -> usize;

    /// The first `count` rows of `values`.
    fn rows(self, values: &[f64], count: usize) -> Self::Rows<'_>;

    /// Row `j` of them.
    fn row<'a>(self, rows: Self::Rows<'a>, j: usize) -> &'a [Lane];

    /// One after the other.
    fn each<'a>(self, rows: Self::Rows<'a>) -> impl Iterator<Item = &'a [Lane]>;

    /// Rows of `values`, to be written.
    fn each_mut(self, values: &mut [f64]) -> impl Iterator<Item = &mut [Lane]>;

    /// L rows of `values` from the `i`-th on, to be written.
    fn block_mut<const L: usize>(self, values: &mut [f64], i: usize) -> [&mut [Lane]; L];
}

/// A number of registers that the compiler knows.
#[derive(Clone, Copy)]
pub(super) struct KnownWidth<const R: usize>;

impl<const R: usize> Width for KnownWidth<R> {
    type Rows<'a> = &'a [[Lane; R]];

    #[inline(always)]
    fn registers(self) -> usize {
        R
    }

    #[inline(always)]
    fn rows(self, values: &[f64], count: usize) -> Self::Rows<'_> {
        &lanes(values).as_chunks().0[..count]
    }

    #[inline(always)]
    fn row<'a>(self, rows: Self::Rows<'a>, j: usize) -> &'a [Lane] {
        &rows[j]
    }

    #[inline(always)]
    fn each<'a>(self, rows: Self::Rows<'a>) -> impl Iterator<Item = &'a [Lane]> {
        rows.iter().map(|row| &row[..])
    }

    #[inline(always)]
    fn each_mut(self, values: &mut [f64]) -> impl Iterator<Item = &mut [Lane]> {
        lanes_mut(values).as_chunks_mut::<R>().0.iter_mut().map(|row| &mut row[..])
    }

    #[inline(always)]
    fn block_mut<const L: usize>(self, values: &mut [f64], i: usize) -> [&mut [Lane]; L] {
        let rows = &mut lanes_mut(values).as_chunks_mut::<R>().0[i..];
        rows.as_chunks_mut::<L>().0[0].each_mut().map(|row| &mut row[..])
    }
}

/// Any number of registers.
#[derive(Clone, Copy)]
pub(super) struct Any(pub(super) usize);

impl Width for Any {
    type Rows<'a> = &'a [Lane];

    #[inline(always)]
    fn registers(self) -> usize {
        self.0
    }

    #[inline(always)]
    fn rows(self, values: &[f64], count: usize) -> Self::Rows<'_> {
        &lanes(values)[..count * self.0]
    }

    #[inline(always)]
    fn row<'a>(self, rows: Self::Rows<'a>, j: usize) -> &'a [Lane] {
        &rows[j * self.0..][..self.0]
    }

    #[inline(always)]
    fn each<'a>(self, rows: Self::Rows<'a>) -> impl Iterator<Item = &'a [Lane]> {
        rows.chunks_exact(self.0)
    }

    #[inline(always)]
    fn each_mut(self, values: &mut [f64]) -> impl Iterator<Item = &mut [Lane]> {
        lanes_mut(values).chunks_exact_mut(self.0)
    }

    #[inline(always)]
    fn block_mut<const L: usize>(self, values: &mut [f64], i: usize) -> [&mut [Lane]; L] {
        let mut rows = lanes_mut(values)[i * self.0..].chunks_exact_mut(self.0);
        core::array::from_fn(|_| rows.next().unwrap_or_default())
    }
}

/// Calls `$body` with `$width` being the [`Width`] of rows of `$stride` numbers.
macro_rules! by_width {
    ($stride:expr, |$width:ident| $body:expr) => {
        by_width!(@ $stride, $width, $body, 1 2 3 4 5 6 7 8 9 10 11 12)
    };
    (@ $stride:expr, $width:ident, $body:expr, $($known:literal)*) => {
        match $stride / crate::linear::LANES {
            $($known => {
                let $width = crate::linear::block::KnownWidth::<$known>;
                $body
            })*
            other => {
                let $width = crate::linear::block::Any(other);
                $body
            }
        }
    };
}
pub(super) use by_width;

/// Calls `$body` with `$w` registers from `$c` on, `$most` at once, which is 1 or 3, the last two or four by twos, up to `$to`.
macro_rules! by_columns {
    ($most:expr, $from:expr, $to:expr, |$c:ident, $w:ident| $body:expr) => {
        let (mut $c, to) = ($from, $to);
        if $most == WIDE {
            while $c + 3 <= to && $c + 4 != to {
                const $w: usize = 3;
                $body;
                $c += 3;
            }
            while $c + 2 <= to {
                const $w: usize = 2;
                $body;
                $c += 2;
            }
        }
        while $c < to {
            const $w: usize = 1;
            $body;
            $c += 1;
        }
    };
}
pub(super) use by_columns;

/// Calls `$body` with `$l` = 4 rows from `$i` on while there are as many up to `$to`, then with what is left.
macro_rules! by_rows {
    ($to:expr, |$i:ident, $l:ident| $body:expr) => {
        let mut $i = 0;
        while $i + crate::linear::LANES <= $to {
            const $l: usize = crate::linear::LANES;
            $body;
            $i += crate::linear::LANES;
        }
        match $to - $i {
            3 => {
                const $l: usize = 3;
                $body;
            }
            2 => {
                const $l: usize = 2;
                $body;
            }
            1 => {
                const $l: usize = 1;
                $body;
            }
            _ => (),
        }
    };
}
pub(super) use by_rows;

/// Implements [`Kernel`](crate::simd::Kernel) by `$body`, in which `$most` is how many registers are worked on at once.
macro_rules! kernel {
    ($kernel:ty, |$this:ident, $most:ident| $body:expr) => {
        impl crate::simd::Kernel for $kernel {
            type Output = ();

            #[inline(always)]
            fn run($this) {
                const $most: usize = crate::linear::block::WIDE;
                $body;
            }

            #[inline(always)]
            fn run_narrow($this) {
                const $most: usize = crate::linear::block::NARROW;
                $body;
            }
        }
    };
}
pub(super) use kernel;

/// `left` times `right`, from register `c` on: L rows of `inner` numbers, as many as `right` has rows.
#[inline(always)]
pub(super) fn product_block<const L: usize, const W: usize, X: Width>(
    left: [&[f64]; L],
    (width, right): (X, X::Rows<'_>),
    inner: usize,
    c: usize,
) -> Block<L, W> {
    let (left, c) = (left.map(|row| &row[..inner]), inside::<W>(width, c));
    let mut sums = [[[0.0; LANES]; W]; L];
    let mut rows = width.each(right);
    for j in 0..inner {
        let Some(row) = rows.next() else { break };
        for l in 0..L {
            for w in 0..W {
                accumulate(&mut sums[l][w], left[l][j], &row[c + w]);
            }
        }
    }
    sums
}

/// Four rows from register `r` of `a` on, by W registers of `b` from `c` on, of Σᵢ aᵢ bᵢᵀ over the first rows that both have.
#[inline(always)]
pub(super) fn outer_block<const W: usize, X: Width, Y: Width>(
    (wide, a): (X, X::Rows<'_>),
    (width, b): (Y, Y::Rows<'_>),
    r: usize,
    c: usize,
) -> Block<LANES, W> {
    let (r, c) = (inside::<1>(wide, r), inside::<W>(width, c));
    let mut sums = [[[0.0; LANES]; W]; LANES];
    for (left, right) in wide.each(a).zip(width.each(b)) {
        for l in 0..LANES {
            for w in 0..W {
                accumulate(&mut sums[l][w], left[r][l], &right[c + w]);
            }
        }
    }
    sums
}

/// `c` itself, in a form that tells the compiler that W registers from it on are in a row.
#[inline(always)]
pub(super) fn inside<const W: usize>(width: impl Width, c: usize) -> usize {
    c.min(width.registers() - W)
}

/// Puts sums into rows from register `c` on.
#[inline(always)]
pub(super) fn put<const L: usize, const W: usize>(sums: &Block<L, W>, out: [&mut [Lane]; L], c: usize) {
    for l in 0..L {
        for w in 0..W {
            out[l][c + w] = sums[l][w];
        }
    }
}

/// Adds sums times `factor` to rows from register `c` on.
#[inline(always)]
pub(super) fn add<const L: usize, const W: usize>(factor: f64, sums: &Block<L, W>, out: [&mut [Lane]; L], c: usize) {
    for l in 0..L {
        for w in 0..W {
            accumulate(&mut out[l][c + w], factor, &sums[l][w]);
        }
    }
}

/// Four rows of a register each, turned.
#[inline(always)]
pub(super) fn transposed(block: &Block<LANES, 1>) -> Block<LANES, 1> {
    core::array::from_fn(|k| [core::array::from_fn(|l| block[l][0][k])])
}
