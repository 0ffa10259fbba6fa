//! Inverse dynamics of elastic joints: orders of derivatives, limits in closed form, refusals.

mod arm;

use arm::{arm, drive};
use linkside_core::control::feedforward::{Path, derivative_order, inverse_dynamics};
use linkside_core::dynamics::{Batch, States};
use linkside_core::error::DesignError;
use linkside_core::robot::{Drive, Friction, Robot};

const N: usize = 3;

fn robot(damping: [f64; N], coupled: &[(usize, usize)]) -> Robot {
    let frictionless = Drive { motor_friction: Friction::default(), ..drive() };
    let mut robot = arm(damping.map(|damping| Drive { damping, ..frictionless.clone() }).into(), &[]);
    for &(i, j) in coupled {
        robot.coupling[i * N + j] = 0.4;
    }
    robot
}

/// Derivatives up to `order` of sines of several frequencies, one a joint.
fn sines(t: &[f64], order: usize) -> Vec<f64> {
    let wave = |k: usize, t: f64, joint: usize| {
        let w = 2.0 + joint as f64;
        0.3 * w.powi(k as i32) * (w * t + k as f64 * core::f64::consts::FRAC_PI_2).sin()
    };
    (0..=order).flat_map(|k| t.iter().flat_map(move |&t| (0..N).map(move |j| wave(k, t, j)))).collect()
}

fn times(count: u32) -> Vec<f64> {
    (0..count).map(|i| 1e-3 * f64::from(i)).collect()
}

#[test]
fn derivatives_that_are_needed_are_those_of_the_longest_chain() {
    let (none, all) = ([0.0; N], [30.0; N]);
    let chain: &[_] = &[(0, 1), (1, 2)];
    for (damping, coupled, expected) in [
        (none, &[][..], 4),
        (all, &[], 3),
        (none, &[(1, 2)], 6),
        (all, &[(1, 2)], 4),
        (none, chain, 8),
        (all, chain, 5),
        ([0.0, 0.0, 30.0], &[(1, 2)], 5),
        ([30.0, 30.0, 0.0], &[(1, 2)], 5),
        (none, &[(0, 1), (0, 2)], 6),
    ] {
        assert_eq!(derivative_order(&robot(damping, coupled)), expected, "{damping:?} {coupled:?}");
    }
    let mut rigid = robot(none, chain);
    rigid.drives.iter_mut().for_each(|d| d.elastic = false);
    assert_eq!(derivative_order(&rigid), 2);
}

#[test]
fn the_last_derivative_matters_and_the_next_does_not() {
    let t = times(2);
    for (damping, coupled) in
        [([0.0; N], &[][..]), ([30.0; N], &[]), ([0.0; N], &[(0, 1), (1, 2)]), ([9.0; N], &[(0, 1)])]
    {
        let robot = robot(damping, coupled);
        let order = derivative_order(&robot);
        let torque = |changed: Option<usize>| {
            let mut derivatives = sines(&t, order + 1);
            if let Some(k) = changed {
                derivatives[k * t.len() * N..][..t.len() * N].iter_mut().for_each(|v| *v += 1.0);
            }
            inverse_dynamics(&robot, Path { t: &t, derivatives: &derivatives }).unwrap().tau
        };
        assert_ne!(torque(Some(order)), torque(None));
        let beyond = torque(Some(order + 1));
        let most = beyond.iter().zip(torque(None)).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(most < 2e-3, "{most}"); // of no weight but for the load between samples
    }
}

#[test]
fn stiff_springs_give_the_rigid_robot() {
    let t = times(50);
    let mut robot = robot([0.0; N], &[]);
    robot.drives.iter_mut().for_each(|d| d.stiffness = 1e14);
    let derivatives = sines(&t, 4);
    let found = inverse_dynamics(&robot, Path { t: &t, derivatives: &derivatives }).unwrap();
    let size = t.len() * N;
    let states =
        States { q: &derivatives[..size], dq: &derivatives[size..2 * size], ddq: &derivatives[2 * size..3 * size] };
    let mut links = vec![0.0; size];
    Batch::new(robot.clone().into()).inverse_dynamics(states, &mut links);
    for i in 0..size {
        let motors = robot.drives[i % N].motor_inertia * states.ddq[i];
        assert!((found.tau[i] - links[i] - motors).abs() < 1e-8);
        assert!((found.theta[i] - states.q[i]).abs() < 1e-11);
    }
}

