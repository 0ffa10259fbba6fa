//! Elastic-joint dynamics on random robots: balance of power, derivatives, rigid joints; and a published closed form.

#[allow(dead_code, unused_imports)]
mod support;

use linkside_core::dynamics::{Batch, DrivenStates, ElasticDynamics, ElasticLayout, States, check_inertia};
use linkside_core::error::RobotError;
use linkside_core::robot::{
    Backlash, BodySpec, Drive, Friction, FrictionElement, Harmonic, Hysteresis, Interpolation, JointKind, LoadFriction,
    Ripple, Robot, Rotor, SoftWindup, SpringCurve, Tree,
};
use linkside_core::scalar::{Dual, Lanes, Scalar};
use linkside_core::spatial::{Mat3, Vec3};
use proptest::prelude::*;
use std::sync::Arc;
use support::{Case, Kernels, State, balanced_cases, cases, check_close, check_same_bits, multiply};

/// Most joints of a [`Case`].
const MOST: usize = 8;
/// q, q̇, θ, θ̇ and τ.
const DIRECTIONS: usize = 5 * MOST;

fn config() -> ProptestConfig {
    ProptestConfig { cases: 200, ..support::config() }
}

/// A robot with everything: nonlinear drives, some rigid, coupling or rotors; and signals q, q̇, θ, θ̇, τ.
#[derive(Clone, Debug)]
struct Driven {
    case: Case,
    robot: Robot,
    signals: [Vec<f64>; 5],
}

fn drives() -> impl Strategy<Value = Drive> {
    let spring = (100.0..1e3, 0.0..3.0, 0.0..1e3, -40.0..90.0_f64, 0.0..50.0);
    let friction = (0.0..0.5, 0.0..0.5, 0.0..0.5, 0.1..1.0, prop::array::uniform6(0.0..1.0));
    let loads = (0.0..0.4_f64, 0.0..0.4_f64, 0.0..0.3_f64, -1.0..1.0_f64).prop_map(Some).boxed();
    let loads = prop_oneof![Just(None), loads];
    let law = (0..3_u8, 0.0..0.1_f64, 1e-3..0.05_f64);
    let wave = || (-0.09..0.09_f64, -9.0..9.0_f64, 0.0..6.0_f64);
    let law = (law, prop::collection::vec(wave(), 0..3));
    (prop::bool::weighted(0.75), 0.5..4.0, spring, (friction, loads), law).prop_map(
        |(
            elastic,
            motor_inertia,
            (stiffness, damping, cubic, missing, shape),
            ((v, c, s, speed, link), loads),
            ((law, gap, x), waves),
        )| {
            let (driving, driven, share, skew) = loads.unwrap_or_default();
            let share_of_load = |driving, driven| {
                let share = LoadFriction { driving, driven, rounding: 0.5 };
                if elastic { share } else { LoadFriction::default() }
            };
            // Rates with hardening and wind-up, a table, or play before one rate.
            let (mut cubic_stiffness, mut curve, mut backlash) = (cubic, SpringCurve::default(), Backlash::default());
            let mut missing = missing;
            if law == 1 {
                let points = [[x, 0.6 * stiffness * x], [2.0 * x, 1.5 * stiffness * x], [5.0 * x, 9.0 * stiffness * x]];
                curve = SpringCurve::new(&points, Interpolation::Monotone).unwrap();
            } else if law == 2 {
                (cubic_stiffness, missing) = (0.0, 0.0);
                backlash = Backlash { half_gap: gap, slope: 0.1, rounding: x };
            }
            let harmonic = |(speed, frequency, phase)| Harmonic { amplitude: speed / frequency, frequency, phase };
            let ripple = Ripple::new(waves.into_iter().filter(|w| elastic && w.1.abs() > 0.1).map(harmonic).collect());
            Drive {
                elastic,
                cubic_stiffness,
                soft_windup: SoftWindup { stiffness: missing, shape },
                curve,
                backlash,
                ripple,
                motor_friction: Friction {
                    viscous: v,
                    coulomb: c,
                    stribeck: s,
                    stribeck_velocity: speed,
                    asymmetry: skew * c,
                },
                gear_loss: share_of_load(driving, driven),
                link_friction: link,
                bearing_friction: Friction { coulomb: share, asymmetry: -skew * share, ..Friction::default() },
                bearing_loss: share_of_load(share, share),
                ..Drive::spring(stiffness, damping, motor_inertia)
            }
        },
    )
}

