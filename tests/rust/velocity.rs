//! Velocity observers: exact where a closed form is, and errors before any work.

#[path = "arm.rs"]
mod arm;

use linkside_core::error::{DesignError, RunError};
use linkside_core::estimate::velocity::{Gains, Logic, Recording, Schedule, Settings, VelocityObserver};
use linkside_core::robot::{Drive, MotorFriction};
use std::sync::Arc;

const PERIOD: f64 = 1e-3;

fn one_joint() -> Vec<Drive> {
    vec![Drive { motor_friction: MotorFriction::default(), ..arm::drive() }]
}

fn observer(drives: Vec<Drive>, gains: Gains, spring: f64) -> Result<VelocityObserver, DesignError> {
    let n = drives.len();
    let settings =
        Settings { period: PERIOD, gains, spring: vec![spring; n], motors: true, wrap: vec![f64::INFINITY; n] };
    VelocityObserver::new(Arc::new(arm::arm(drives, &[])), settings)
}

/// About the vertical, without friction, a constant torque gives a constant acceleration.
#[test]
fn an_error_falls_by_the_stated_gain_under_constant_acceleration() {
    let mut settled = observer(one_joint(), Gains::Constant(vec![150.0]), 0.0).unwrap();
    settled.step(&[0.0], &[40.0]).unwrap();
    let a = settled.ddq()[0];
    assert!(a > 0.0);
    for k in 1..200 {
        let t = PERIOD * f64::from(k);
        settled.step(&[0.5 * t + 0.5 * a * t * t], &[40.0]).unwrap();
        let error = 0.5 + a * t - settled.dq()[0];
        assert!((error - 0.5 * (-150.0 * t).exp()).abs() < 1e-12, "{k}: {error}");
    }
}

#[test]
fn a_run_is_its_steps() {
    let drives = || vec![arm::drive(); 6];
    let make = || observer(drives(), Gains::Constant(vec![80.0; 6]), 50.0).unwrap();
    let q: Vec<f64> = (0..600).map(|i| (0.01 * f64::from(i)).sin()).collect();
    let torque = vec![3.0; 600];
    let whole = make().run(Recording { count: 100, q: &q, torque: &torque }).unwrap();
    let mut stepped = make();
    for (k, (q, torque)) in q.chunks_exact(6).zip(torque.chunks_exact(6)).enumerate() {
        stepped.step(q, torque).unwrap();
        assert_eq!(stepped.dq(), &whole.dq[6 * k..][..6]);
        assert_eq!(stepped.ddq(), &whole.ddq[6 * k..][..6]);
    }
}

#[test]
fn refuses_what_cannot_be_used() {
    let refused = |gains, spring| observer(one_joint(), gains, spring).err();
    assert!(matches!(refused(Gains::Constant(vec![2001.0]), 0.0), Some(DesignError::FastGain { .. })));
    assert!(matches!(refused(Gains::Constant(vec![f64::NAN]), 0.0), Some(DesignError::Range { .. })));
    assert!(matches!(refused(Gains::Constant(vec![1.0; 2]), 0.0), Some(DesignError::Length { .. })));
    assert!(matches!(refused(Gains::Constant(vec![1.0]), -1.0), Some(DesignError::Range { .. })));
    let schedule = Schedule {
        gains: vec![10.0],
        bound: 1.0,
        margin: 1.5,
        hysteresis: 0.1,
        start: 1,
        dwell: 0,
        logic: Logic::Repaired,
    };
    assert!(matches!(refused(Gains::Scheduled(schedule), 0.0), Some(DesignError::Range { .. })));
}

#[test]
fn refuses_a_start_that_cannot_be_used() {
    let mut stiff = observer(one_joint(), Gains::Constant(vec![1.0]), 1e9).unwrap();
    let error = stiff.step(&[0.0], &[0.0]).unwrap_err();
    assert!(matches!(error, RunError::Design(DesignError::StiffSpring { .. })));
    let mut blind = observer(one_joint(), Gains::Constant(vec![1.0]), 0.0).unwrap();
    let error = blind.step(&[f64::NAN], &[0.0]).unwrap_err();
    assert!(matches!(error, RunError::Design(DesignError::NoStart { joint: 0 })));
}

#[test]
fn names_the_sample_at_which_the_estimate_is_no_number() {
    let mut observer = observer(one_joint(), Gains::Constant(vec![1.0]), 0.0).unwrap();
    let error = observer.run(Recording { count: 2, q: &[0.0, f64::INFINITY], torque: &[0.0; 2] }).unwrap_err();
    assert!(matches!(error, RunError::NotFinite { sample: 1 } | RunError::SingularInertia { sample: 1 }));
}