#[test]
fn little_damping_tends_to_none() {
    let t = times(400);
    let derivatives = sines(&t, 8);
    let torque = |damping: f64| {
        let robot = robot([damping; N], &[(0, 1)]);
        inverse_dynamics(&robot, Path { t: &t, derivatives: &derivatives }).unwrap().tau
    };
    let (without, size) = (torque(0.0), 1e3);
    let distance = |damping: f64| {
        let found = torque(damping);
        let settled = 200 * N..;
        found[settled.clone()].iter().zip(&without[settled]).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
    };
    assert!(distance(10.0) < 1e-8 * size);
    assert!((distance(400.0) / distance(200.0) - 2.0).abs() < 0.05); // first order in D
}

#[test]
fn rigid_joints_and_friction_are_accounted_for() {
    let t = times(10);
    let derivatives = sines(&t, 4);
    let path = Path { t: &t, derivatives: &derivatives };
    let mut robot = robot([0.0; N], &[]);
    robot.drives[1].elastic = false;
    let plain = inverse_dynamics(&robot, path).unwrap();
    robot.drives[1].motor_friction = Friction { viscous: 3.0, coulomb: 2.0, ..Friction::default() };
    robot.drives[2].link_friction[5] = 5.0;
    let found = inverse_dynamics(&robot, path).unwrap();
    for row in 0..t.len() {
        let (i, q, dq) = (row * N + 1, derivatives[row * N + 1], derivatives[(t.len() + row) * N + 1]);
        assert_eq!(found.theta[i], q);
        assert!((found.tau[i] - plain.tau[i] - 3.0 * dq - robot.drives[1].dry_friction(dq)).abs() < 1e-9);
        let extra = 5.0 / robot.drives[2].stiffness * derivatives[(t.len() + row) * N + 2];
        assert!((found.theta[i + 1] - plain.theta[i + 1] - extra).abs() < 1e-15);
    }
}

#[test]
fn motions_that_cannot_be_followed_are_refused() {
    let robot = robot([0.0; N], &[]);
    let t = times(4);
    let refuse = |t: &[f64], derivatives: &[f64]| inverse_dynamics(&robot, Path { t, derivatives }).unwrap_err();
    assert_eq!(refuse(&t, &sines(&t, 3)), DesignError::Derivatives { found: 3, needed: 4 });
    assert!(refuse(&t, &sines(&t, 3)).to_string().contains("needs derivative 4"));
    assert!(matches!(refuse(&t, &sines(&t, 4)[1..]), DesignError::Length { what: "derivatives", .. }));
    assert!(matches!(refuse(&t, &[]), DesignError::Length { .. }));
    let mut endless = sines(&t, 4);
    endless[7] = f64::NAN;
    assert!(matches!(refuse(&t, &endless), DesignError::Range { what: "a derivative of the motion", .. }));
    let back = [0.0, 0.1, 0.1, 0.2];
    assert!(matches!(refuse(&back, &sines(&back, 4)), DesignError::Range { what: "t", .. }));
}

#[test]
fn chains_beyond_the_highest_order_are_refused() {
    let n = 8;
    let mut robot = arm(vec![Drive { damping: 0.0, ..drive() }; n], &[]);
    (1..n).for_each(|j| robot.coupling[(j - 1) * n + j] = 0.1);
    let error = inverse_dynamics(&robot, Path { t: &[0.0], derivatives: &vec![0.0; 19 * n] }).unwrap_err();
    assert!(error.to_string().contains("is 18, expected at most 17"), "{error}");
}