fn driven(cases: impl Strategy<Value = Case>) -> impl Strategy<Value = Driven> {
    let vector = |most: f64| prop::collection::vec(-most..most, MOST);
    let rotors = prop::collection::vec(
        (prop::bool::ANY, any::<prop::sample::Index>(), support::vectors(1.0), 2.0..9.0_f64),
        MOST,
    );
    let drives = prop::collection::vec(drives(), MOST);
    (cases, drives, vector(0.05), rotors, vector(0.2), vector(5.0)).prop_map(
        |(case, mut drives, coupling, rotors, torsion, tau)| {
            let n = case.tree.len();
            drives.truncate(n);
            let rotors: Vec<_> = (0..n)
                .filter(|&j| rotors[j].0 && rotors[j].2.norm() > 0.1)
                .map(|j| {
                    let (_, body, axis, ratio) = &rotors[j];
                    Rotor { motor: j, body: body.index(n), axis: *axis * (1.0 / axis.norm()), ratio: *ratio }
                })
                .collect();
            let mut s = vec![0.0; n * n];
            for j in (0..n).filter(|&j| rotors.iter().all(|r| r.motor != j)) {
                for i in 0..j {
                    s[i * n + j] = coupling[i] - coupling[j];
                }
            }
            let (q, other) = (case.states[0].q.clone(), case.states[1].dq.clone());
            let theta = q.iter().zip(&torsion).map(|(q, t)| q + t).collect();
            let signals = [q, case.states[0].dq.clone(), theta, other, tau[..n].to_vec()];
            let robot = Robot::new(case.tree.clone(), drives, s, vec![], vec![], None).unwrap();
            Driven { robot: robot.with_rotors(rotors).unwrap(), case, signals }
        },
    )
}

/// q̈ and θ̈.
fn accelerations<T: Scalar>(robot: &Robot, signals: &[Vec<T>; 5]) -> [Vec<T>; 2] {
    let Accelerated { dynamics, .. } = accelerated(robot, signals);
    [dynamics.ddq, dynamics.ddtheta]
}

struct Accelerated<T> {
    layout: ElasticLayout,
    x: Vec<T>,
    dynamics: ElasticDynamics<T>,
}

fn accelerated<T: Scalar>(robot: &Robot, [q, dq, theta, dtheta, tau]: &[Vec<T>; 5]) -> Accelerated<T> {
    let layout = ElasticLayout::new(robot, false);
    let (mut x, mut dynamics) = (vec![T::default(); layout.dense], ElasticDynamics::new(robot, &layout));
    layout.gather([q, dq, theta, dtheta], &mut x);
    dynamics.accelerate(robot, &layout, &x, tau);
    Accelerated { layout, x, dynamics }
}

/// Kinetic energy and the springs'; gravity's comes from the links as specified.
fn energy<T: Scalar>(driven: &Driven, [q, dq, theta, dtheta]: [&[T]; 4]) -> T {
    let Driven { case, robot, .. } = driven;
    let n = q.len();
    let state = State { q: q.to_vec(), dq: dq.to_vec(), ddq: vec![T::default(); n] };
    let mut kernels = Kernels::new(&case.tree, &state);
    let dot = |a: &[T], b: &[T]| a.iter().zip(b).fold(T::default(), |sum, (&a, &b)| sum + a * b);
    let mut sum = dot(dq, &multiply(&kernels.mass(), dq)) * 0.5;
    for (body, spec) in case.specs.iter().enumerate() {
        let [centre, ..] = kernels.sensed(&case.frame_at(body, &Mat3::IDENTITY, &spec.com));
        sum -= centre.dot(&Vec3::constant(&(case.gravity * spec.mass)));
    }
    for (j, drive) in robot.drives.iter().enumerate() {
        let speed = if drive.elastic { dtheta[j] } else { dq[j] };
        sum += match robot.rotors.iter().find(|r| r.motor == j) {
            Some(rotor) => {
                let [.., rate] = kernels.sensed(&case.frame_at(rotor.body, &Mat3::IDENTITY, &Vec3([0.0; 3])));
                let spin = speed * rotor.ratio + rate.dot(&Vec3::constant(&rotor.axis));
                spin * spin * (0.5 * drive.motor_inertia / rotor.ratio.powi(2))
            }
            None => {
                let pull = (0..j).fold(T::default(), |sum, i| sum + dq[i] * robot.coupling[i * n + j]);
                speed * speed * (0.5 * drive.motor_inertia) + pull * speed
            }
        };
        if drive.elastic {
            sum += spring_energy(drive, drive.ripple.output(theta[j]).angle - q[j]);
        }
    }
    sum
}

