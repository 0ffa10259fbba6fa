//! A particle filter that knows the limits of the link:
//! `cargo run --release -p linkside-core --example particles`.

use linkside_core::estimate::kalman::{Inputs, JerkDriven, JerkModel, JerkNoise, KalmanSample};
use linkside_core::estimate::measurement::Kind;
use linkside_core::estimate::particle::{
    Collapse, Density, Marginalised, ParticleFilter, ParticleSettings, Proposal, Resampling,
};
use std::error::Error;
use std::sync::Arc;

fn main() -> Result<(), Box<dyn Error>> {
    let robot = Arc::new(linkside_core::demo::arm()?);
    let model = JerkModel::new(robot, &[Kind::Motor], &[false])?;
    let noise = JerkNoise {
        jerk: vec![100.0],
        link_walk: vec![1e-5, 1e-3],
        reading: vec![1e-5],
        torsion: 1e-3,
        bias_walk: vec![0.0],
        bias_time: vec![f64::INFINITY],
        initial: vec![1e-4, 1e-3, 0.1],
        initial_bias: vec![0.0],
    };
    let settings = ParticleSettings {
        particles: 500,
        seed: 0,
        proposal: Proposal::Linearised { iterations: 1, tail: None },
        resampling: Resampling::Systematic,
        threshold: 0.5,
        kernel: None,
        densities: vec![Density::Normal],
        limits: vec![(-3.0, 3.0)],
        initial: vec![],
        collapse: Collapse::Reseed,
        quantiles: vec![],
    };
    let mut filter = ParticleFilter::new(JerkDriven::new(model, noise, false)?, settings, Marginalised::Nothing)?;
    for _ in 0..50 {
        let inputs = Inputs { jerk: &[0.0], dtheta: &[f64::NAN], ..Inputs::default() };
        filter.step(KalmanSample { dt: 1e-3, readings: &[0.1], inputs })?;
    }
    let summary = filter.summary();
    println!("q = {:.6} rad, {:.0} of 500 particles carry weight", summary.mean[0], summary.effective);
    Ok(())
}
