//! Clouds that share, and clouds that do not.

use super::super::{Collapse, Density, Marginalised, ParticleFilter, ParticleSettings, Proposal, Resampling};
use crate::estimate::kalman::{Inputs, JerkDriven, JerkModel, JerkNoise, KalmanSample};
use crate::estimate::measurement::Kind;
use crate::robot::{BodySpec, Drive, JointKind, Robot, Sensor, Tree};
use crate::spatial::{Mat3, Vec3};
use std::sync::Arc;

/// A pendulum behind a spring, with an accelerometer at its end.
fn model() -> JerkDriven {
    let body = BodySpec {
        parent: None,
        joint: 0,
        kind: JointKind::Revolute,
        rotation: Mat3::IDENTITY,
        translation: Vec3([0.0; 3]),
        axis: Vec3([0.0, 1.0, 0.0]),
        mass: 20.0,
        com: Vec3([0.0, 0.0, 0.5]),
        inertia: Mat3::IDENTITY,
    };
    let tree = Tree::new(Vec3([0.0, 0.0, -9.81]), &[body]).unwrap();
    let frame = tree.frame("end", 0, &Mat3::IDENTITY, &Vec3([0.0, 0.0, 1.0])).unwrap();
    let drive = Drive::spring(1e5, 50.0, 10.0);
    let sensor = Sensor { frame, axes: vec![0, 2], noise_std: 0.05 };
    let robot = Robot::new(tree, vec![drive], vec![0.0], vec![sensor], vec![], None).unwrap();
    let noise = JerkNoise {
        jerk: vec![50.0],
        reading: vec![1e-5, 0.05, 0.05],
        torsion: 0.0,
        link_walk: vec![0.0; 2],
        bias_walk: vec![1e-6, 1e-3, 1e-3],
        bias_time: vec![f64::INFINITY; 3],
        initial: vec![1e-4, 1e-3, 0.1],
        initial_bias: vec![1e-5, 0.1, 0.1],
    };
    JerkDriven::new(
        JerkModel::new(Arc::new(robot), &[Kind::Motor, Kind::Acceleration], &[true; 3]).unwrap(),
        noise,
        true,
    )
    .unwrap()
}

/// Whether each of three steps at rest shared its linearisation, and the likelihood of the last.
fn steps(initial: &[f64], iterations: usize) -> ([bool; 3], f64) {
    let settings = ParticleSettings {
        particles: 64,
        seed: 1,
        proposal: Proposal::Linearised { iterations, tail: None },
        resampling: Resampling::Systematic,
        threshold: 0.0, // whoever is far from the readings stays
        kernel: None,
        densities: vec![Density::Normal; 3],
        limits: vec![(f64::NEG_INFINITY, f64::INFINITY)],
        initial: initial.to_vec(),
        collapse: Collapse::Flag,
        quantiles: vec![],
    };
    let mut filter = ParticleFilter::new(model(), settings, Marginalised::Biases).unwrap();
    let inputs = Inputs { dtheta: &[0.0], jerk: &[0.0], tau: &[] };
    let shared = [(); 3].map(|()| {
        filter.step(KalmanSample { dt: 1e-3, readings: &[0.0, 0.0, 9.81], inputs }).unwrap();
        filter.sharing
    });
    (shared, filter.summary().log_likelihood)
}

#[test]
fn a_narrow_cloud_shares_and_finds_what_each_particle_finds() {
    let ((shared, one), (never, own)) = (steps(&[], 1), steps(&[], 2));
    assert_eq!((shared, never), ([false, true, true], [false; 3]));
    assert!((one / own - 1.0).abs() < 1e-3, "{one} {own}");
}

#[test]
fn a_wide_cloud_does_not() {
    assert_eq!(steps(&[-0.6, 0.6], 1).0, [false; 3]);
}