fn spring_energy<T: Scalar>(drive: &Drive, torsion: T) -> T {
    let now = torsion.map(|x| x);
    let chain = |energy: T, torque: T| energy + torque * (torsion - now);
    if !drive.curve.is_none() {
        return chain(now.map(|x| drive.curve.energy(x)), drive.curve.torque(now));
    }
    if !drive.backlash.is_none() {
        return chain(now.map(|x| drive.backlash.energy(x)), drive.backlash.engaged(now)) * drive.stiffness;
    }
    let (square, SoftWindup { stiffness, shape }) = (torsion * torsion, drive.soft_windup);
    let windup = ((square * -shape).exp() + -1.0) * (0.5 * stiffness / shape);
    square * (0.5 * drive.stiffness) + square * square * (0.25 * drive.cubic_stiffness) + windup
}

/// What goes into motors, less what friction and damping take.
fn power(robot: &Robot, signals: &[Vec<f64>; 5]) -> f64 {
    let [_, dq, theta, dtheta, tau] = signals;
    let joint = |(j, drive): (usize, &Drive)| {
        let speed = if drive.elastic { dtheta[j] } else { dq[j] };
        let ratio = drive.ripple.output(theta[j]).ratio;
        let slip = if drive.elastic { ratio * dtheta[j] - dq[j] } else { 0.0 };
        let mut friction = drive.motor_friction(speed).0 * speed + drive.link_friction(dq[j]).0 * dq[j];
        if drive.elastic {
            let load = drive.spring_torque(drive.ripple.output(theta[j]).angle - signals[0][j]) + drive.damping * slip;
            friction += drive.gear_loss.loss(speed, ratio * load).torque * speed;
            friction += drive.bearing_loss.loss(dq[j], load).torque * dq[j];
        }
        tau[j] * speed - friction - drive.damping * slip * slip
    };
    robot.drives.iter().enumerate().map(joint).sum()
}

/// ∂(q̈, θ̈)/∂(q, q̇, θ, θ̇, τ) against dual numbers.
fn check_derivatives(driven: &Driven) -> Result<(), TestCaseError> {
    let n = driven.robot.len();
    let mut block = 0;
    let varied = driven.signals.clone().map(|signal| {
        block += MOST;
        signal.iter().enumerate().map(|(i, &x)| Dual::<DIRECTIONS>::variable(x, block - MOST + i)).collect()
    });
    let expected = accelerations(&driven.robot, &varied).concat();
    let Accelerated { layout, x, mut dynamics } = accelerated(&driven.robot, &driven.signals);
    dynamics.differentiate(&driven.robot, &layout, &x);
    let ElasticDynamics { ddq_by, ddtheta_by, ddq_by_tau, .. } = dynamics;
    let rows = || ddq_by.chunks_exact(layout.dense).chain(ddtheta_by.chunks_exact(layout.dense));
    let places: [Vec<usize>; 4] = [(0..n).collect(), (n..2 * n).collect(), layout.theta, layout.dtheta];
    for (block, places) in places.iter().enumerate() {
        // Of a rigid joint θ and θ̇ are q and q̇.
        let own = |j: usize| block < 2 || driven.robot.drives[j].elastic;
        let found: Vec<_> = rows().flat_map(|row| (0..n).filter(|&j| own(j)).map(|j| row[places[j]])).collect();
        let of = |a: &Dual<DIRECTIONS>| (0..n).filter(|&j| own(j)).map(|j| a.gradient[block * MOST + j]).collect();
        check_close(&found, &expected.iter().flat_map(|a| -> Vec<f64> { of(a) }).collect::<Vec<_>>())?;
    }
    let by_tau: Vec<_> = expected[..n].iter().flat_map(|a| a.gradient[4 * MOST..][..n].to_vec()).collect();
    check_close(&ddq_by_tau, &by_tau)
}

