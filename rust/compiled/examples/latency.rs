//! How long a step takes at worst on this machine:
//! `cargo run --release -p linkside-compiled --example latency -- 1000000 robot.lsr …`.
//!
//! Signals wander about zero, so that no two samples are alike; readings of accelerometers are those at rest.

use linkside_compiled::{Estimator, Sample, Signal};
use std::time::Instant;

/// Buckets of a tenth of a microsecond, up to a millisecond.
const BUCKETS: usize = 10_000;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let steps: f64 = arguments.next().ok_or("usage: latency STEPS robot.lsr …")?.parse()?;
    println!(
        "{:<12} {:>6} {:>10} {:>10} {:>10} {:>10}",
        "method", "joints", "p50 [µs]", "p99 [µs]", "p99.9 [µs]", "max [µs]"
    );
    for path in arguments {
        measure(&mut Estimator::read(path)?, steps as u64)?;
    }
    Ok(())
}

fn measure(estimator: &mut Estimator, steps: u64) -> Result<(), Box<dyn std::error::Error>> {
    let widths = Signal::ALL.map(|signal| estimator.width(signal));
    let mut rows = widths.map(|width| vec![0.0; width]);
    let (mut histogram, mut worst) = (vec![0_u64; BUCKETS + 1], 0.0_f64);
    let period = estimator.period().unwrap_or(2.5e-4);
    for step in 0..steps {
        let phase = 1e-3 * step as f64 * period;
        for row in &mut rows {
            row.iter_mut().enumerate().for_each(|(i, x)| *x = 1e-3 * (phase * (1.0 + i as f64)).sin());
        }
        let [theta, dtheta, tau, acceleration, rate, q, dq, ddq, torque, ddqref, wrench, position] = &rows;
        let sample =
            Sample { dt: period, theta, dtheta, tau, acceleration, rate, q, dq, ddq, torque, ddqref, wrench, position };
        let start = Instant::now();
        estimator.step(&sample)?;
        let taken = start.elapsed().as_secs_f64() * 1e6;
        worst = worst.max(taken);
        histogram[((10.0 * taken) as usize).min(BUCKETS)] += 1;
    }
    let below = |share: f64| {
        let mut sum = 0;
        let found = histogram.iter().position(|count| {
            sum += count;
            sum as f64 >= share * steps as f64
        });
        found.map_or(f64::INFINITY, |bucket| (bucket + 1) as f64 / 10.0)
    };
    let joints = estimator.robot().len();
    let [p50, p99, p999] = [0.5, 0.99, 0.999].map(below);
    println!("{:<12} {joints:>6} {p50:>10.1} {p99:>10.1} {p999:>10.1} {worst:>10.1}", estimator.method());
    Ok(())
}
