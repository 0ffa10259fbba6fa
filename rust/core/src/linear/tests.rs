//! Kernels on padded rows against plain loops.

use super::{
    LANES, Part, add_outer, add_squares, add_symmetric, add_symmetric_part, backward, congruence, downdate,
    downdate_rest, forward, mirror, product, product_part, product_upper, transpose, upper_factor,
};
use proptest::collection::vec;
use proptest::prelude::*;

/// Rows of `columns` numbers.
type Plain = Vec<Vec<f64>>;

fn matrix(rows: usize, columns: usize) -> impl Strategy<Value = Plain> {
    vec(vec(-2.0..2.0, columns), rows)
}

/// Rows of a multiple of [`LANES`], as many of them, and their length.
fn padded(plain: &Plain, columns: usize) -> (Vec<f64>, usize) {
    let stride = columns.next_multiple_of(LANES);
    let mut data = vec![0.0; plain.len().next_multiple_of(LANES) * stride];
    for (row, plain) in data.chunks_exact_mut(stride).zip(plain) {
        row[..columns].copy_from_slice(plain);
    }
    (data, stride)
}

/// Aᵀ B.
fn gram(a: &Plain, b: &Plain, rows: usize, columns: usize) -> Plain {
    let sum = |i: usize, j: usize| a.iter().zip(b).map(|(a, b)| a[i] * b[j]).sum();
    (0..rows).map(|i| (0..columns).map(|j| sum(i, j)).collect()).collect()
}

fn transposed(a: &Plain, columns: usize) -> Plain {
    (0..columns).map(|j| a.iter().map(|row| row[j]).collect()).collect()
}

/// Whether the entries for which `some` holds agree to rounding of sums of this size.
fn agree(data: &[f64], stride: usize, plain: &Plain, some: impl Fn(usize, usize) -> bool) -> Result<(), TestCaseError> {
    for (i, (row, plain)) in data.chunks_exact(stride).zip(plain).enumerate() {
        for (j, (own, plain)) in row.iter().zip(plain).enumerate() {
            prop_assert!(!some(i, j) || (own - plain).abs() < 1e-10, "({i}, {j}): {own} is not {plain}");
        }
    }
    Ok(())
}

const ALL: fn(usize, usize) -> bool = |_, _| true;

/// Mᵀ M + 1.
fn definite(m: &Plain, n: usize) -> Plain {
    let mut a = gram(m, m, n, n);
    (0..n).for_each(|i| a[i][i] += 1.0);
    a
}