/// Accelerations and motor torques of a robot whose motors accelerate as the last signal says.
fn prescribed<T: Scalar>(robot: &Robot, [q, dq, theta, dtheta, ddtheta]: &[Vec<T>; 5]) -> Accelerated<T> {
    let layout = ElasticLayout::moved_by_jerk(robot);
    let (mut x, mut dynamics) = (vec![T::default(); layout.dense], ElasticDynamics::new(robot, &layout));
    layout.gather([q, dq, theta, dtheta], &mut x);
    x[layout.motor_acceleration.unwrap()..][..q.len()].copy_from_slice(ddtheta);
    dynamics.accelerate(robot, &layout, &x, &[]);
    Accelerated { layout, x, dynamics }
}

proptest! {
    #![proptest_config(config())]

    /// Of motors that accelerate as torques have them accelerate, links do what they do under these torques, and those are
    /// what the motors need.
    #[test]
    fn motors_of_given_acceleration_need_the_torque_that_gives_it(driven in driven(cases())) {
        let Driven { robot, signals, .. } = &driven;
        let Accelerated { dynamics: moved, .. } = accelerated(robot, signals);
        let mut given = signals.clone();
        given[4].clone_from(&moved.ddtheta);
        let Accelerated { dynamics, .. } = prescribed(robot, &given);
        check_close(&dynamics.ddq, &moved.ddq)?;
        check_close(dynamics.motor_torques(), &signals[4])?;
        let gives = |of: &ElasticDynamics| (0..robot.len()).map(|j| of.joint_torque(robot, j)).collect::<Vec<_>>();
        check_close(&gives(&dynamics), &gives(&moved))?;
    }

    #[test]
    fn motors_of_given_acceleration_have_the_derivatives_of_dual_numbers(driven in driven(cases())) {
        let Driven { robot, signals, .. } = &driven;
        let (n, mut block) = (robot.len(), 0);
        let varied = signals.clone().map(|signal| {
            block += MOST;
            signal.iter().enumerate().map(|(i, &x)| Dual::<DIRECTIONS>::variable(x, block - MOST + i)).collect()
        });
        let Accelerated { dynamics: dual, .. } = prescribed(robot, &varied);
        let Accelerated { layout, x, mut dynamics } = prescribed(robot, signals);
        dynamics.differentiate(robot, &layout, &x);
        let first = layout.motor_acceleration.unwrap();
        let places: [Vec<usize>; 5] =
            [(0..n).collect(), (n..2 * n).collect(), layout.theta, layout.dtheta, (first..first + n).collect()];
        let pairs = [
            (&dynamics.ddq_by[..], &dual.ddq[..]),
            (&dynamics.ddtheta_by, &dual.ddtheta),
            (dynamics.motor_torques_by(), dual.motor_torques()),
        ];
        for (found, expected) in pairs {
            for (row, expected) in found.chunks_exact(layout.dense).zip(expected) {
                for (block, places) in places.iter().enumerate() {
                    let own = |j: &usize| !(2..4).contains(&block) || robot.drives[*j].elastic;
                    let found: Vec<_> = (0..n).filter(own).map(|j| row[places[j]]).collect();
                    let expected: Vec<_> = (0..n).filter(own).map(|j| expected.gradient[block * MOST + j]).collect();
                    check_close(&found, &expected)?;
                }
            }
        }
    }

    /// Ė = power, for one velocity it is one equation; for a robot's every velocity it is all of them.
    #[test]
    fn energy_changes_by_the_power_of_motors_and_friction(driven in driven(cases())) {
        let [ddq, ddtheta] = accelerations(&driven.robot, &driven.signals);
        let [q, dq, theta, dtheta, _] = &driven.signals;
        let moving = |x: &[f64], rate: &[f64]| -> Vec<Dual<1>> {
            x.iter().zip(rate).map(|(&value, &rate)| Dual { value, gradient: [rate] }).collect()
        };
        let state = [moving(q, dq), moving(dq, &ddq), moving(theta, dtheta), moving(dtheta, &ddtheta)];
        let rate = energy(&driven, state.each_ref().map(|x| &x[..])).gradient[0];
        check_close(&[rate], &[power(&driven.robot, &driven.signals)])?;
    }

    #[test]
    fn derivatives_are_those_of_dual_numbers(driven in driven(cases())) {
        check_derivatives(&driven)?;
    }

    #[test]
    fn counterbalances_have_the_derivatives_of_dual_numbers(driven in driven(balanced_cases())) {
        check_derivatives(&driven)?;
    }

    #[test]
    fn lanes_hold_the_bits_of_one_number(driven in driven(cases())) {
        let lanes = driven.signals.clone().map(|signal| signal.iter().map(|&x| Lanes([x, 0.5 * x])).collect());
        let together = accelerations(&driven.robot, &lanes).concat();
        let alone = accelerations(&driven.robot, &driven.signals).concat();
        check_same_bits(&together.iter().map(|a| a.0[0]).collect::<Vec<_>>(), &alone)?;
    }

    /// More than one block of lanes, and some samples that are no block.
    #[test]
    fn arrays_hold_the_bits_of_single_samples(driven in driven(cases())) {
        let (robot, n) = (Arc::new(driven.robot.clone()), driven.robot.len());
        let rows = driven.signals.clone().map(|signal| -> Vec<f64> {
            (0..19).flat_map(|i| signal.iter().map(move |x| x * (1.0 - 0.1 * f64::from(i)))).collect()
        });
        let mut batch = Batch::new(robot);
        let [torques, slopes, inertias, accelerations] = answers(&mut batch, n, &rows);
        for i in 0..19 {
            let one = answers(&mut batch, n, &rows.each_ref().map(|signal| signal[i * n..][..n].to_vec()));
            for (all, one) in [&torques, &slopes, &inertias, &accelerations].into_iter().zip(&one) {
                check_same_bits(&all[i * one.len()..][..one.len()], one)?;
            }
        }
    }

    /// A spring under the torque that makes the motor follow its link moves both as a rigid joint would.
    #[test]
    fn springs_that_hold_still_are_rigid_joints(mut driven in driven(cases())) {
        // Nor does friction then grow with what they transmit.
        driven.robot.drives.iter_mut().for_each(|d| {
            d.ripple = Ripple::default();
            (d.gear_loss, d.bearing_loss) = (LoadFriction::default(), LoadFriction::default());
        });
        let Driven { robot, signals: [q, dq, _, _, tau], .. } = &driven;
        let mut rigid = robot.clone();
        rigid.drives.iter_mut().for_each(|d| d.elastic = false);
        let [ddq, follows] = accelerations(&rigid, &[q.clone(), dq.clone(), q.clone(), dq.clone(), tau.clone()]);
        check_same_bits(&ddq, &follows)?;
        let theta: Vec<_> = (0..q.len()).map(|j| q[j] + held_torsion(&driven, &ddq, j)).collect();
        let signals = [q.clone(), dq.clone(), theta, dq.clone(), tau.clone()];
        for found in accelerations(robot, &signals) {
            check_close(&found, &ddq)?;
        }
    }
}

