//! Both rows of the model, and derivatives against differences.

use super::*;
use crate::robot::{Acting, BodySpec, Drive, Friction, JointKind, Rotor, SoftWindup, Tree, Wrench};
use crate::scalar::Lanes;
use crate::spatial::{Mat3, Vec3};

/// Four joints, one of them sliding, one rigid, coupled, with everything nonlinear.
fn robot() -> Robot {
    let drive = |elastic| Drive {
        elastic,
        cubic_stiffness: 3e3,
        soft_windup: SoftWindup { stiffness: 120.0, shape: 80.0 },
        motor_friction: Friction { viscous: 0.4, coulomb: 1e-3, ..Friction::default() },
        link_friction: [0.5, 1.5, 0.5, 0.2, 1.0, 0.5],
        ..Drive::spring(500.0, 2.0, 3.0)
    };
    let body = |index: usize| BodySpec {
        parent: index.checked_sub(1),
        joint: index,
        kind: if index == 2 { JointKind::Prismatic } else { JointKind::Revolute },
        rotation: Mat3::IDENTITY,
        translation: Vec3([0.4, 0.1, 0.0]),
        axis: Vec3(if index.is_multiple_of(2) { [0.0, 0.0, 1.0] } else { [0.0, 1.0, 0.0] }),
        mass: 2.0,
        com: Vec3([0.2, 0.1, 0.0]),
        inertia: Mat3::from_rows([[0.1, 0.0, 0.0], [0.0, 0.2, 0.0], [0.0, 0.0, 0.15]]),
    };
    let tree = Tree::new(Vec3([1.0, 0.0, -9.0]), &[0, 1, 2, 3].map(body)).unwrap();
    let mut coupling = vec![0.0; 16];
    (coupling[1], coupling[3], coupling[7], coupling[2], coupling[6]) = (0.2, 0.1, -0.1, 0.05, 0.3);
    let drives = [true, true, false, true].map(drive).to_vec();
    Robot::new(tree, drives, coupling, vec![], vec![], None).unwrap()
}

/// The same with three motors that turn all elastic joints, and so are coupled to no link.
fn geared() -> Robot {
    let mut robot = robot();
    (robot.coupling[1], robot.coupling[3], robot.coupling[7]) = (0.0, 0.0, 0.0);
    robot.with_gearing(vec![0, 1, 3], &[1.0, 0.2, 0.0, -0.3, 0.8, 0.1, 0.5, -0.4, 1.1]).unwrap()
}

/// The same with a wrench on its third link, and a constant one on its last.
fn pressed() -> Robot {
    let robot = robot();
    let turned = Mat3::from_rows([[0.6, 0.0, 0.8], [0.0, 1.0, 0.0], [-0.8, 0.0, 0.6]]);
    let wrench = |body, acting| {
        let frame = robot.tree.frame("wrench", body, &turned, &Vec3([0.3, -0.1, 0.2])).unwrap();
        Wrench { frame, acting }
    };
    let held = Acting::Constant([30.0, -20.0, 10.0, 3.0, 1.0, -2.0]);
    let wrenches = vec![wrench(3, held), wrench(2, Acting::Varying { measured: false })];
    robot.with_wrenches(wrenches).unwrap()
}

#[test]
fn derivatives_are_those_of_differences() {
    for robot in [robot(), geared(), pressed()] {
        compare_with_differences(&robot);
    }
}

fn compare_with_differences(robot: &Robot) {
    let layout = ElasticLayout::new(robot, true).with_link_disturbances(0.7);
    let d = layout.dense;
    assert_eq!(layout.link_disturbance, Some(18));
    assert_eq!(
        (d, &layout.theta[..], &layout.dtheta[..]),
        (22 + robot.wrench_states(), &[8, 9, 2, 10][..], &[11, 12, 6, 13][..])
    );
    let x: Vec<f64> = (0..d).map(|i| 0.3 * (1.7 * i as f64).sin()).collect();
    let tau = [5.0, -3.0, 2.0, 1.0];
    let mut dynamics = ElasticDynamics::new(robot, &layout);
    dynamics.accelerate(robot, &layout, &x, &tau);
    dynamics.differentiate(robot, &layout, &x);
    let mut probe = ElasticDynamics::new(robot, &layout);
    let mut at = |x: &[f64], tau: &[f64]| {
        probe.accelerate(robot, &layout, x, tau);
        [probe.ddq.clone(), probe.ddtheta.clone()].concat()
    };
    let (h, n) = (1e-6, 4);
    let check = |above: Vec<f64>, below: Vec<f64>, ours: &dyn Fn(usize) -> f64| {
        for i in 0..2 * n {
            let slope = (above[i] - below[i]) / (2.0 * h);
            assert!((ours(i) - slope).abs() < 1e-6 * (1.0 + slope.abs()), "{i}: {} {slope}", ours(i));
        }
    };
    for k in 0..d {
        let (mut above, mut below) = (x.clone(), x.clone());
        (above[k], below[k]) = (above[k] + h, below[k] - h);
        let ours = |i: usize| if i < n { dynamics.ddq_by[i * d + k] } else { dynamics.ddtheta_by[(i - n) * d + k] };
        check(at(&above, &tau), at(&below, &tau), &ours);
    }
    for k in 0..n {
        let (mut above, mut below) = (tau, tau);
        (above[k], below[k]) = (above[k] + h, below[k] - h);
        let [above, below] = [above, below].map(|tau| at(&x, &tau)[..n].to_vec());
        for i in 0..n {
            let slope = (above[i] - below[i]) / (2.0 * h);
            assert!((dynamics.ddq_by_tau[i * n + k] - slope).abs() < 1e-6 * (1.0 + slope.abs()));
        }
    }
}

