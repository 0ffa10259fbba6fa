//! Linear equations of a small matrix without symmetry.

/// L U = P A, rows exchanged for the largest pivot (Golub and Van Loan 2013, algorithm 3.4.1).
#[derive(Clone, Debug)]
pub(super) struct Lu {
    /// Rows and columns.
    size: usize,
    /// A, row-major, until it is factorised.
    pub(super) matrix: Vec<f64>,
    /// Which row came to each place.
    exchanged: Vec<usize>,
}

impl Lu {
    /// Room for `size` equations.
    pub(super) fn new(size: usize) -> Self {
        Self { size, matrix: vec![0.0; size * size], exchanged: vec![0; size] }
    }

    /// Factorises the matrix; of a singular one, solutions are not finite.
    #[inline(always)]
    pub(super) fn factorise(&mut self) {
        let (n, a) = (self.size, &mut self.matrix);
        for (k, exchanged) in self.exchanged.iter_mut().enumerate() {
            let mut pivot = k;
            for i in k + 1..n {
                if a[i * n + k].abs() > a[pivot * n + k].abs() {
                    pivot = i;
                }
            }
            *exchanged = pivot;
            let (above, below) = a.split_at_mut((k + 1) * n);
            let own = &mut above[k * n..];
            // Whole rows, their multipliers with them, as LAPACK does: a solution then exchanges its right-hand side
            // once.
            if pivot > k {
                own.swap_with_slice(&mut below[(pivot - k - 1) * n..][..n]);
            }
            let inverse = 1.0 / own[k];
            for row in below.chunks_exact_mut(n) {
                let factor = row[k] * inverse;
                row[k] = factor;
                for (x, y) in row[k + 1..].iter_mut().zip(&own[k + 1..]) {
                    *x -= factor * y;
                }
            }
        }
    }

    /// x of A x = b, in place.
    #[inline(always)]
    pub(super) fn solve(&self, b: &mut [f64]) {
        let (n, a) = (self.size, &self.matrix);
        for (k, &pivot) in self.exchanged.iter().enumerate() {
            b.swap(k, pivot);
        }
        for i in 1..n {
            let known: f64 = a[i * n..][..i].iter().zip(&*b).map(|(l, x)| l * x).sum();
            b[i] -= known;
        }
        for i in (0..n).rev() {
            let row = &a[i * n..][..n];
            let known: f64 = row[i + 1..].iter().zip(&b[i + 1..]).map(|(u, x)| u * x).sum();
            b[i] = (b[i] - known) / row[i];
        }
    }

    /// X of A X = B for several right-hand sides, row-major with `width` of them, in place.
    #[inline(always)]
    pub(super) fn solve_rows(&self, b: &mut [f64], width: usize) {
        let (n, a) = (self.size, &self.matrix);
        let subtract = |row: &mut [f64], factor: f64, other: &[f64]| {
            for (x, y) in row.iter_mut().zip(other) {
                *x -= factor * y;
            }
        };
        for (k, &pivot) in self.exchanged.iter().enumerate().filter(|&(k, &pivot)| pivot > k) {
            let (above, below) = b.split_at_mut(pivot * width);
            above[k * width..][..width].swap_with_slice(&mut below[..width]);
        }
        for i in 1..n {
            let (above, row) = b.split_at_mut(i * width);
            for (k, other) in above.chunks_exact(width).enumerate() {
                subtract(&mut row[..width], a[i * n + k], other);
            }
        }
        for i in (0..n).rev() {
            let (row, below) = b[i * width..].split_at_mut(width);
            for (k, other) in below.chunks_exact(width).enumerate() {
                subtract(row, a[i * n + i + 1 + k], other);
            }
            let inverse = 1.0 / a[i * n + i];
            row.iter_mut().for_each(|x| *x *= inverse);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{DMatrix, DVector};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn solutions_are_those_of_nalgebra(n in 1_usize..9, values in prop::collection::vec(-1.0..1.0_f64, 72)) {
            let (a, b) = (DMatrix::from_row_slice(n, n, &values[..n * n]), DVector::from_column_slice(&values[64 - n..64]));
            let inverse = a.clone().try_inverse();
            prop_assume!(inverse.as_ref().is_some_and(|m| m.norm() < 1e4));
            let mut lu = Lu::new(n);
            lu.matrix.copy_from_slice(&values[..n * n]);
            lu.factorise();
            let mut x = b.as_slice().to_vec();
            lu.solve(&mut x);
            let mut twice: Vec<f64> = b.iter().flat_map(|&x| [x, -2.0 * x]).collect();
            lu.solve_rows(&mut twice, 2);
            for (pair, x) in twice.chunks(2).zip(&x) {
                prop_assert!((pair[0] - x).abs() < 1e-10 * (1.0 + x.abs()) && pair[1] == -2.0 * pair[0]);
            }
            let theirs = a.lu().solve(&b).unwrap();
            for (ours, theirs) in x.iter().zip(&theirs) {
                prop_assert!((ours - theirs).abs() < 1e-10 * (1.0 + theirs.abs()), "{ours} {theirs}");
            }
        }
    }

    #[test]
    fn a_pivot_of_zero_is_exchanged_and_a_singular_matrix_tells() {
        let mut lu = Lu::new(2);
        lu.matrix.copy_from_slice(&[0.0, 2.0, 4.0, 1.0]);
        lu.factorise();
        let mut x = [6.0, 11.0];
        lu.solve(&mut x);
        assert_eq!(x, [2.0, 3.0]);
        lu.matrix.copy_from_slice(&[1.0, 2.0, 2.0, 4.0]);
        lu.factorise();
        lu.solve(&mut x);
        assert!(x.iter().any(|x| !x.is_finite()));
    }
}