/// τ, its derivatives, M and accelerations of all samples.
fn answers(batch: &mut Batch, n: usize, signals: &[Vec<f64>; 5]) -> [Vec<f64>; 4] {
    let [q, dq, theta, dtheta, tau] = signals.each_ref().map(|signal| &signal[..]);
    let states = States { q, dq, ddq: tau };
    let room = |width| vec![f64::NAN; q.len() / n * width];
    let mut out = [room(n), room(3 * n * n), room(n * n), room(2 * n)];
    let [torques, slopes, inertias, accelerations] = &mut out;
    batch.inverse_dynamics(states, torques);
    batch.inverse_dynamics_derivatives(states, slopes);
    batch.mass_matrix(q, inertias);
    batch.forward_dynamics(DrivenStates { q, dq, theta, dtheta, tau }, accelerations);
    out
}

/// The torsion of joint j at which its motor accelerates as its link does.
fn held_torsion(driven: &Driven, ddq: &[f64], j: usize) -> f64 {
    let Driven { robot, signals: [q, dq, _, _, tau], .. } = driven;
    let (n, drive) = (q.len(), &robot.drives[j]);
    if !drive.elastic {
        return 0.0;
    }
    // The motor's row, with the rotor's momentum about its axis differentiated along the motion.
    let inertial = match robot.rotors.iter().find(|r| r.motor == j) {
        Some(rotor) => {
            let state = State { q: q.clone(), dq: dq.clone(), ddq: ddq.to_vec() }.in_time();
            let body = driven.case.frame_at(rotor.body, &Mat3::IDENTITY, &Vec3([0.0; 3]));
            let [.., rate] = Kernels::new(&driven.case.tree, &state).sensed(&body);
            let turning = rate.dot(&Vec3::constant(&rotor.axis)).gradient[0];
            drive.motor_inertia * (ddq[j] + turning / rotor.ratio)
        }
        None => drive.motor_inertia * ddq[j] + (0..j).map(|i| robot.coupling[i * n + j] * ddq[i]).sum::<f64>(),
    };
    drive.torsion(tau[j] - drive.motor_friction(dq[j]).0 - inertial)
}

