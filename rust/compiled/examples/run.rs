//! Load, step, read: `cargo run --release -p linkside-compiled --example run -- robot.lsr`.

use linkside_compiled::{Estimator, Sample, Signal};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let path = std::env::args().nth(1).ok_or("usage: run robot.lsr")?;
    let mut estimator = Estimator::read(path)?;
    println!("{} of joints {:?}", estimator.method(), estimator.description().joints);
    for signal in Signal::ALL.into_iter().filter(|signal| estimator.width(*signal) > 0) {
        println!("reads {} of {}", estimator.width(signal), signal.name());
    }

    // A robot that stands at zero; a controller has what its drives and sensors say.
    let zeros = |signal| vec![0.0; estimator.width(signal)];
    let (theta, tau, acceleration) = (zeros(Signal::Theta), zeros(Signal::Tau), zeros(Signal::Acceleration));
    let sample = Sample { dt: 2.5e-4, theta: &theta, tau: &tau, acceleration: &acceleration, ..Sample::default() };
    for _ in 0..1000 {
        estimator.step(&sample)?;
    }
    for name in estimator.names() {
        println!("{name}: {:.6?}", estimator.get(name).unwrap_or_default());
    }
    println!("status: {}", estimator.status());
    Ok(())
}
