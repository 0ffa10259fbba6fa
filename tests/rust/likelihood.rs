//! The likelihood against the Kalman filter's own.

mod arm;

use arm::{Mounting, arm, drive};
use linkside_core::error::{DesignError, RunError};
use linkside_core::estimate::kalman::{
    ExtendedKalmanFilter, FilterSettings, Inputs, JerkDriven, JerkModel, JerkNoise, KalmanRecording, Keep,
};
use linkside_core::estimate::likelihood::{Likelihood, LikelihoodRecording, LikelihoodSettings, Parameter};
use linkside_core::estimate::measurement::Kind;
use linkside_core::robot::{Drive, Robot, SoftWindup};
use std::sync::Arc;

const JOINTS: usize = 2;
const SENSORS: usize = 3;
const COUNT: usize = 60;

/// Two joints, one with all nonlinearities that a spring can have, and an accelerometer.
fn robot() -> Arc<Robot> {
    let soft = Drive {
        cubic_stiffness: 3e8,
        soft_windup: SoftWindup { stiffness: 3e4, shape: 1e5 },
        link_friction: [0.5, 150.0, 50.0, 2.0, 100.0, 0.5],
        ..drive()
    };
    let mounting = Mounting { body: 1, at: [0.3, 0.1, 0.2], axes: vec![0, 1, 2], noise_std: 0.05 };
    Arc::new(arm(vec![drive(), soft], &[mounting]))
}

fn wave(width: usize, size: f64, turn: f64) -> Vec<f64> {
    (0..COUNT * width).map(|i| size * (turn * i as f64).sin()).collect()
}

fn recording() -> LikelihoodRecording {
    let mut acceleration = wave(SENSORS, 0.5, 0.3);
    acceleration[40] = f64::NAN;
    LikelihoodRecording {
        t: (0..COUNT).map(|i| 1e-3 * i as f64).collect(),
        theta: wave(JOINTS, 1e-3, 0.11),
        dtheta: wave(JOINTS, 1e-2, 0.07),
        acceleration,
        jerk: wave(JOINTS, 5.0, 0.2),
        period: 1e-3,
    }
}

fn settings() -> LikelihoodSettings {
    let channels = JOINTS + SENSORS;
    let mut reading = vec![1e-4; JOINTS];
    reading.extend([0.05; SENSORS]);
    let noise = JerkNoise {
        jerk: vec![20.0; JOINTS],
        link_walk: [[1e-4; JOINTS], [1e-2; JOINTS]].concat(),
        reading,
        torsion: 1e-2,
        bias_walk: vec![1e-5; channels],
        bias_time: vec![5.0; channels],
        initial: vec![1e-3; 3 * JOINTS],
        initial_bias: vec![1e-3; channels],
    };
    LikelihoodSettings { noise, biased: vec![true; channels], fixed: vec![], huber: f64::INFINITY }
}

fn likelihood() -> Likelihood {
    Likelihood::new(robot(), settings(), recording()).unwrap()
}

/// The Kalman filter's padded, deferred update and the likelihood's sequential one are the same mathematics.
#[test]
fn both_updates_give_each_sample_the_same_likelihood() {
    let LikelihoodSettings { noise, biased, .. } = settings();
    let log = recording();
    let model = JerkModel::new(robot(), &[Kind::Motor, Kind::Acceleration], &biased).unwrap();
    let model = JerkDriven::new(model, noise, true).unwrap();
    let mut filter = ExtendedKalmanFilter::new(model, FilterSettings { gate: None, iterations: 1 }).unwrap();
    let mut readings = Vec::new();
    for i in 0..COUNT {
        readings.extend_from_slice(&log.theta[i * JOINTS..][..JOINTS]);
        readings.extend_from_slice(&log.acceleration[i * SENSORS..][..SENSORS]);
    }
    let inputs = Inputs { dtheta: &log.dtheta, jerk: &log.jerk, tau: &[] };
    let dt = vec![1e-3; COUNT];
    let out = filter.run(KalmanRecording { dt: &dt, readings: &readings, inputs }, Keep::default()).unwrap();
    let found = likelihood().densities(&[], &[]).unwrap();
    for (i, (ours, theirs)) in found.iter().zip(&out.log_likelihood).enumerate() {
        assert!((ours - theirs).abs() <= 1e-12 * theirs.abs().max(1.0), "{i}: {ours} {theirs}");
    }
}

#[test]
fn an_outlier_counts_linearly_beyond_the_limit() {
    let spoilt = |size: f64, huber: f64| {
        let mut log = recording();
        log.theta[COUNT * JOINTS - 1] = size;
        let likelihood = Likelihood::new(robot(), LikelihoodSettings { huber, ..settings() }, log).unwrap();
        likelihood.log_likelihood(&[], &[]).unwrap()
    };
    let growth = |huber| (spoilt(4.0, huber) - spoilt(2.0, huber)) / (spoilt(2.0, huber) - spoilt(1.0, huber));
    assert!((growth(f64::INFINITY) - 4.0).abs() < 0.05, "{}", growth(f64::INFINITY));
    assert!((growth(3.0) - 2.0).abs() < 0.05, "{}", growth(3.0));
}

#[test]
fn what_does_not_fit_is_refused() {
    let missing = Err(RunError::Design(DesignError::NoParameter { parameter: "Damping(2)".into() }));
    let found = likelihood();
    assert_eq!(found.log_likelihood(&[Parameter::Damping(2)], &[1.0]), missing);
    let torque = Err(RunError::Design(DesignError::NoParameter { parameter: "MotorInertia(0)".into() }));
    assert_eq!(found.log_likelihood(&[Parameter::MotorInertia(0)], &[30.0]), torque);
    let short = RunError::Design(DesignError::Length { what: "values", found: 0, expected: 1 });
    assert_eq!(found.densities(&[Parameter::PayloadMass], &[]).unwrap_err(), short);
    let broken = found.log_likelihood(&[Parameter::SensorNoise(0)], &[f64::NAN]);
    assert!(matches!(broken, Err(RunError::NotFinite { .. })));
    let refused = |settings: LikelihoodSettings, log| Likelihood::new(robot(), settings, log).unwrap_err();
    let huber = refused(LikelihoodSettings { huber: 0.0, ..settings() }, recording());
    assert!(matches!(huber, DesignError::Range { what: "huber", .. }));
    let mut log = recording();
    log.t[7] = log.t[6];
    assert!(matches!(refused(settings(), log), DesignError::Range { what: "t", .. }));
    let mut log = recording();
    log.theta[1] = f64::NAN;
    assert_eq!(refused(settings(), log), DesignError::NoStart { joint: 1 });
}
