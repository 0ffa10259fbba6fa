//! Velocity observers: exact where a closed form is, and errors before any work.

#[path = "arm.rs"]
mod arm;

use linkside_core::error::{DesignError, RunError};
use linkside_core::estimate::observer::Start;
use linkside_core::estimate::velocity::{
    GainMap, Gains, Logic, Schedule, VelocityObserver, VelocityRecording, VelocitySettings,
};
use linkside_core::robot::{Drive, Friction};
use proptest::prelude::*;
use std::sync::Arc;

const PERIOD: f64 = 1e-3;

fn one_joint() -> Vec<Drive> {
    vec![Drive { motor_friction: Friction::default(), ..arm::drive() }]
}

fn observer(drives: Vec<Drive>, gains: Gains, spring: f64) -> Result<VelocityObserver, DesignError> {
    sampled(drives, gains, spring, PERIOD)
}

fn sampled(drives: Vec<Drive>, gains: Gains, spring: f64, period: f64) -> Result<VelocityObserver, DesignError> {
    let n = drives.len();
    let settings = VelocitySettings {
        period,
        gains,
        spring: vec![spring; n],
        motors: true,
        start: Start::Rest,
        wrap: vec![f64::INFINITY; n],
    };
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
    let whole = make().run(VelocityRecording { count: 100, q: &q, torque: &torque }).unwrap();
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
    let error = observer.run(VelocityRecording { count: 2, q: &[0.0, f64::INFINITY], torque: &[0.0; 2] }).unwrap_err();
    assert!(matches!(error, RunError::NotFinite { sample: 1 } | RunError::SingularInertia { sample: 1 }));
}

/// Errors of velocity, sampled, of a joint that turns under a constant torque, from one of 0.5 rad/s.
fn errors(gain: f64, spring: f64, period: f64, count: u32) -> Vec<f64> {
    let mut full = sampled(one_joint(), Gains::Constant(vec![gain]), spring, period).unwrap();
    full.step(&[0.0], &[40.0]).unwrap();
    let a = full.ddq()[0];
    let error = |k: u32| {
        let t = period * f64::from(k);
        full.step(&[0.5 * t + 0.5 * a * t * t], &[40.0]).unwrap();
        0.5 + a * t - full.dq()[0]
    };
    (1..count).map(error).collect()
}

/// Inertia of the one joint [kg m²].
fn inertia() -> f64 {
    let mut free = observer(one_joint(), Gains::Constant(vec![1.0]), 0.0).unwrap();
    free.step(&[0.0], &[1.0]).unwrap();
    free.ddq()[0].recip()
}

/// ỹ″ + kỹ′ + (K_P/M) ỹ = 0 from ỹ = 0.
#[test]
fn a_spring_makes_a_damped_oscillator_to_second_order() {
    let (gain, frequency) = (60.0, 80.0_f64);
    let spring = inertia() * (frequency.powi(2) + gain * gain / 4.0);
    let closed = |t: f64| {
        0.5 * (-gain / 2.0 * t).exp() * ((frequency * t).cos() - gain / 2.0 / frequency * (frequency * t).sin())
    };
    let apart = |refined: u32| {
        let period = PERIOD / f64::from(refined);
        let found = errors(gain, spring, period, 100 * refined);
        found.iter().zip(1u32..).map(|(e, k)| (e - closed(period * f64::from(k))).abs()).fold(0.0, f64::max)
    };
    let (coarse, fine) = (apart(1), apart(2));
    assert!(coarse < 1e-3, "{coarse}");
    assert!((3.5..4.5).contains(&(coarse / fine)), "{coarse} {fine}");
}

proptest! {
    #[test]
    fn a_spring_below_the_limit_settles_and_one_above_is_refused(product in 0.02..2.0f64, share in 0.02..0.99f64) {
        let taken = 1.0 - (-product).exp();
        let limit = product * (4.0 - 2.0 * taken) / (taken * (1.0 - taken / 3.0)) * inertia() / PERIOD.powi(2);
        let found = errors(product / PERIOD, share * limit, PERIOD, 6000);
        prop_assert!(found[5900..].iter().all(|e| e.abs() < 0.05), "{:?}", &found[5990..]);
        let gains = Gains::Constant(vec![product / PERIOD]);
        let mut stiff = observer(one_joint(), gains, 1.001 * limit).unwrap();
        let refused = stiff.step(&[0.0], &[0.0]);
        let named = matches!(refused, Err(RunError::Design(DesignError::StiffSpring { .. })));
        prop_assert!(named);
    }
}

#[test]
fn a_map_shrinks_errors_at_any_rate() {
    for gain in [1.0, 100.0, 1900.0] {
        let map = GainMap { linear: vec![gain], waves: vec![], sine: vec![], cosine: vec![] };
        let mut observer = observer(one_joint(), Gains::Mapped(map), 0.0).unwrap();
        observer.step(&[0.0], &[0.0]).unwrap();
        let left = (1.0 - 0.5 * gain * PERIOD) / (1.0 + 0.5 * gain * PERIOD);
        for k in 1..50 {
            observer.step(&[0.5 * PERIOD * f64::from(k)], &[0.0]).unwrap();
            assert!((0.5 - observer.dq()[0] - 0.5 * left.powi(k)).abs() < 1e-12);
        }
    }
}

#[test]
fn refuses_a_map_that_does_not_fit() {
    let map = GainMap { linear: vec![9.0], waves: vec![1.0], sine: vec![1.0], cosine: vec![1.0] };
    let refused = |map, spring| observer(one_joint(), Gains::Mapped(map), spring).err();
    assert!(refused(map.clone(), 0.0).is_none());
    assert!(matches!(refused(map.clone(), 1.0), Some(DesignError::Range { .. })));
    let short = GainMap { cosine: vec![], ..map.clone() };
    assert!(matches!(refused(short, 0.0), Some(DesignError::Length { .. })));
    let fast = GainMap { sine: vec![3000.0], ..map.clone() };
    assert!(matches!(refused(fast, 0.0), Some(DesignError::FastGain { .. })));
    let blank = GainMap { linear: vec![f64::NAN], ..map };
    assert!(matches!(refused(blank, 0.0), Some(DesignError::Range { .. })));
}
