//! Against the conditional density of late readings given the present state, formed whole.

use super::*;
use nalgebra::{DMatrix, DVector};
use proptest::prelude::*;

/// States, and late readings of them.
const D: usize = 4;
const LINES: usize = 3;
const NOISE: [f64; LINES] = [0.3, 0.02, 1.5];

proptest! {
    /// Regression and what it leaves, mixed: together they are N(y; E[w | x], Cov[w | x] + R).
    #[test]
    fn mixed_readings_have_the_density_of_all(
        root in prop::collection::vec(-1.0..1.0_f64, (D + LINES).pow(2)),
        x in prop::collection::vec(-1.0..1.0_f64, D),
        y in prop::collection::vec(-1.0..1.0_f64, LINES),
    ) {
        let root = DMatrix::from_vec(D + LINES, D + LINES, root);
        let joint = &root * root.transpose() + DMatrix::identity(D + LINES, D + LINES) * 0.01;
        let (x, y) = (DVector::from_vec(x), DVector::from_vec(y));
        let (own, with) = (joint.view((0, 0), (D, D)), joint.view((D, 0), (LINES, D)));
        let slope = with * own.try_inverse().unwrap();
        let rest = joint.view((D, D), (LINES, LINES)) - &slope * with.transpose();
        let s = &rest + DMatrix::from_diagonal(&DVector::from_row_slice(&NOISE));
        let error = &y - &slope * &x;
        let expected = (error.transpose() * s.clone().try_inverse().unwrap() * &error)[0] + s.determinant().ln();

        let mut factor: Vec<f64> = joint.transpose().as_slice().to_vec();
        linear::cholesky(&mut factor, D + LINES, D + LINES);
        let mut past = Past {
            found: (0..LINES).map(|channel| PastReading { channel, value: y[channel], change: 0.0 }).collect(),
            joint: Vec::new(),
            centre: vec![0.0; D],
            rows: vec![0.0; LINES * D],
            left: rest.transpose().as_slice().to_vec(),
        };
        for (row, b) in past.rows.chunks_exact_mut(D).zip(factor[D * (D + LINES)..].chunks_exact(D + LINES)) {
            regress(&factor, D + LINES, &b[..D], row);
        }
        prop_assert!((DMatrix::from_row_slice(LINES, D, &past.rows) - &slope).amax() < 1e-9 * (1.0 + slope.amax()));
        let mut found = 0.0;
        let mixed: Vec<_> = past.decorrelate(|channel| NOISE[channel]).collect();
        for (i, (late, variance)) in mixed.into_iter().enumerate() {
            let predicted: f64 = past.row(i).iter().zip(&x).map(|(slope, x)| slope * x).sum();
            found += (late.value - predicted).powi(2) / variance + variance.ln();
        }
        prop_assert!((found - expected).abs() < 1e-8 * (1.0 + expected.abs()), "{} {}", found, expected);
    }
}

#[test]
fn what_the_state_fixes_leaves_nothing() {
    // w = 2 x, to rounding.
    let mut factor = vec![4.0, 0.0, 8.0, 16.0];
    linear::cholesky(&mut factor, 2, 2);
    let mut row = [0.0];
    regress(&factor, 2, &factor[2..3], &mut row);
    assert_eq!((row, factor[3]), ([2.0], 0.0));
}