#[test]
fn both_rows_of_the_model_balance() {
    let robot = robot();
    let layout = ElasticLayout::new(&robot, false);
    let x: Vec<f64> = (0..layout.dense).map(|i| 0.3 * (1.7 * i as f64).sin()).collect();
    let (n, tau) = (4, [5.0, -3.0, 2.0, 1.0]);
    let mut dynamics = ElasticDynamics::new(&robot, &layout);
    dynamics.accelerate(&robot, &layout, &x, &tau);
    let (mut kinematics, mut loads) = (Kinematics::new(&robot.tree), Loads::new(&robot.tree));
    kinematics.set(&robot.tree, &x[..n], &x[n..2 * n], &dynamics.ddq);
    let mut load = vec![0.0; n];
    loads.inverse_dynamics_into(&robot.tree, &kinematics, &mut load);
    for (j, drive) in robot.drives.iter().enumerate() {
        let (theta, dtheta) = (x[layout.theta[j]], x[layout.dtheta[j]]);
        let spring = drive.spring_torque(theta - x[j]) + drive.damping * (dtheta - x[n + j]);
        let pull: f64 = (0..n).map(|i| robot.coupling[i * n + j] * dynamics.ddq[i]).sum();
        let push: f64 = (0..n).map(|i| robot.coupling[j * n + i] * dynamics.ddtheta[i]).sum();
        let motor = tau[j] - drive.motor_friction.viscous * dtheta - drive.dry_friction(dtheta);
        let torque = if drive.elastic { spring } else { motor - drive.motor_inertia * dynamics.ddq[j] - pull };
        let link = load[j] + drive.link_friction(x[n + j]).0 + push - torque;
        assert!(link.abs() < 1e-12, "{j}: {link}");
        let sensor = dynamics.joint_torque(&robot, j);
        assert!((sensor - torque).abs() < 1e-12, "{j}: {sensor} {torque}");
        if drive.elastic {
            let row = drive.motor_inertia * dynamics.ddtheta[j] + pull + spring - motor;
            assert!(row.abs() < 1e-12, "{j}: {row}");
        }
    }
}

/// Loads and inertia of a state are kept: whatever of it changes, or only the torque, or with derivatives in between, the
/// answer is that of fresh scratch.
#[test]
fn what_is_kept_of_a_state_is_never_that_of_another() {
    let carried = Rotor { motor: 3, body: 1, axis: Vec3([0.6, 0.0, 0.8]), ratio: 80.0 };
    let mut spinning = robot();
    spinning.coupling = vec![0.0; 16];
    for robot in [robot(), geared(), pressed(), spinning.with_rotors(vec![carried]).unwrap()] {
        let layout = ElasticLayout::new(&robot, true).with_link_disturbances(0.7);
        let mut x: Vec<f64> = (0..layout.dense).map(|i| 0.3 * (1.7 * i as f64).sin()).collect();
        let mut dynamics = ElasticDynamics::new(&robot, &layout);
        for k in 0..2 * layout.dense {
            let tau = [5.0, -3.0, 2.0, k as f64];
            x[k / 2] += if k % 2 == 0 { 0.1 } else { 0.0 };
            dynamics.accelerate(&robot, &layout, &x, &tau);
            let mut fresh = ElasticDynamics::new(&robot, &layout);
            fresh.accelerate(&robot, &layout, &x, &tau);
            assert_eq!((&dynamics.ddq, &dynamics.ddtheta), (&fresh.ddq, &fresh.ddtheta), "{k}");
            if k % 3 == 0 {
                dynamics.differentiate(&robot, &layout, &x);
            }
        }
    }
}

