//! `step` of each estimator, as a sequence of calls with any numbers.

use super::bytes::Bytes;
use linkside_compiled::{Estimator, Sample, Signal};

/// Compiled robots, one of each estimator.
pub const FILES: [&[u8]; 4] = [
    include_bytes!("../../tests/data/compiled/observer.lsr"),
    include_bytes!("../../tests/data/compiled/ekf.lsr"),
    include_bytes!("../../tests/data/compiled/elastic-ekf.lsr"),
    include_bytes!("../../tests/data/compiled/velocity.lsr"),
];

const ESTIMATES: [&str; 7] = ["q", "dq", "ddq", "theta", "dtheta", "q_std", "tool_position"];

/// An estimate after a step that succeeded has no NaN and no infinity.
fn check(estimator: &Estimator) {
    for name in ESTIMATES {
        let values = estimator.get(name).unwrap_or(&[]);
        assert!(
            values.iter().all(|x| x.is_finite()),
            "{name} is {values:?}, with status {}: {:?}",
            estimator.status(),
            ESTIMATES.map(|name| estimator.get(name))
        );
    }
    let stds = estimator.get("q_std").unwrap_or(&[]);
    assert!(stds.iter().all(|&std| std >= 0.0), "a standard deviation is negative: {stds:?}");
}

/// Steps, resets and looks at the covariance, as long as there are bytes.
fn sequence(mut estimator: Estimator, bytes: &mut Bytes<'_>) {
    let widths = Signal::ALL.map(|signal| estimator.width(signal));
    while !bytes.is_empty() {
        match bytes.below(16) {
            0 => estimator.reset(),
            1 => {
                let states = estimator.states();
                let mut covariance = vec![0.0; states * states];
                estimator.covariance_into(&mut covariance).expect("its length is right");
                assert!((0..states).all(|i| (0..i).all(|j| {
                    let (a, b) = (covariance[i * states + j], covariance[j * states + i]);
                    a.to_bits() == b.to_bits()
                })));
            }
            _ => {
                let dt = if bytes.byte() < 240 { 1e-3 } else { bytes.number() };
                let signals = widths.map(|width| match bytes.below(16) {
                    0 => vec![],
                    1 => bytes.numbers(width + 1),
                    2 => vec![f64::NAN; width],
                    _ => bytes.numbers(width),
                });
                if estimator.step(&sample(dt, &signals)).is_ok() {
                    check(&estimator);
                }
            }
        }
    }
    rest(estimator, bytes);
}

/// Whatever was before, after a reset an estimator takes plain samples.
pub fn rest(mut estimator: Estimator, bytes: &mut Bytes<'_>) {
    estimator.reset();
    let signals =
        Signal::ALL.map(|signal| bytes.take(0).iter().map(|_| 0.0).chain(vec![0.1; estimator.width(signal)]).collect());
    for _ in 0..5 {
        if estimator.step(&sample(estimator.period().unwrap_or(1e-3), &signals)).is_ok() {
            check(&estimator);
        }
    }
}

fn sample(dt: f64, signals: &[Vec<f64>; Signal::ALL.len()]) -> Sample<'_> {
    let [theta, dtheta, tau, acceleration, rate, q, dq, ddq, torque, ddqref, wrench, position] = signals;
    Sample { dt, theta, dtheta, tau, acceleration, rate, q, dq, ddq, torque, ddqref, wrench, position }
}

fn of(file: usize, data: &[u8]) {
    let estimator = Estimator::from_bytes(FILES[file]).expect("a file of the tests");
    sequence(estimator, &mut Bytes(data));
}

/// The acceleration-driven observer.
pub fn step_observer(data: &[u8]) {
    of(0, data);
}

/// The Kalman filter on the jerk-driven model.
pub fn step_ekf(data: &[u8]) {
    of(1, data);
}

/// The Kalman filter on the elastic-joint model.
pub fn step_elastic(data: &[u8]) {
    of(2, data);
}

/// The velocity observer.
pub fn step_velocity(data: &[u8]) {
    of(3, data);
}