/// The arm of Ulrich and Sasiadek (2011): two slender rods of 4.5 m and 1.5075 kg, nonlinear joints, S₁₂ = 1 kg m².
fn space_arm() -> Robot {
    let (length, mass) = (4.5, 1.5075);
    let spin = mass * length * length / 12.0;
    let rod = |joint: usize| BodySpec {
        parent: joint.checked_sub(1),
        joint,
        kind: JointKind::Revolute,
        rotation: Mat3::IDENTITY,
        translation: Vec3([if joint == 0 { 0.0 } else { length }, 0.0, 0.0]),
        axis: Vec3([0.0, 0.0, 1.0]),
        mass,
        com: Vec3([0.5 * length, 0.0, 0.0]),
        inertia: Mat3::from_rows([[0.0; 3], [0.0, spin, 0.0], [0.0, 0.0, spin]]),
    };
    let drive = Drive {
        cubic_stiffness: 500.0,
        soft_windup: SoftWindup { stiffness: 10.0, shape: 3000.0 },
        link_friction: [0.5, 150.0, 50.0, 2.0, 100.0, 0.5],
        ..Drive::spring(500.0, 0.0, 1.0)
    };
    let tree = Tree::new(Vec3([0.0; 3]), &[rod(0), rod(1)]).unwrap();
    Robot::new(tree, vec![drive; 2], vec![0.0, 1.0, 0.0, 0.0], vec![], vec![], None).unwrap()
}

