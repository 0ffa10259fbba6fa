//! The adaptive integrator against matrix exponentials, short steps of Runge and Kutta, and the rigid limit.

mod arm;

use arm::{arm, drive};
use linkside_core::error::SimulationError;
use linkside_core::robot::{Drive, Friction, Robot, SoftWindup};
use linkside_core::simulate::{Adaptive, Plant, RungeKutta, StepTolerance};
use nalgebra::{DMatrix, DVector};
use proptest::prelude::*;

/// Accepts every step.
const LOOSE: StepTolerance = StepTolerance { rtol: 0.99, atol: 1e12 };

/// One joint about the vertical: gravity does nothing, everything is linear but for the friction that is asked for.
fn spinner(stiffness: f64, damping: f64) -> Robot {
    let motor_friction = Friction { viscous: 10.0, ..Friction::default() };
    arm(vec![Drive { stiffness, damping, motor_friction, ..drive() }], &[])
}

/// Three joints, the second one rigid, with nonlinear springs and every friction.
fn crane() -> Robot {
    let own = Drive {
        stiffness: 5e3,
        cubic_stiffness: 1e6,
        soft_windup: SoftWindup { stiffness: 1e3, shape: 300.0 },
        motor_friction: Friction { viscous: 10.0, coulomb: 0.5, stribeck: 0.3, stribeck_velocity: 0.5, asymmetry: 0.1 },
        link_friction: [0.5, 1.5, 0.5, 2.0, 1.0, 0.5],
        ..drive()
    };
    arm(vec![own.clone(), Drive { elastic: false, ..own.clone() }, own], &[])
}

/// A state in motion (q, q̇, θ, θ̇).
fn moving(plant: &Plant) -> Vec<f64> {
    let (n, mut x) = (plant.layout.joints, vec![0.0; plant.layout.dense]);
    for j in 0..n {
        let q = 0.3 + 0.2 * j as f64;
        (x[plant.layout.theta[j]], x[plant.layout.dtheta[j]]) = (q + 0.01, 0.7);
        (x[j], x[n + j]) = (q, 0.6 - 0.2 * j as f64);
    }
    x
}

/// Where `spans` of `h` lead from a state in motion.
fn integrate(
    robot: &Robot,
    tau: &[f64],
    tolerance: StepTolerance,
    h: f64,
    spans: usize,
) -> Result<Vec<f64>, SimulationError> {
    let mut plant = Plant::new(robot);
    let (mut x, mut adaptive) = (moving(&plant), Adaptive::new(&plant, tolerance)?);
    for i in 0..spans {
        adaptive.advance(robot, &mut plant, &mut x, tau, (i as f64 * h, h))?;
    }
    Ok(x)
}

fn distance(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

/// e^(A t) by squaring, of a robot that is linear, from a state in motion without torque.
fn exponential(robot: &Robot, t: f64) -> Vec<f64> {
    let Plant { layout, mut dynamics } = Plant::new(robot);
    let x = moving(&Plant::new(robot));
    let a = dynamics.linearise(robot, &layout, &x, &[0.0]);
    ((DMatrix::from_row_slice(4, 4, &a) * t).exp() * DVector::from_vec(x)).as_slice().to_vec()
}

#[test]
fn halving_the_step_shows_fourth_order() {
    let (robot, tau, t) = (crane(), [20.0, -30.0, 5.0], 0.02);
    let mut plant = Plant::new(&robot);
    let (mut exact, mut fixed) = (moving(&plant), RungeKutta::new(&plant));
    for _ in 0..8000 {
        fixed.step(&robot, &mut plant, &mut exact, &tau, t / 8000.0);
    }
    let error = |spans: usize| distance(&integrate(&robot, &tau, LOOSE, t / spans as f64, spans).unwrap(), &exact);
    for ratio in [error(20) / error(40), error(40) / error(80)] {
        assert!((14.0..18.0).contains(&ratio), "{ratio}");
    }
}

#[test]
fn a_vibration_below_the_tolerance_is_damped_at_once() {
    let robot = spinner(1e14, 0.0);
    let x = integrate(&robot, &[0.0], LOOSE, 0.01, 4).unwrap();
    assert!((x[0] - x[2]).abs() < 1e-9 && (x[1] - x[3]).abs() < 1e-6, "{x:?}");
    // What is left turns as one body does, but for what the first step made of the start.
    assert!((0.4..0.8).contains(&x[1]), "{x:?}");
}

#[test]
fn what_is_too_abrupt_names_time_and_joint() {
    let rough = Drive { link_friction: [0.0, 0.0, 0.0, 500.0, 1e300, 0.0], ..drive() };
    let robot = arm(vec![drive(), drive(), rough], &[]);
    let tolerance = StepTolerance { rtol: 1e-13, atol: 1e-15 };
    let error = integrate(&robot, &[0.0; 3], tolerance, 0.05, 20).unwrap_err();
    let SimulationError::Abrupt { joint: 2, time, step } = error else { panic!("{error}") };
    assert!(time > 0.0 && time < 1.0 && step < 0.05);
    assert!(error.to_string().contains("of joint 2 is too abrupt"));
}

#[test]
fn a_torque_beyond_all_numbers_is_not_finite() {
    let error = integrate(&crane(), &[1e308, 0.0, 0.0], StepTolerance { rtol: 1e-6, atol: 1e-9 }, 0.01, 5).unwrap_err();
    assert!(matches!(error, SimulationError::NotFinite { .. }), "{error}");
}

#[test]
fn tolerances_out_of_range_are_refused() {
    let plant = Plant::new(&crane());
    let refused = Adaptive::new(&plant, StepTolerance { rtol: 2.0, atol: 1e-9 }).unwrap_err();
    assert_eq!(refused.to_string(), "rtol is 2, expected at least 1e-13 and less than 1");
    assert!(Adaptive::new(&plant, StepTolerance { rtol: 1e-6, atol: 0.0 }).is_err());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// From soft to stiff, damped to overdamped, tight to loose. A vibration without damping carries hundreds of steps' errors
    /// to the end.
    #[test]
    fn errors_follow_the_tolerance(
        stiffness in 2.0..6.5_f64, damping in 0.0..4.0_f64, tolerance in -10.0..-4.0_f64, spans in 1_usize..8,
    ) {
        let (robot, tolerance) = (spinner(10_f64.powf(stiffness), 10_f64.powf(damping)), 10_f64.powf(tolerance));
        let settings = StepTolerance { rtol: tolerance, atol: tolerance };
        let x = integrate(&robot, &[0.0], settings, 0.05 / spans as f64, spans).unwrap();
        let error = distance(&x, &exponential(&robot, 0.05));
        prop_assert!(error < 1000.0 * tolerance, "{}", error / tolerance);
    }
}