proptest! {
    #[test]
    fn product_is_the_sum_over_the_inner_index(
        (left, right, columns) in (1_usize..11, 1_usize..14, 1_usize..14).prop_flat_map(|(rows, inner, columns)| {
            (matrix(rows, inner), matrix(inner, columns), Just(columns))
        })
    ) {
        let inner = right.len();
        let (right_rows, stride) = padded(&right, columns);
        let mut out = vec![f64::NAN; left.len() * stride];
        product(&left.concat(), inner, &right_rows, stride, &mut out);
        let plain = gram(&transposed(&left, inner), &right, left.len(), columns);
        agree(&out, stride, &plain, ALL)?;
        let mut upper = vec![0.0; left.len() * stride];
        product_upper(&left.concat(), inner, &right_rows, stride, &mut upper);
        agree(&upper, stride, &plain, |i, j| j >= i)?;
    }

    #[test]
    fn a_part_of_a_product_is_its_first_columns(
        (left, right, columns, part) in (1_usize..11, 1_usize..14, 1_usize..14).prop_flat_map(|(rows, inner, columns)| {
            (matrix(rows, inner), matrix(inner, columns), Just(columns), 1..=columns)
        })
    ) {
        let inner = right.len();
        let (right_rows, stride) = padded(&right, columns);
        let mut out = vec![7.0; left.len() * stride];
        product_part(&left.concat(), inner, &right_rows, Part { stride, columns: part }, &mut out);
        let whole = gram(&transposed(&left, inner), &right, left.len(), columns);
        agree(&out, stride, &whole, |_, j| j < part)?;
        prop_assert!(out.chunks_exact(stride).all(|row| row[part.next_multiple_of(LANES)..].iter().all(|x| *x == 7.0)));
    }

    #[test]
    fn outer_products_are_added_times_a_factor(
        (a, b, rows, columns) in (1_usize..9, 1_usize..11, 1_usize..14).prop_flat_map(|(inner, rows, columns)| {
            (matrix(inner, rows), matrix(inner, columns), Just(rows), Just(columns))
        }),
        factor in -2.0..2.0,
    ) {
        let ((left, width), (right, stride)) = (padded(&a, rows), padded(&b, columns));
        let mut out = vec![1.0; rows.next_multiple_of(LANES) * stride];
        add_outer(factor, (&left, width), &right, stride, &mut out);
        let sums = gram(&a, &b, rows, columns);
        let plain = sums.iter().map(|row| row.iter().map(|x| 1.0 + factor * x).collect()).collect();
        agree(&out, stride, &plain, ALL)?;
    }

    #[test]
    fn squares_are_added_to_both_triangles(
        (a, n) in (1_usize..9, 1_usize..14).prop_flat_map(|(inner, n)| (matrix(inner, n), Just(n))),
        factor in -2.0..2.0,
    ) {
        let (rows, stride) = padded(&a, n);
        let mut out = vec![0.0; stride * stride];
        add_squares(factor, &rows, stride, &mut out);
        let plain = gram(&a, &a, n, n).iter().map(|row| row.iter().map(|x| factor * x).collect()).collect();
        agree(&out, stride, &plain, ALL)?;
    }

    #[test]
    fn squares_are_taken_off_one_by_one(
        (a, h, n) in (1_usize..6, 1_usize..14).prop_flat_map(|(inner, n)| (matrix(inner, n), matrix(1, n), Just(n))),
        part in 0.1..1.0,
    ) {
        let ((rows, stride), dense) = (padded(&a, n), f64::ceil(part * n as f64) as usize);
        let (mut p, mut out) = (vec![0.0; stride * stride], vec![f64::NAN; stride]);
        (0..n).for_each(|i| (0..n).for_each(|j| p[i * stride + j] = 9.0 + (i * j) as f64));
        let left: Plain =
            gram(&a, &a, n, n).iter().enumerate().map(|(i, row)| {
                row.iter().enumerate().map(|(j, x)| 9.0 + (i * j) as f64 - x).collect()
            }).collect();
        for w in rows.chunks_exact(stride) {
            downdate(&mut p, w, &h[0][..dense], &mut out);
        }
        let through = gram(&transposed(&vec![h[0][..dense].to_vec()], dense), &left[..dense].to_vec(), 1, n);
        agree(&out, stride, &through, ALL)?;
        downdate_rest(&mut p, &rows, dense, stride);
        agree(&p, stride, &left, ALL)?;
        prop_assert!((0..n).all(|i| (0..n).all(|j| p[i * stride + j] == p[j * stride + i])));
    }

    #[test]
    fn symmetric_products_are_added_to_both_triangles(
        (a, m, n) in (1_usize..14, 1_usize..14).prop_flat_map(|(inner, n)| {
            (matrix(inner, n), matrix(inner, inner), Just(n))
        })
    ) {
        // Aᵀ (M A) with symmetric M.
        let whole = definite(&m, m.len());
        let product = gram(&whole, &a, m.len(), n);
        let ((left, stride), (right, _)) = (padded(&a, n), padded(&product, n));
        let mut out = vec![0.0; stride * stride];
        add_symmetric(&left, &right, stride, &mut out);
        agree(&out, stride, &gram(&a, &product, n, n), ALL)?;
        for columns in 1..=n {
            let mut out = vec![0.0; stride * stride];
            add_symmetric_part(&left, &right, Part { stride, columns }, &mut out);
            agree(&out, stride, &gram(&a, &product, n, n), |i, j| i.max(j) < columns)?;
        }
    }

    #[test]
    fn rows_become_columns((a, n) in (1_usize..14).prop_flat_map(|n| (matrix(n, n), Just(n)))) {
        let (mut rows, stride) = padded(&a, n);
        rows.resize(stride * stride, 0.0);
        let mut out = vec![f64::NAN; stride * stride];
        transpose(&rows, stride, &mut out);
        agree(&out, stride, &transposed(&a, n), ALL)?;
    }

    #[test]
    fn upper_triangle_is_copied((a, n) in (1_usize..14).prop_flat_map(|n| (matrix(n, n), Just(n)))) {
        let (mut out, stride) = padded(&a, n);
        mirror(&mut out, stride);
        let plain = (0..n).map(|i| (0..n).map(|j| a[i.min(j)][i.max(j)]).collect()).collect();
        agree(&out, stride, &plain, ALL)?;
    }

    #[test]
    fn factor_squared_is_the_matrix_and_forward_and_backward_undo_it(
        (m, x, n, columns) in (1_usize..14, 1_usize..11).prop_flat_map(|(n, columns)| {
            (matrix(n, n), matrix(n, columns), Just(n), Just(columns))
        })
    ) {
        let a = definite(&m, n);
        let (mut upper, stride) = padded(&a, n);
        upper_factor(&mut upper, n, stride);
        let u: Plain = upper.chunks_exact(stride).take(n).map(|row| row[..n].to_vec()).collect();
        agree(&upper, stride, &vec![vec![0.0; n]; n], |i, j| j < i)?;
        let (squared, _) = padded(&gram(&u, &u, n, n), n);
        agree(&squared, stride, &a, ALL)?;

        let (mut solution, width) = padded(&gram(&u, &x, n, columns), columns);
        forward(&upper, stride, &mut solution, width);
        agree(&solution, width, &x, ALL)?;
        let (mut solution, width) = padded(&gram(&transposed(&u, n), &x, n, columns), columns);
        backward(&upper, stride, &mut solution, width);
        agree(&solution, width, &x, ALL)?;
    }

    #[test]
    fn factor_of_a_singular_matrix_squares_to_it(
        (m, n) in (2_usize..14).prop_flat_map(|n| (1..n).prop_flat_map(move |rank| (matrix(rank, n), Just(n))))
    ) {
        let a = gram(&m, &m, n, n);
        let (mut upper, stride) = padded(&a, n);
        upper_factor(&mut upper, n, stride);
        let u: Plain = upper.chunks_exact(stride).take(n).map(|row| row[..n].to_vec()).collect();
        let (squared, _) = padded(&gram(&u, &u, n, n), n);
        // A pivot that is lost leaves out the root of what rounding left.
        for (row, plain) in squared.chunks_exact(stride).zip(&a) {
            for (own, plain) in row.iter().zip(plain) {
                prop_assert!((own - plain).abs() < 1e-5, "{own} is not {plain}");
            }
        }
    }

    #[test]
    fn congruence_is_the_two_products(
        (m, s, n) in (1_usize..14).prop_flat_map(|n| (matrix(n, n), matrix(n, n), Just(n)))
    ) {
        let upper: Plain = (0..n).map(|i| (0..n).map(|j| if j < i { 0.0 } else { m[i][j] }).collect()).collect();
        let whole = gram(&s, &s, n, n);
        let ((u, stride), (matrix, _)) = (padded(&upper, n), padded(&whole, n));
        let square = vec![0.0; stride * stride];
        let (mut u_square, mut turned, mut scratch, mut out) = (square.clone(), square.clone(), square.clone(), square);
        u_square[..u.len()].copy_from_slice(&u);
        congruence(&u_square, &matrix, stride, &mut turned, &mut scratch, &mut out);
        let turned = transposed(&upper, n);
        let plain = gram(&turned, &gram(&transposed(&whole, n), &turned, n, n), n, n);
        agree(&out, stride, &plain, |i, j| j >= i)?;
    }
}