/// Links, motors and the elements beside their springs, coupled and behind gears with an error.
#[test]
fn rates_of_friction_elements_have_the_derivatives_of_dual_numbers() {
    const DENSE: usize = 11;
    let mut robot = space_arm();
    for (drive, count) in robot.drives.iter_mut().zip([2, 1]) {
        let elements = [FrictionElement::dahl(200.0, 3.0), FrictionElement::slip(90.0, 2.0, 0.3)];
        drive.hysteresis = Hysteresis { elements: elements[..count].to_vec() };
        drive.ripple = Ripple::new(vec![Harmonic { amplitude: 0.01, frequency: 7.0, phase: 0.4 }]);
        drive.gear_loss = LoadFriction { driving: 0.3, driven: 0.2, rounding: 0.1 };
        drive.bearing_loss = LoadFriction { driving: 0.1, driven: 0.1, rounding: 0.1 };
        drive.damping = 3.0;
    }
    let (layout, tau) = (ElasticLayout::new(&robot, false), [0.7, -2.0]);
    assert_eq!(layout.dense, DENSE);
    let mut x = vec![0.3, -0.8, 0.5, -1.1, 0.35, -0.9, 1.4, 0.2, 0.002, -0.021, -0.009];
    for turn in [1.0, -1.0] {
        x[2..4].iter_mut().for_each(|dq| *dq *= turn);
        let a = ElasticDynamics::<f64>::new(&robot, &layout).linearise(&robot, &layout, &x, &tau);
        let mut dual = ElasticDynamics::<Dual<DENSE>>::new(&robot, &layout);
        let varied: Vec<_> = x.iter().enumerate().map(|(i, &x)| Dual::variable(x, i)).collect();
        dual.accelerate(&robot, &layout, &varied, &tau.map(Dual::constant));
        let mut rate = vec![Dual::default(); DENSE];
        dual.rate_into(&robot, &layout, &varied, &mut rate);
        for (row, rate) in a.chunks_exact(DENSE).zip(&rate) {
            for (found, expected) in row.iter().zip(rate.gradient) {
                assert!((found - expected).abs() <= 1e-10 * (1.0 + expected.abs()), "{found} {expected}");
            }
        }
    }
}

/// A motor that is infinitely heavy stays: what is left is the link on its spring.
#[test]
fn passive_joints_keep_the_end_of_their_spring() {
    const DENSE: usize = 8;
    let mut robot = space_arm();
    robot.coupling.fill(0.0);
    robot.drives[1].motor_inertia = f64::INFINITY;
    assert!(robot.drives[1].is_passive() && !robot.drives[0].is_passive());
    let (layout, tau, x) = (ElasticLayout::new(&robot, false), [0.7, 0.0], [0.3, -0.1, 0.5, -1.1, 0.35, 0.0, 1.4, 0.0]);
    assert_eq!(layout.dense, DENSE);
    let mut dynamics = ElasticDynamics::<f64>::new(&robot, &layout);
    let a = dynamics.linearise(&robot, &layout, &x, &tau);
    assert_eq!(dynamics.ddtheta[1], 0.0);
    // As heavy as no motor is, which is all but that.
    robot.drives[1].motor_inertia = 1e12;
    let mut heavy = ElasticDynamics::<Dual<DENSE>>::new(&robot, &layout);
    let varied: Vec<_> = x.iter().enumerate().map(|(i, &x)| Dual::variable(x, i)).collect();
    heavy.accelerate(&robot, &layout, &varied, &tau.map(Dual::constant));
    for (j, ddq) in heavy.ddq.iter().enumerate() {
        assert!((dynamics.ddq[j] - ddq.value).abs() < 1e-9 * ddq.value.abs());
        for (found, expected) in a[(2 + j) * DENSE..][..DENSE].iter().zip(ddq.gradient) {
            assert!((found - expected).abs() <= 1e-9 * (1.0 + expected.abs()), "{found} {expected}");
        }
    }
    assert!(a[layout.dtheta[1] * DENSE..][..DENSE].iter().all(|&entry| entry == 0.0));
}

/// q̈ and θ̈ of [`space_arm`] by its printed matrices (Ulrich and Sasiadek 2011, eqs. (1)–(16)).
fn closed_form([q, dq, qm, _, tau]: &[Vec<f64>; 5]) -> Vec<f64> {
    let (a, b, c) = (50.878125, 15.2634375, 10.175625);
    let (sin, cos) = q[1].sin_cos();
    let (m11, m12, m22) = (a + 2.0 * b * cos, c + b * cos, c);
    let coriolis = [-b * sin * (2.0 * dq[0] * dq[1] + dq[1] * dq[1]), b * sin * dq[0] * dq[0]];
    let spring = |i: usize| {
        let d = qm[i] - q[i];
        (500.0 * d * d + 500.0 - 10.0 * (-3000.0 * d * d).exp()) * d
    };
    let friction = |v: f64| 0.5 * ((150.0 * v).tanh() - (50.0 * v).tanh()) + 2.0 * (100.0 * v).tanh() + 0.5 * v;
    let link = |i: usize| spring(i) - coriolis[i] - friction(dq[i]);
    let (r1, r2, s) = (link(0) - (tau[1] - spring(1)), link(1), m11 - 1.0);
    let determinant = s * m22 - m12 * m12;
    let ddq = [(m22 * r1 - m12 * r2) / determinant, (s * r2 - m12 * r1) / determinant];
    vec![ddq[0], ddq[1], tau[0] - spring(0), tau[1] - spring(1) - ddq[0]]
}

