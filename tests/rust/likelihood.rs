//! The likelihood against the Kalman filter's own, and its gradient against differences of it.

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

fn recording(torque: bool) -> LikelihoodRecording {
    let mut acceleration = wave(SENSORS, 0.5, 0.3);
    acceleration[40] = f64::NAN;
    let motors = |size, turn| if torque { wave(JOINTS, size, turn) } else { vec![] };
    LikelihoodRecording {
        t: (0..COUNT).map(|i| 1e-3 * i as f64).collect(),
        theta: wave(JOINTS, 1e-3, 0.11),
        dtheta: wave(JOINTS, 1e-2, 0.07),
        ddtheta: motors(0.3, 0.05),
        tau: motors(20.0, 0.03),
        acceleration,
        jerk: wave(JOINTS, 5.0, 0.2),
        period: 1e-3,
    }
}

fn settings(torque: bool) -> LikelihoodSettings {
    let channels = JOINTS + SENSORS + if torque { JOINTS } else { 0 };
    let mut reading = vec![1e-4; JOINTS];
    reading.extend([0.05; SENSORS]);
    reading.extend(vec![3.0; channels - reading.len()]);
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
    LikelihoodSettings { noise, biased: vec![true; channels], torque, fixed: vec![], huber: f64::INFINITY }
}

fn likelihood(torque: bool) -> Likelihood {
    Likelihood::new(robot(), settings(torque), recording(torque)).unwrap()
}

/// The Kalman filter's padded, deferred update and the likelihood's sequential one are the same mathematics.
#[test]
fn both_updates_give_each_sample_the_same_likelihood() {
    let LikelihoodSettings { noise, biased, .. } = settings(false);
    let log = recording(false);
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
    let found = likelihood(false).evaluate(&[], &[], true).unwrap();
    let m = JOINTS + SENSORS;
    for (i, innovations) in found.innovations.chunks_exact(m).enumerate() {
        let nis: f64 = innovations.iter().filter(|v| !v.is_nan()).map(|v| v * v).sum();
        assert!((nis - out.nis[i]).abs() <= 1e-12 * nis.max(1.0), "{i}: {nis} {}", out.nis[i]);
    }
    let theirs: f64 = out.log_likelihood.iter().sum();
    let scale: f64 = out.log_likelihood.iter().map(|l| l.abs()).sum();
    assert!((found.log_likelihood - theirs).abs() <= 1e-12 * scale, "{} {theirs}", found.log_likelihood);
    assert_eq!(found.used, out.used.iter().sum::<u32>() as usize);
}

/// Every kind of parameter, its value, and a step that changes the likelihood by a little.
fn everything() -> Vec<(Parameter, f64, f64)> {
    use Parameter as P;
    vec![
        (P::Stiffness(0), 1.1e5, 1e2),
        (P::CubicStiffness(1), 2.5e8, 1e6),
        (P::Damping(1), 70.0, 1.0),
        (P::MotorInertia(0), 28.0, 2.0),
        (P::ViscousFriction(1), 12.0, 2.0),
        (P::CoulombFriction(0), 4.0, 1.0),
        (P::Coupling(0, 1), 0.5, 0.2),
        (P::MassScale(1), 1.1, 1e-3),
        (P::PayloadMass, 2.0, 1e-2),
        (P::PayloadCentre(2), 0.05, 1e-3),
        (P::SensorTranslation(0, 1), 0.01, 1e-3),
        (P::SensorRotation(0, 2), 0.02, 1e-4),
        (P::SensorBias(0, 0), 0.1, 2e-2),
        (P::SensorScale(0, 1), 1.02, 1e-3),
        (P::TimeConstant(0), 8e-4, 1e-6),
        (P::Delay(0), 2.3e-4, 1e-6),
        (P::MotorNoise(0), 1.5, 1e-2),
        (P::SensorNoise(0), 0.8, 1e-3),
        (P::TorqueNoise(1), 1.3, 1e-2),
        (P::JerkNoise(0), 0.7, 1e-3),
    ]
}

fn split(all: &[(Parameter, f64, f64)]) -> (Vec<Parameter>, Vec<f64>) {
    all.iter().map(|(p, v, _)| (*p, *v)).unzip()
}

