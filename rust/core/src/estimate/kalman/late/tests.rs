//! Steps of late sensors against their own matrix, column by column, and against an exact ramp.

use super::*;

const DENSE: usize = 3;
/// The dense entries and a bias.
const OWN: usize = 4;
const H: [f64; 2 * DENSE] = [0.3, -1.2, 0.7, 1.5, 0.2, -0.4];

fn late() -> Late {
    let filtered = Lateness { time_constant: 2e-3, delay: 2.4e-3, steps: 3 };
    let delayed = Lateness { time_constant: 0.0, delay: 1e-3, steps: 2 };
    Late::new(&[Some(filtered), Some(delayed)], &[Some(3), None], OWN, DENSE)
}

/// After four steps of a millisecond and on from `mean`, the covariance of `belief` along.
fn moved(late: &mut Late, belief: &mut Gaussian) {
    late.ages = vec![0.0, 1e-3, 2e-3, 3e-3];
    let prediction: Vec<f64> = H.chunks_exact(DENSE).map(|h| linear::dot(h, &belief.mean[..DENSE])).collect();
    late.advance(belief, Linearised { prediction: &prediction, jacobian: &H }, 1e-3);
}

/// T, column by column.
fn transition() -> Vec<Vec<f64>> {
    let mut late = late();
    let n = late.states();
    let column = |j: usize| {
        let mut belief = Gaussian::independent(&vec![1.0; n]);
        belief.mean[j] = 1.0;
        moved(&mut late, &mut belief);
        belief.mean
    };
    (0..n).map(column).collect()
}

#[test]
fn covariance_and_adjoint_follow_the_mean() {
    let (mut late, t) = (late(), transition());
    let n = late.states();
    let mut belief = Gaussian::independent(&vec![1.0; n]);
    moved(&mut late, &mut belief);
    for r in 0..n {
        for c in 0..n {
            let expected: f64 = (0..n).map(|j| t[j][r] * t[j][c]).sum();
            assert!((belief.covariance.at(r, c) - expected).abs() < 1e-14, "{r} {c}");
        }
    }
    let mut memory = Vec::new();
    late.remember(&mut memory);
    assert_eq!(memory.len(), late.memory());
    let (mut lambda, mut big) = (vec![0.0; n.next_multiple_of(linear::LANES)], Symmetric::zeros(n));
    let given: Vec<f64> = (0..n).map(|i| 1.0 + f64::from(i as u32 % 5)).collect();
    lambda[..n].copy_from_slice(&given);
    (0..n).for_each(|i| big.put(i, i, given[i]));
    late.retreat(&memory, &mut lambda, &mut big);
    for r in 0..n {
        let expected: f64 = (0..n).map(|i| t[r][i] * given[i]).sum();
        assert!((lambda[r] - expected).abs() < 1e-13, "{r}: {} {expected}", lambda[r]);
        for c in 0..n {
            let expected: f64 = (0..n).map(|i| t[r][i] * given[i] * t[c][i]).sum();
            assert!((big.at(r, c) - expected).abs() < 1e-13, "{r} {c}");
        }
    }
}

/// dw/dt = (f − w)/T on f = a + b t: w = f − b T (1 − e^(−t/T)) from rest on the line.
#[test]
fn a_filter_follows_a_ramp_exactly_at_uneven_steps() {
    let inside = Lateness { time_constant: 2e-3, delay: 0.0, steps: 0 };
    let mut late = Late::new(&[Some(inside)], &[None], 1, 1);
    let mut belief = Gaussian::independent(&[1.0]);
    let jacobian = [1.0];
    late.start(&mut belief, Linearised { prediction: &[5.0], jacobian: &jacobian });
    let mut t = 0.0;
    for k in 0..40 {
        let dt = if k % 3 == 0 { 1.7e-3 } else { 4e-4 };
        t += dt;
        belief.mean[0] = 5.0 + 3.0 * t;
        let prediction = [belief.mean[0]];
        late.advance(&mut belief, Linearised { prediction: &prediction, jacobian: &jacobian }, dt);
        let expected = 5.0 + 3.0 * t - 3.0 * 2e-3 * (1.0 - crate::scalar::Scalar::exp(-t / 2e-3));
        let read = late.biases()[0].map_or(f64::NAN, |state| belief.mean[state]);
        assert!((read - expected).abs() < 1e-13, "{read} {expected}");
    }
}

#[test]
fn columns_and_their_adjoint_follow_the_mean() {
    let (mut late, t) = (late(), transition());
    let n = late.states();
    moved(&mut late, &mut Gaussian::independent(&vec![1.0; n]));
    let mut memory = Vec::new();
    late.remember(&mut memory);
    let unit = || -> Vec<f64> { (0..n * n).map(|i| f64::from(u8::from(i % (n + 1) == 0))).collect() };
    let (mut forward, mut back) = (unit(), unit());
    late.carry(&mut forward, n, None);
    late.carry_back(&memory, &mut back, n);
    for r in 0..n {
        for c in 0..n {
            assert!((forward[r * n + c] - t[c][r]).abs() < 1e-14, "{r} {c}");
            assert!((back[r * n + c] - t[r][c]).abs() < 1e-14, "{r} {c}");
        }
    }
}