proptest! {
    #![proptest_config(config())]

    #[test]
    fn the_space_arm_moves_by_its_printed_matrices(
        q in prop::collection::vec(-3.0..3.0, 2), dq in prop::collection::vec(-1.0..1.0, 2),
        torsion in prop::collection::vec(-0.1..0.1, 2), tau in prop::collection::vec(-30.0..30.0, 2),
    ) {
        let qm = q.iter().zip(&torsion).map(|(q, t): (&f64, &f64)| q + t).collect();
        let signals = [q, dq.clone(), qm, dq, tau];
        let (found, expected) = (accelerations(&space_arm(), &signals).concat(), closed_form(&signals));
        let scale = expected.iter().fold(1.0_f64, |scale, e| scale.max(e.abs()));
        for (f, e) in found.iter().zip(&expected) {
            prop_assert!((f - e).abs() <= 1e-12 * scale, "{found:?} {expected:?}");
        }
    }
}

#[test]
fn a_coupling_beyond_the_inertia_shows_in_the_least_pivot() {
    let at = |coupling: f64| {
        let mut robot = space_arm();
        robot.coupling[1] = coupling;
        let x = vec![0.3, 1.0];
        let dynamics = accelerated(&robot, &[(); 5].map(|()| x.clone())).dynamics;
        dynamics.least_pivot()
    };
    assert!(at(1.0) > 0.0 && at(40.0) < 0.0);
}

/// With its elbow at a right angle the arm would bear this coupling, stretched it does not.
#[test]
fn inertia_that_no_masses_have_is_refused() {
    let check = |coupling: f64| {
        let mut robot = space_arm();
        robot.coupling[1] = coupling;
        check_inertia(&robot)
    };
    assert_eq!(check(1.0), Ok(()));
    let RobotError::Indefinite { posture } = check(5.0).unwrap_err() else { panic!() };
    assert_eq!(posture.len(), 2);
    assert!(check(40.0).unwrap_err().to_string().contains("not positive definite at q = ["));
}

#[test]
fn rotors_are_refused_where_they_cannot_be() {
    let rotor = Rotor { motor: 0, body: 1, axis: Vec3([0.0, 0.0, 1.0]), ratio: 9.0 };
    let error = |rotors: Vec<Rotor>| match space_arm().with_rotors(rotors).unwrap_err() {
        RobotError::Range { what, owner, .. } => (what, owner),
        other => panic!("{other}"),
    };
    assert!(space_arm().with_rotors(vec![rotor.clone()]).is_ok());
    let (first, second) = ("rotor 0".to_string(), "rotor 1".to_string());
    assert_eq!(error(vec![Rotor { motor: 2, ..rotor.clone() }]), ("motor", first.clone()));
    assert_eq!(error(vec![Rotor { body: 2, ..rotor.clone() }]), ("body", first.clone()));
    assert_eq!(error(vec![Rotor { axis: Vec3([0.0; 3]), ..rotor.clone() }]), ("length of the axis", first.clone()));
    assert_eq!(error(vec![Rotor { ratio: 0.0, ..rotor.clone() }]), ("ratio", first.clone()));
    assert_eq!(error(vec![rotor.clone(), rotor.clone()]), ("motor", second));
    assert_eq!(error(vec![Rotor { motor: 1, ..rotor }]), ("constant coupling of the motor", first));
}