/// A coupling that masses can have with the arm stretched out, and not with it folded back.
#[test]
fn an_impossible_inertia_is_lost_in_its_lane_alone() {
    let accelerated = |coupling: f64| {
        let mut robot = robot();
        robot.coupling[1] = coupling;
        let layout = ElasticLayout::new(&robot, false);
        let mut dynamics = ElasticDynamics::new(&robot, &layout);
        let mut x = vec![Lanes([0.0; 2]); layout.dense];
        x[1] = Lanes([0.0, core::f64::consts::PI]);
        dynamics.accelerate(&robot, &layout, &x, &[Lanes([1.0; 2]); 4]);
        let pivots = dynamics.mass.iter().step_by(5).take(4);
        (pivots.fold([false; 2], |lost, pivot| [0, 1].map(|lane| lost[lane] || pivot.0[lane] <= 0.0)), dynamics)
    };
    let couplings = (1..1000).map(|i| 0.01 * f64::from(i));
    let (lost, dynamics) = couplings.map(accelerated).find(|(lost, _)| lost[0] != lost[1]).unwrap();
    for acceleration in dynamics.ddq.iter().chain(&dynamics.ddtheta) {
        assert_eq!(acceleration.0.map(f64::is_nan), lost);
    }
}

#[test]
fn motors_that_share_joints_turn_by_their_own_inertia() {
    let robot = geared();
    let layout = ElasticLayout::new(&robot, false);
    let x: Vec<f64> = (0..layout.dense).map(|i| 0.3 * (1.7 * i as f64).sin()).collect();
    let tau = [5.0, -3.0, 2.0, 1.0];
    let mut dynamics = ElasticDynamics::new(&robot, &layout);
    dynamics.accelerate(&robot, &layout, &x, &tau);
    let gearing = robot.gearing.as_ref().unwrap();
    for motor in gearing.motors() {
        let drive = &robot.drives[motor.drive];
        let friction = drive.motor_friction(motor.speed(|j| x[layout.dtheta[j]])).0;
        let own = drive.motor_inertia * motor.speed(|j| dynamics.ddtheta[j]) + friction;
        let given = motor.torque(|j| tau[j] - dynamics.spring[j]);
        assert!((own - given).abs() < 1e-12 * (1.0 + own.abs()), "{own} {given}");
    }
}

/// Motors that several joints share, and torques and wrenches from outside: what accelerations by jerk need is the torque that
/// gives them, and its derivatives are those of differences.
#[test]
fn motors_of_given_acceleration_need_the_torque_that_gives_it() {
    for robot in [geared(), pressed()] {
        let (layout, tau) = (ElasticLayout::new(&robot, false).with_link_disturbances(0.7), [5.0, -3.0, 2.0, 1.0]);
        let given = ElasticLayout::moved_by_jerk(&robot).with_link_disturbances(0.7);
        let x: Vec<f64> = (0..layout.dense).map(|i| 0.3 * (1.7 * i as f64).sin()).collect();
        let mut moved = ElasticDynamics::new(&robot, &layout);
        moved.accelerate(&robot, &layout, &x, &tau);
        let first = given.motor_acceleration.unwrap();
        assert_eq!((given.dense, given.link_disturbance), (layout.dense + 4, layout.link_disturbance.map(|k| k + 4)));
        let y = [&x[..first], &moved.ddtheta, &x[first..]].concat();
        let mut dynamics = ElasticDynamics::new(&robot, &given);
        dynamics.accelerate(&robot, &given, &y, &[]);
        dynamics.differentiate(&robot, &given, &y);
        let close = |a: &[f64], b: &[f64]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-11 * (1.0 + b.abs()));
        assert!(close(&dynamics.ddq, &moved.ddq) && close(dynamics.motor_torques(), &tau));
        let mut probe = dynamics.clone();
        for k in 0..given.dense {
            let [below, above] = [-1e-6, 1e-6].map(|h| {
                let mut at = y.clone();
                at[k] += h;
                probe.accelerate(&robot, &given, &at, &[]);
                [probe.ddq.clone(), probe.motor_torques().to_vec()].concat()
            });
            for i in 0..4 {
                let slope = |i: usize| (above[i] - below[i]) / 2e-6;
                let ours = [dynamics.ddq_by[i * given.dense + k], dynamics.motor_torques_by()[i * given.dense + k]];
                let theirs = [slope(i), slope(4 + i)];
                let near = ours.iter().zip(theirs).all(|(a, b)| (a - b).abs() < 1e-6 * (1.0 + b.abs()));
                assert!(near, "{i} {k}: {ours:?} {theirs:?}");
            }
        }
    }
}

#[test]
fn gearings_that_cannot_be_are_refused() {
    let refused = |joints: &[usize], matrix: &[f64]| {
        let mut robot = robot();
        (robot.coupling[1], robot.coupling[3], robot.coupling[7]) = (0.0, 0.0, 0.0);
        robot.with_gearing(joints.to_vec(), matrix).unwrap_err().to_string()
    };
    assert!(refused(&[0, 1], &[1.0, 1.0, 1.0, 1.0]).starts_with("determinant of the gearing is 0"));
    assert!(
        refused(&[0, 2], &[1.0, 0.0, 0.0, 1.0]).starts_with("gearing of joint 2 is 1, expected none, as the joint")
    );
    assert!(refused(&[0, 9], &[1.0, 0.0, 0.0, 1.0]).contains("expected a joint that there is"));
    assert!(robot().with_gearing(vec![0, 1], &[1.0, 0.0, 0.0, 1.0]).unwrap_err().to_string().contains("is coupled"));
}
