//! An extended Kalman filter, sample by sample and over a recording: `cargo run --release -p linkside-core --example filter`.

use linkside_core::estimate::kalman::{
    ExtendedKalmanFilter, FilterSettings, Inputs, JerkDriven, JerkModel, JerkNoise, KalmanRecording, KalmanSample, Keep,
};
use linkside_core::estimate::measurement::Kind;
use std::error::Error;
use std::sync::Arc;

const DT: f64 = 1e-3;
const SAMPLES: usize = 500;

fn main() -> Result<(), Box<dyn Error>> {
    // A swing of the motor, 0.1 rad at 1 Hz; the accelerometer at the tip is along the circle in y, and feels gravity in z.
    let w = std::f64::consts::TAU;
    let readings: Vec<f64> = (0..SAMPLES)
        .map(|k| DT * k as f64)
        .flat_map(|t| [0.1 * (w * t).sin(), -(0.1 * w * (w * t).cos()).powi(2), -0.1 * w * w * (w * t).sin(), 9.81])
        .collect();

    let mut live = filter()?;
    let inputs = Inputs { jerk: &[0.0], dtheta: &[f64::NAN], ..Inputs::default() };
    let mut last = 0.0;
    for row in readings.chunks_exact(4) {
        live.step(KalmanSample { dt: DT, readings: row, inputs })?;
        last = live.belief().mean[0];
    }
    let std = live.belief().covariance.at(0, 0).sqrt();
    println!("q = {last:.6} rad, standard deviation {std:.1e}");

    let (jerk, dtheta) = (vec![0.0; SAMPLES], vec![f64::NAN; SAMPLES]);
    let inputs = Inputs { jerk: &jerk, dtheta: &dtheta, ..Inputs::default() };
    let recording = KalmanRecording { dt: &[DT; SAMPLES], readings: &readings, inputs };
    let whole = filter()?.run(recording, Keep::default())?;
    println!("over the recording the same bits: {}", whole.q[SAMPLES - 1].to_bits() == last.to_bits());
    Ok(())
}

/// Positions of the motor and an accelerometer with three axes, on a state of position, velocity and acceleration.
fn filter() -> Result<ExtendedKalmanFilter<JerkDriven>, Box<dyn Error>> {
    let robot = Arc::new(linkside_core::demo::arm()?);
    let model = JerkModel::new(robot, &[Kind::Motor, Kind::Acceleration], &[false; 4])?;
    let noise = JerkNoise {
        jerk: vec![100.0],
        link_walk: vec![0.0; 2],
        reading: vec![1e-5, 0.05, 0.05, 0.05],
        torsion: 1e-3,
        bias_walk: vec![0.0; 4],
        bias_time: vec![f64::INFINITY; 4],
        initial: vec![1e-4, 1.0, 0.1],
        initial_bias: vec![0.0; 4],
    };
    let settings = FilterSettings { gate: None, iterations: 1 };
    Ok(ExtendedKalmanFilter::new(JerkDriven::new(model, noise, false)?, settings)?)
}
