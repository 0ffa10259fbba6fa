//! Against the joint density of path, accelerations, biases and readings, formed whole.

use super::super::process_noise::JointNoise;
use super::*;
use crate::estimate::bias::BiasStep;
use crate::estimate::jerk_noise;
use nalgebra::{DMatrix, DVector};
use proptest::prelude::*;

const N: usize = 2;
/// Two accelerations, two biases.
const L: usize = 4;
const D: usize = 2 * N + L;
const DT: f64 = 0.3;
/// Which bias adds to each reading.
const BIASES: [Option<usize>; 3] = [Some(2), None, Some(3)];
/// What is left of each bias after the step.
const DECAYS: [f64; L - N] = [0.6, 1.0];
const VARIANCE: f64 = 0.2;
/// How the second reading depends on all biases, as a late one does.
const MIXED: [f64; L - N] = [0.3, -0.7];

#[derive(Debug)]
struct Case {
    prior: DMatrix<f64>,
    walks: [f64; 2 * N],
    jerk: [f64; N],
    gained: [f64; L - N],
    rows: DMatrix<f64>,
    errors: DVector<f64>,
}

fn cases() -> impl Strategy<Value = Case> {
    let numbers = |count| prop::collection::vec(-1.0..1.0_f64, count);
    (numbers(L * L), numbers(2 * N), numbers(L), numbers(3 * 3 * N), numbers(3)).prop_map(
        |(root, walks, noise, rows, errors)| {
            let root = DMatrix::from_vec(L, L, root);
            Case {
                prior: &root * root.transpose() + DMatrix::identity(L, L) * 0.01,
                walks: core::array::from_fn(|i| 0.02 + walks[i].abs()),
                jerk: core::array::from_fn(|j| 3.0 * noise[j].abs()),
                gained: core::array::from_fn(|i| noise[N + i].abs()),
                rows: DMatrix::from_vec(3, 3 * N, rows),
                errors: DVector::from_vec(errors),
            }
        },
    )
}

impl Case {
    fn motion(&self) -> ProcessNoise {
        let walks = |j: usize| [self.walks[j].powi(2), self.walks[N + j].powi(2)];
        let joints = (0..N).map(|j| JointNoise::new(self.jerk[j], walks(j), DT)).collect();
        let step = |(&variance, decay)| BiasStep { decay, variance };
        ProcessNoise { dt: DT, joints, biases: self.gained.iter().zip(DECAYS).map(step).collect() }
    }

    fn conditional(&self) -> Conditional<f64> {
        let mut out = Conditional::new(N, L);
        out.covariance = (0..L).flat_map(|r| (r..L).map(move |c| self.prior[(r, c)])).collect();
        out.follow(&self.motion());
        out
    }

    /// Covariance of (n, l) where nothing is known of the path.
    fn joint(&self) -> DMatrix<f64> {
        let mut map = DMatrix::zeros(D, L);
        map.view_mut((2 * N, 0), (L, L)).fill_with_identity();
        for (i, decay) in DECAYS.into_iter().enumerate() {
            map[(3 * N + i, N + i)] = decay;
        }
        for j in 0..N {
            (map[(j, j)], map[(N + j, j)]) = (0.5 * DT * DT, DT);
        }
        let mut own = DMatrix::zeros(D, D);
        for (i, walk) in self.walks.iter().enumerate() {
            own[(i, i)] = walk * walk;
        }
        let white_jerk = jerk_noise::covariance(DT);
        for j in 0..N {
            for (a, b) in (0..3).flat_map(|a| (0..3).map(move |b| (a, b))) {
                own[(a * N + j, b * N + j)] += self.jerk[j].powi(2) * white_jerk[a][b];
            }
        }
        for (i, gained) in self.gained.iter().enumerate() {
            own[(3 * N + i, 3 * N + i)] = *gained;
        }
        &map * &self.prior * map.transpose() + own
    }

    /// ∂h/∂(n, l).
    fn readings(&self) -> DMatrix<f64> {
        let mut out = DMatrix::zeros(3, D);
        out.view_mut((0, 0), (3, 3 * N)).copy_from(&self.rows);
        for (i, bias) in BIASES.iter().enumerate() {
            if let Some(b) = bias {
                out[(i, 2 * N + b)] += 1.0;
            }
        }
        for (b, slope) in MIXED.into_iter().enumerate() {
            out[(1, 3 * N + b)] += slope;
        }
        out
    }
}