/// Central differences extrapolated twice (Richardson): exact to eighth order in the step.
fn difference(f: impl Fn(f64) -> f64, step: f64) -> f64 {
    let plain = |h: f64| (f(h) - f(-h)) / (2.0 * h);
    let (a, b, c) = (plain(step), plain(2.0 * step), plain(4.0 * step));
    let (ab, bc) = ((4.0 * a - b) / 3.0, (4.0 * b - c) / 3.0);
    (16.0 * ab - bc) / 15.0
}

#[test]
fn gradient_is_that_of_the_likelihood_in_every_parameter() {
    let likelihood = likelihood(true);
    let all = everything();
    let (names, values) = split(&all);
    let found = likelihood.evaluate(&names, &values, true).unwrap();
    let plain = likelihood.log_likelihood(&names, &values).unwrap();
    assert!((found.log_likelihood / plain - 1.0).abs() < 1e-13);
    for (i, &(name, value, step)) in all.iter().enumerate() {
        let at = |change: f64| {
            let mut moved = values.clone();
            moved[i] = value + change;
            likelihood.log_likelihood(&names, &moved).unwrap()
        };
        let slope = difference(at, step);
        // What rounding of the likelihood leaves of a difference.
        let lost = 1e-13 * plain.abs() / step;
        assert!(
            (found.gradient[i] - slope).abs() < 1e-8 * slope.abs() + lost,
            "{name:?}: {} {slope}",
            found.gradient[i]
        );
        let total: f64 = (0..COUNT).map(|t| found.scores[t * names.len() + i]).sum();
        assert!((total - found.gradient[i]).abs() < 1e-9 * found.gradient[i].abs().max(1.0));
    }
}

#[test]
fn derivatives_do_not_depend_on_the_pass_that_carries_them() {
    let likelihood = likelihood(true);
    let mut all = everything();
    let (names, values) = split(&all);
    let forth = likelihood.evaluate(&names, &values, false).unwrap();
    all.reverse();
    let (names, values) = split(&all);
    let back = likelihood.evaluate(&names, &values, false).unwrap();
    let p = names.len();
    for i in 0..p {
        assert_eq!(forth.gradient[i], back.gradient[p - 1 - i]);
        for j in 0..p {
            assert_eq!(forth.information[i * p + j], back.information[(p - 1 - i) * p + p - 1 - j]);
        }
    }
}

#[test]
fn an_outlier_counts_linearly_beyond_the_limit() {
    let spoilt = |size: f64, huber: f64| {
        let mut log = recording(false);
        log.theta[COUNT * JOINTS - 1] = size;
        let likelihood = Likelihood::new(robot(), LikelihoodSettings { huber, ..settings(false) }, log).unwrap();
        likelihood.log_likelihood(&[], &[]).unwrap()
    };
    let growth = |huber| (spoilt(4.0, huber) - spoilt(2.0, huber)) / (spoilt(2.0, huber) - spoilt(1.0, huber));
    assert!((growth(f64::INFINITY) - 4.0).abs() < 0.05, "{}", growth(f64::INFINITY));
    assert!((growth(3.0) - 2.0).abs() < 0.05, "{}", growth(3.0));
}

#[test]
fn what_does_not_fit_is_refused() {
    let missing = Err(RunError::Design(DesignError::NoParameter { parameter: "Damping(2)".into() }));
    let found = likelihood(false);
    assert_eq!(found.log_likelihood(&[Parameter::Damping(2)], &[1.0]), missing);
    let short = RunError::Design(DesignError::Length { what: "values", found: 0, expected: 1 });
    assert_eq!(found.evaluate(&[Parameter::PayloadMass], &[], false).unwrap_err(), short);
    let broken = found.log_likelihood(&[Parameter::SensorNoise(0)], &[f64::NAN]);
    assert!(matches!(broken, Err(RunError::NotFinite { .. })));
    let refused = |settings: LikelihoodSettings, log| Likelihood::new(robot(), settings, log).unwrap_err();
    let huber = refused(LikelihoodSettings { huber: 0.0, ..settings(false) }, recording(false));
    assert!(matches!(huber, DesignError::Range { what: "huber", .. }));
    let torque = refused(settings(true), recording(false));
    assert!(matches!(torque, DesignError::Length { what: "ddtheta", .. }));
    let mut log = recording(false);
    log.t[7] = log.t[6];
    assert!(matches!(refused(settings(false), log), DesignError::Range { what: "t", .. }));
    let mut log = recording(false);
    log.theta[1] = f64::NAN;
    assert_eq!(refused(settings(false), log), DesignError::NoStart { joint: 1 });
}