/// ∂(n, l)/∂ζ.
fn map(conditional: &Conditional<f64>, motion: &ProcessNoise) -> DMatrix<f64> {
    let mut out = DMatrix::zeros(D, 2 * N);
    for (k, mut column) in out.column_iter_mut().enumerate() {
        let mut noise = [0.0; 2 * N];
        noise[k] = 1.0;
        conditional.displace(motion, &[0.0; D], &noise, column.as_mut_slice());
    }
    out
}

fn whole(covariance: &[f64]) -> DMatrix<f64> {
    DMatrix::from_fn(L, L, |r, c| covariance[packed(r.min(c), r.max(c), L)])
}

fn close(a: &DMatrix<f64>, b: &DMatrix<f64>) {
    assert!((a - b).amax() < 1e-11 * (1.0 + b.amax()), "{a} {b}");
}

proptest! {
    #[test]
    fn a_drawn_path_and_what_follows_from_it_have_the_joint_covariance(case in cases()) {
        let conditional = case.conditional();
        let map = map(&conditional, &case.motion());
        let mut found = &map * map.transpose();
        let mut own = found.view_mut((2 * N, 2 * N), (L, L));
        own += whole(&conditional.covariance);
        close(&found, &case.joint());
    }

    /// The path by the readings, and accelerations and biases by both, against the joint density of all.
    #[test]
    fn readings_tell_what_the_joint_density_says(case in cases()) {
        let (motion, mut conditional) = (case.motion(), case.conditional());
        let map = map(&conditional, &motion);
        let (mut mean, mut information) = (DVector::zeros(L), DMatrix::identity(2 * N, 2 * N));
        let (mut pull, mut volume) = (DVector::zeros(2 * N), 1.0);
        for (i, bias) in BIASES.into_iter().enumerate() {
            let links: Vec<f64> = case.rows.row(i).iter().copied().collect();
            let biases = if i == 1 { &MIXED[..] } else { &[] };
            let row = ReadingSlope { links: &links, bias, biases };
            let mixed: f64 = biases.iter().enumerate().map(|(b, slope)| slope * mean[N + b]).sum();
            let known = mixed + bias.map_or(0.0, |b| mean[b]) + (0..N).map(|j| links[2 * N + j] * mean[j]).sum::<f64>();
            let mut by_noise = DVector::zeros(2 * N);
            conditional.by_noise(&motion, row, by_noise.as_mut_slice());
            let variance = conditional.observe(row, VARIANCE);
            conditional.tilt(by_noise.as_slice());
            let error = case.errors[i] - known;
            mean += DVector::from_row_slice(&conditional.gain) * error;
            pull += &by_noise * (error / variance);
            information += &by_noise * by_noise.transpose() / variance;
            volume *= variance;
        }
        let spread = information.clone().try_inverse().unwrap();
        let mode = &spread * pull;
        let slope = DMatrix::from_row_slice(L, 2 * N, &conditional.slope);
        let mut found = map.clone();
        found.view_mut((2 * N, 0), (L, 2 * N)).copy_from(&slope);

        let (joint, h) = (case.joint(), case.readings());
        let s = &h * &joint * h.transpose() + DMatrix::identity(3, 3) * VARIANCE;
        let gain = &joint * h.transpose() * s.clone().try_inverse().unwrap();
        let mut found_mean = DVector::zeros(D);
        found_mean.rows_mut(0, 2 * N).copy_from(&(map.rows(0, 2 * N) * &mode));
        found_mean.rows_mut(2 * N, L).copy_from(&(mean + &slope * &mode));
        assert!((found_mean - &gain * &case.errors).amax() < 1e-10);
        let mut covariance = &found * spread * found.transpose();
        let mut own = covariance.view_mut((2 * N, 2 * N), (L, L));
        own += whole(&conditional.covariance);
        close(&covariance, &(&joint - gain * h * &joint));
        assert!((volume * information.determinant() / s.determinant() - 1.0).abs() < 1e-10);
    }
}
