//! The acceleration-driven observer: poles, gains, the accelerometers' inverse, starts at rest, runs; and what is refused.

mod arm;

use arm::{Mounting, arm, drive};
use core::f64::consts::PI;
use linkside_core::dynamics::{Kinematics, Loads};
use linkside_core::error::{DesignError, RunError};
use linkside_core::estimate::Status;
use linkside_core::estimate::observer::{
    AccelerationMap, AccelerationObserver, AccelerationSource, Complex, Form, JointModel, ObserverOutput,
    ObserverRecording, ObserverSample, ObserverSettings, Poles, Sampled, Start, closed_form_gains,
    link_position_at_rest,
};
use linkside_core::robot::{Drive, Friction, Robot, SoftWindup};
use nalgebra::{DMatrix, DVector};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use std::sync::Arc;

/// The same cases in every run.
fn config(cases: u32) -> ProptestConfig {
    ProptestConfig { rng_seed: RngSeed::Fixed(0), cases, failure_persistence: None, ..ProptestConfig::default() }
}

// Poles and gains

fn models() -> impl Strategy<Value = JointModel> {
    prop_oneof![Just(JointModel::Elastic), Just(JointModel::ElasticWithBias), Just(JointModel::Rigid)]
}

fn drives() -> impl Strategy<Value = Drive> {
    (2.0..6.0_f64, 0.0..500.0_f64, -1.0..2.0_f64, 0.0..200.0_f64).prop_map(|(stiffness, damping, inertia, viscous)| {
        Drive {
            stiffness: 10_f64.powf(stiffness),
            damping,
            motor_inertia: 10_f64.powf(inertia),
            motor_friction: Friction { viscous, ..Friction::default() },
            ..drive()
        }
    })
}

/// A conjugate pair, or two real poles.
fn two_poles() -> impl Strategy<Value = [Complex; 2]> {
    let speed = || 30.0..1000.0_f64;
    let pair = (speed(), 0.5 * PI + 0.1..PI)
        .prop_map(|(speed, angle)| [angle, -angle].map(|angle| Complex::from_polar(speed, angle)));
    prop_oneof![3 => pair, 1 => [speed(), speed()].prop_map(|speeds| speeds.map(|s| Complex::new(-s, 0.0)))]
}

/// A model with a drive and as many stable poles as it needs.
fn designs() -> impl Strategy<Value = (JointModel, Drive, Vec<Complex>)> {
    let poles = (two_poles(), two_poles(), 30.0..1000.0_f64);
    (models(), drives(), poles).prop_map(|(model, drive, (a, b, last))| {
        let real = Complex::new(-last, 0.0);
        let poles = match model {
            JointModel::Elastic => [a, b].concat(),
            JointModel::ElasticWithBias => [a.as_slice(), &b, &[real]].concat(),
            JointModel::Rigid => [a.as_slice(), &[real]].concat(),
        };
        (model, drive, poles)
    })
}

/// Coefficients of the monic polynomial with these roots, the constant one first.
fn polynomial(roots: &[Complex]) -> Vec<f64> {
    let mut product = vec![Complex::new(1.0, 0.0)];
    for root in roots {
        product.insert(0, Complex::new(0.0, 0.0));
        for i in 1..product.len() {
            let above = product[i];
            product[i - 1] -= root * above;
        }
    }
    product.iter().map(|c| c.re).collect()
}

/// Coefficients of det(s·1 − A), the constant one first, by the recursion of Faddeev and LeVerrier.
fn characteristic(a: &DMatrix<f64>) -> Vec<f64> {
    let n = a.nrows();
    let mut coefficients = vec![1.0; n + 1];
    let mut m = DMatrix::identity(n, n);
    for k in 1..=n {
        let product = a * &m;
        coefficients[n - k] = -product.trace() / k as f64;
        m = product + DMatrix::identity(n, n) * coefficients[n - k];
    }
    coefficients
}

fn fastest(poles: &[Complex]) -> f64 {
    poles.iter().map(|p| p.norm()).fold(0.0, f64::max)
}

/// Units in which the states of an error at `omega` are of one size.
fn units(model: JointModel, drive: &Drive, omega: f64) -> DVector<f64> {
    let reach = drive.stiffness.hypot(drive.damping * omega) / drive.motor_inertia / omega.powi(2);
    let units = match model {
        JointModel::Rigid => [1.0, 1.0 / omega, omega.powi(-2), 0.0, 0.0],
        _ => [1.0, reach, 1.0 / omega, reach / omega, reach / omega.powi(2)],
    };
    DVector::from_row_slice(&units[..model.order()])
}

/// A in those units, with time in 1/ω: the joint's equations written down once more.
fn dynamics_in_units(model: JointModel, drive: &Drive, omega: f64) -> DMatrix<f64> {
    let mut a = DMatrix::zeros(model.order(), model.order());
    if model == JointModel::Rigid {
        (a[(0, 1)], a[(1, 2)]) = (1.0, 1.0);
    } else {
        let (k, d, b) = (drive.stiffness, drive.damping, drive.motor_inertia);
        (a[(0, 2)], a[(1, 3)]) = (1.0, 1.0);
        (a[(2, 0)], a[(2, 1)]) = (-k / b, k / b);
        (a[(2, 2)], a[(2, 3)]) = (-(d + drive.motor_friction.viscous) / b, d / b);
    }
    if model == JointModel::ElasticWithBias {
        a[(3, 4)] = -1.0;
    }
    let units = units(model, drive, omega);
    DMatrix::from_fn(a.nrows(), a.ncols(), |i, j| a[(i, j)] * units[i] / units[j] / omega)
}

/// Ackermann's formula, φ(A) O⁻¹ e, and by how much it enlarges rounding.
fn ackermann(a: &DMatrix<f64>, poles: &[Complex]) -> (DVector<f64>, f64) {
    let n = a.nrows();
    let mut observability = DMatrix::zeros(n, n);
    let mut power = DMatrix::identity(n, n);
    let mut at_poles = DMatrix::zeros(n, n);
    for (k, c) in polynomial(poles).into_iter().enumerate() {
        at_poles += &power * c;
        if k < n {
            observability.set_row(k, &power.row(0));
        }
        power = a * power;
    }
    let inverse = observability.try_inverse().unwrap();
    let rounding = f64::EPSILON * a.amax().max(1.0).powi(n as i32) * inverse.amax();
    (at_poles * inverse.column(n - 1), rounding)
}

proptest! {
    #![proptest_config(config(1000))]

    /// In units of the error's own size, and for its difference quotient: e^{λh} themselves all lie close to one.
    #[test]
    fn sampled_error_has_the_poles_mapped_exactly((model, drive, poles) in designs(), period in 2.5e-4..1e-3_f64) {
        let omega = fastest(&poles);
        let sampled = Sampled::new(model, &drive, &Poles::new(0, &poles, model.order()).unwrap(), period);
        let (error, units) = (sampled.error_matrix(model.order()), units(model, &drive, omega));
        let quotient = DMatrix::from_fn(units.len(), units.len(), |i, j| {
            (error[(i, j)] - if i == j { 1.0 } else { 0.0 }) * units[i] / units[j] / (period * omega)
        });
        let mapped: Vec<_> = poles.iter().map(|p| ((p * period).exp() - 1.0) / (period * omega)).collect();
        // Coefficients are sums of products of `order` entries: what rounding leaves of them must show the poles.
        let rounding = f64::EPSILON * quotient.amax().powi(model.order() as i32) / (period * omega);
        prop_assume!(rounding < 1e-6);
        for (found, expected) in characteristic(&quotient).iter().zip(polynomial(&mapped)) {
            prop_assert!((found - expected).abs() <= 1e-6 * expected + rounding, "{found} {expected}");
        }
    }

    #[test]
    fn closed_form_gains_are_ackermanns((model, drive, poles) in designs()) {
        let omega = fastest(&poles);
        let gains = closed_form_gains(model, &drive, &Poles::new(0, &poles, model.order()).unwrap());
        let scaled: Vec<_> = poles.iter().map(|p| p / omega).collect();
        let a = dynamics_in_units(model, &drive, omega);
        let (expected, rounding) = ackermann(&a, &scaled);
        prop_assume!(rounding < 1e-6);
        let found = gains.component_mul(&units(model, &drive, omega)) / omega;
        prop_assert!((&found - &expected).amax() <= (1e-9 + rounding) * expected.amax(), "{found} {expected}");
    }

    #[test]
    fn polynomial_of_poles_is_the_product_of_its_roots((model, _, poles) in designs()) {
        let found = Poles::new(0, &poles, model.order()).unwrap().polynomial();
        for (found, expected) in found.iter().zip(polynomial(&poles)) {
            prop_assert!((found - expected).abs() <= 1e-12 * expected.abs());
        }
    }
}

// Accelerometers

/// One three-axis sensor on each of the last bodies, so many that they outnumber the joints.
fn mountings(n: usize) -> impl Strategy<Value = Vec<Mounting>> {
    let one = |body| {
        (prop::array::uniform3(-0.3..0.3_f64), 0.02..0.2_f64).prop_map(move |(at, noise_std)| Mounting {
            body,
            at: [0.4 + at[0], at[1], at[2]],
            axes: vec![0, 1, 2],
            noise_std,
        })
    };
    (n - n.div_ceil(2)..n).map(one).collect::<Vec<_>>()
}

/// A posture of an arm with its sensors, velocities, a reading, and which of its channels are missing.
#[derive(Clone, Debug)]
struct Scene {
    mountings: Vec<Mounting>,
    rigid: usize,
    q: Vec<f64>,
    dq: Vec<f64>,
    ddq: Vec<f64>,
    reading: Vec<f64>,
    missing: Vec<bool>,
}

fn scenes() -> impl Strategy<Value = Scene> {
    (1..=6_usize).prop_flat_map(|n| {
        let channels = 3 * n.div_ceil(2);
        let signal = |most: f64, count| prop::collection::vec(-most..most, count);
        let state = (signal(1.5, n), signal(2.0, n), signal(5.0, n));
        let missing = prop::collection::vec(prop::bool::weighted(0.15), channels);
        (mountings(n), 0..n, state, signal(20.0, channels), missing).prop_map(
            |(mountings, rigid, (q, dq, ddq), reading, missing)| Scene {
                mountings,
                rigid,
                q,
                dq,
                ddq,
                reading,
                missing,
            },
        )
    })
}

impl Scene {
    /// The arm; its first `rigid` joints follow their motors.
    fn robot(&self) -> Robot {
        arm(self.drives(), &self.mountings)
    }

    fn drives(&self) -> Vec<Drive> {
        (0..self.q.len()).map(|joint| Drive { elastic: joint >= self.rigid, ..drive() }).collect()
    }

    /// The posture with the accelerations of the rigid joints only.
    fn kinematics(&self, robot: &Robot) -> Kinematics<f64> {
        let known: Vec<_> = self.ddq.iter().enumerate().map(|(j, &a)| if j < self.rigid { a } else { 0.0 }).collect();
        let mut kinematics = Kinematics::new(&robot.tree);
        kinematics.set(&robot.tree, &self.q, &self.dq, &known);
        kinematics
    }

    /// Accelerations, and how well they were seen, in a word.
    fn solve(&self, robot: &Robot, reading: &[f64], worst: f64) -> (Vec<f64>, String) {
        let mut ddq: Vec<_> = (0..self.q.len()).map(|j| if j < self.rigid { self.ddq[j] } else { 0.0 }).collect();
        let sight = AccelerationMap::new(robot, worst).solve(robot, &self.kinematics(robot), reading, &mut ddq);
        (ddq, format!("{sight:?}"))
    }
}

/// Whitened map of the elastic joints' accelerations, and whitened reading without their effect.
fn whitened(robot: &Robot, kinematics: &Kinematics<f64>, reading: &[f64]) -> (DMatrix<f64>, DVector<f64>) {
    let n = robot.len();
    let mut map = DMatrix::zeros(reading.len(), n);
    let mut rest = DVector::from_column_slice(reading);
    let mut row = 0;
    for sensor in &robot.accelerometers {
        let bias = kinematics.specific_force(&sensor.frame);
        for (r, &axis) in sensor.axes.iter().enumerate() {
            rest[row + r] = (reading[row + r] - bias.0[axis]) / sensor.noise_std;
            kinematics.acceleration_map(&robot.tree, &sensor.frame, |joint, column| {
                map[(row + r, joint)] = column.0[axis] / sensor.noise_std;
            });
        }
        row += sensor.axes.len();
    }
    let rigid: Vec<_> = (0..n).filter(|&joint| !robot.drives[joint].elastic).collect();
    (map.remove_columns_at(&rigid), rest)
}

fn worst_std(map: &DMatrix<f64>) -> f64 {
    1.0 / map.clone().singular_values().min()
}

proptest! {
    #![proptest_config(config(500))]

    #[test]
    fn accelerations_are_the_least_squares_solution(scene in scenes()) {
        let robot = scene.robot();
        let (map, rest) = whitened(&robot, &scene.kinematics(&robot), &scene.reading);
        prop_assume!(worst_std(&map) < 5.0);
        let expected = map.svd(true, true).solve(&rest, 0.0).unwrap();
        let (found, sight) = scene.solve(&robot, &scene.reading, 10.0);
        prop_assert_eq!(sight, "Full");
        prop_assert_eq!(&found[..scene.rigid], &scene.ddq[..scene.rigid]);
        for (found, expected) in found[scene.rigid..].iter().zip(&expected) {
            prop_assert!((found - expected).abs() <= 1e-9 * (1.0 + expected.abs()));
        }
    }

    #[test]
    fn a_perfect_reading_gives_the_accelerations_back(scene in scenes()) {
        let robot = scene.robot();
        let mut truth = Kinematics::new(&robot.tree);
        truth.set(&robot.tree, &scene.q, &scene.dq, &scene.ddq);
        let reading: Vec<_> = robot.accelerometers.iter().flat_map(|s| truth.specific_force(&s.frame).0).collect();
        prop_assume!(worst_std(&whitened(&robot, &truth, &reading).0) < 5.0);
        let (found, _) = scene.solve(&robot, &reading, 10.0);
        for (found, expected) in found.iter().zip(&scene.ddq) {
            prop_assert!((found - expected).abs() <= 1e-9);
        }
    }

    #[test]
    fn a_missing_channel_is_a_channel_that_is_not_there(scene in scenes()) {
        let mut poorer = scene.mountings.clone();
        for (channel, _) in scene.missing.iter().enumerate().filter(|(_, missing)| **missing) {
            poorer[channel / 3].axes.retain(|&axis| axis != channel % 3);
        }
        let present = |values: &[f64]| -> Vec<f64> {
            values.iter().zip(&scene.missing).filter(|(_, missing)| !**missing).map(|(v, _)| *v).collect()
        };
        let poor = arm(scene.drives(), &poorer);
        prop_assume!(poor.acceleration_channels() >= scene.q.len() - scene.rigid);
        let reading = scene.reading.iter().zip(&scene.missing).map(|(&v, &m)| if m { f64::NAN } else { v });
        let (found, sight) = scene.solve(&scene.robot(), &reading.collect::<Vec<_>>(), 10.0);
        let (expected, same) = scene.solve(&poor, &present(&scene.reading), 10.0);
        prop_assert_eq!(sight, same);
        for (found, expected) in found.iter().zip(&expected) {
            prop_assert!((found - expected).abs() <= 1e-8 * (1.0 + expected.abs()), "{found} {expected}");
        }
    }

    /// Whatever is missing and wherever the arm stands: no more than what is left of the reading, times 1/ε.
    #[test]
    fn gain_never_exceeds_the_worst_that_is_accepted(scene in scenes(), worst in 0.1..10.0_f64) {
        let robot = scene.robot();
        let reading: Vec<_> =
            scene.reading.iter().zip(&scene.missing).map(|(&v, &m)| if m { f64::NAN } else { v }).collect();
        let (_, rest) = whitened(&robot, &scene.kinematics(&robot), &reading);
        let norm = rest.iter().filter(|r| !r.is_nan()).map(|r| r * r).sum::<f64>().sqrt();
        let (found, _) = scene.solve(&robot, &reading, worst);
        let found = DVector::from_column_slice(&found[scene.rigid..]);
        prop_assert!(found.norm() <= (1.0 + 1e-9) * worst * norm, "{} {}", found.norm(), worst * norm);
    }
}

/// A flat arm stretched out: its sensor, at the tip, does not see one combination of the two accelerations.
fn stretched(elbow: f64, worst: f64) -> (Vec<f64>, String) {
    let tip = Mounting { body: 2, at: [0.4, 0.0, 0.0], axes: vec![0, 2], noise_std: 0.05 };
    let rigid_base = Drive { elastic: false, ..drive() };
    let scene = Scene {
        mountings: vec![tip],
        rigid: 1,
        q: vec![0.0, 0.3, elbow],
        dq: vec![0.0; 3],
        ddq: vec![0.0; 3],
        reading: vec![],
        missing: vec![],
    };
    let robot = arm(vec![rigid_base, drive(), drive()], &scene.mountings);
    let still = scene.kinematics(&robot).specific_force(&robot.accelerometers[0].frame).0;
    scene.solve(&robot, &[still[0] + 1.0, still[2] - 0.5], worst)
}

#[test]
fn through_a_singular_posture_the_solution_is_continuous() {
    let largest_step = |count: usize| -> f64 {
        let path: Vec<_> = (0..=count).map(|i| stretched(-1.2 + 2.4 * i as f64 / count as f64, 0.5).0).collect();
        path.windows(2).flat_map(|w| (0..3).map(|j| (w[1][j] - w[0][j]).abs()).collect::<Vec<_>>()).fold(0.0, f64::max)
    };
    let (coarse, fine) = (largest_step(2_000), largest_step(20_000));
    assert!((0.05..0.2).contains(&(fine / coarse)), "steps of {coarse} and {fine}: a jump");
}

#[test]
fn near_a_singular_posture_sight_goes_from_clear_to_blind() {
    let sights: Vec<_> = (0..=2000).map(|i| stretched(-1.2 + 1.2e-3 * f64::from(i), 0.5).1).collect();
    for sight in ["Full", "Damped", "Unobservable"] {
        assert!(sights.iter().any(|s| s == sight), "never {sight}");
    }
    let changes = sights.windows(2).filter(|w| w[0] != w[1]).count();
    assert_eq!(changes, 4, "clear, damped, blind, damped, clear");
}

// Starts at rest

fn hardening() -> impl Strategy<Value = Drive> {
    (4.0..6.0_f64, 0.0..1e8_f64, 0.0..0.5_f64, 0.0..1e4_f64).prop_map(|(stiffness, cubic, share, shape)| {
        let stiffness = 10_f64.powf(stiffness);
        Drive {
            stiffness,
            cubic_stiffness: cubic,
            soft_windup: SoftWindup { stiffness: share * stiffness, shape },
            ..drive()
        }
    })
}

fn gravity_torque(robot: &Robot, q: &[f64]) -> Vec<f64> {
    let (mut kinematics, mut loads) = (Kinematics::new(&robot.tree), Loads::new(&robot.tree));
    let (zero, mut torque) = (vec![0.0; q.len()], vec![0.0; q.len()]);
    kinematics.set(&robot.tree, q, &zero, &zero);
    loads.inverse_dynamics_into(&robot.tree, &kinematics, &mut torque);
    torque
}

proptest! {
    #![proptest_config(config(300))]

    #[test]
    fn springs_hold_the_links_at_rest(
        drives in prop::collection::vec(hardening(), 3),
        theta in prop::collection::vec(-3.0..3.0_f64, 3),
        rigid in 0..3_usize,
    ) {
        let mut drives = drives;
        drives[rigid].elastic = false;
        let robot = arm(drives, &[]);
        let q = link_position_at_rest(&robot, &theta).unwrap();
        let torque = gravity_torque(&robot, &q);
        for (joint, drive) in robot.drives.iter().enumerate() {
            let torsion = theta[joint] - q[joint];
            let spring = drive.spring_torque(torsion);
            let residual = if drive.elastic { spring - torque[joint] } else { torsion };
            // The rounding of angles of up to three radians, stiffened.
            prop_assert!(residual.abs() <= 1e-9 * (1.0 + torque[joint].abs() + 1e-3 * drive.stiffness), "{residual}");
        }
    }
}

#[test]
fn a_spring_too_soft_for_gravity_has_no_equilibrium() {
    let soft = Drive { stiffness: 5.0, ..drive() };
    let robot = arm(vec![drive(), soft], &[]);
    assert_eq!(link_position_at_rest(&robot, &[0.0, 0.3]), Err(DesignError::NoEquilibrium));
}

// Runs

fn poles(robot: &Robot, omega: f64) -> Vec<Vec<Complex>> {
    let pair = |damping: f64| [1.0, -1.0].map(|s| omega * Complex::new(-damping, s * (1.0 - damping * damping).sqrt()));
    let real = [Complex::new(-omega, 0.0)];
    let one =
        |drive: &Drive| if drive.elastic { [pair(0.9), pair(0.75)].concat() } else { [&pair(0.9)[..], &real].concat() };
    robot.drives.iter().map(one).collect()
}

fn settings(robot: &Robot) -> ObserverSettings {
    ObserverSettings {
        period: 5e-4,
        poles: poles(robot, 250.0),
        bias: false,
        form: Form::Current,
        source: AccelerationSource::Sensors,
        worst_acceleration_std: 10.0,
        start: Start::Rest,
    }
}

/// Three elastic joints, one sensor.
fn three_joints() -> Robot {
    let sensor = Mounting { body: 2, at: [0.3, 0.2, 0.1], axes: vec![0, 1, 2], noise_std: 0.05 };
    arm(vec![drive(); 3], &[sensor])
}

fn observer(change: impl FnOnce(&mut ObserverSettings)) -> Result<AccelerationObserver, DesignError> {
    let robot = three_joints();
    let mut settings = settings(&robot);
    change(&mut settings);
    AccelerationObserver::new(Arc::new(robot), settings)
}

/// A recording of three joints that sway about a posture, with a few samples missing.
#[derive(Clone, Debug)]
struct Signals {
    count: usize,
    theta: Vec<f64>,
    tau: Vec<f64>,
    acceleration: Vec<f64>,
}

impl Signals {
    fn new(count: usize, phase: f64, gaps: &[usize]) -> Self {
        let robot = three_joints();
        let still = gravity_torque(&robot, &[0.0, 0.4, 0.8]);
        let sway = |i: usize, j: usize| (0.01 * i as f64 + phase + j as f64).sin();
        let rows = |f: &dyn Fn(usize, usize) -> f64| (0..3 * count).map(|k| f(k / 3, k % 3)).collect::<Vec<_>>();
        let mut theta = rows(&|i, j| 0.4 * j as f64 + 0.01 * sway(i, j));
        let tau = rows(&|i, j| still[j] + 10.0 * sway(i, j));
        let mut acceleration = rows(&|i, j| if j == 2 { 9.81 } else { 0.0 } + sway(i, j));
        for &gap in gaps {
            acceleration[gap % (3 * count)] = f64::NAN;
            theta[3 + gap % (3 * count - 3)] = f64::NAN;
        }
        Self { count, theta, tau, acceleration }
    }

    fn rows(&self, start: usize, end: usize) -> ObserverRecording<'_> {
        let rows = 3 * start..3 * end;
        ObserverRecording {
            count: end - start,
            theta: &self.theta[rows.clone()],
            tau: &self.tau[rows.clone()],
            acceleration: &self.acceleration[rows],
        }
    }

    fn whole(&self) -> ObserverRecording<'_> {
        self.rows(0, self.count)
    }
}

/// Every number of an estimate, as bits.
fn bits(t: &ObserverOutput) -> Vec<u64> {
    let numbers = [&t.q, &t.dq, &t.ddq, &t.theta, &t.dtheta, &t.tool].into_iter().flatten().map(|x| x.to_bits());
    numbers.chain(t.status.iter().map(|&s| u64::from(s))).collect()
}

proptest! {
    #![proptest_config(config(50))]

    #[test]
    fn pieces_make_the_whole(cut in 0..=60_usize, phase in 0.0..6.0_f64, gaps in prop::collection::vec(0..180_usize, 0..5)) {
        let signals = Signals::new(60, phase, &gaps);
        let fresh = observer(|_| ()).unwrap();
        let whole = fresh.clone().run(signals.whole()).unwrap();
        let mut live = fresh;
        let mut pieces = live.run(signals.rows(0, cut)).unwrap();
        let rest = live.run(signals.rows(cut, 60)).unwrap();
        for (head, tail) in [
            (&mut pieces.q, rest.q), (&mut pieces.dq, rest.dq), (&mut pieces.ddq, rest.ddq),
            (&mut pieces.theta, rest.theta), (&mut pieces.dtheta, rest.dtheta), (&mut pieces.tool, rest.tool),
        ] {
            head.extend(tail);
        }
        pieces.status.extend(rest.status);
        prop_assert_eq!(bits(&whole), bits(&pieces));
        prop_assert_eq!(whole.status.iter().any(|s| s & Status::BRIDGED != 0), !gaps.is_empty());
    }
}

#[test]
fn a_batch_is_each_recording_on_its_own() {
    let signals: Vec<_> = (0..7).map(|i| Signals::new(40 + i, i as f64, &[i])).collect();
    let fresh = observer(|_| ()).unwrap();
    let recordings: Vec<_> = signals.iter().map(Signals::whole).collect();
    for (one, recording) in fresh.run_all(&recordings).into_iter().zip(&recordings) {
        assert_eq!(bits(&one.unwrap()), bits(&fresh.clone().run(*recording).unwrap()));
    }
}

#[test]
fn reset_starts_anew() {
    let signals = Signals::new(50, 0.0, &[]);
    let mut live = observer(|_| ()).unwrap();
    let first = live.run(signals.whole()).unwrap();
    live.reset();
    assert_eq!(bits(&first), bits(&live.run(signals.whole()).unwrap()));
}

#[test]
fn the_predictor_reports_what_the_innovation_then_corrects() {
    let signals = Signals::new(50, 0.0, &[]);
    let [current, predicted] =
        [Form::Current, Form::Predictor].map(|form| observer(|s| s.form = form).unwrap().run(signals.whole()).unwrap());
    assert_ne!(bits(&current), bits(&predicted));
    let innovation = |t: &ObserverOutput| signals.theta.iter().zip(&t.theta).map(|(a, b)| (a - b).abs()).sum::<f64>();
    assert!(innovation(&current) < innovation(&predicted));
}

// What is refused

#[test]
fn poles_that_do_not_fit_are_refused() {
    let three = vec![Complex::new(-100.0, 0.0); 3];
    let refused = observer(|s| s.poles[1] = three).unwrap_err();
    assert_eq!(refused, DesignError::PoleCount { joint: 1, found: 3, expected: 4 });
    let refused = observer(|s| s.poles.truncate(2)).unwrap_err();
    assert_eq!(refused, DesignError::Length { what: "poles", found: 2, expected: 3 });
}

#[test]
fn unstable_poles_are_refused() {
    for (re, im) in [(0.0, 0.0), (1.0, 0.0), (f64::NAN, 0.0), (f64::NEG_INFINITY, 0.0), (-1.0, f64::INFINITY)] {
        let refused = observer(|s| s.poles[2][0] = Complex::new(re, im)).unwrap_err();
        assert!(matches!(refused, DesignError::UnstablePole { joint: 2, .. }), "{refused}");
    }
}

#[test]
fn unpaired_poles_are_refused() {
    for im in [30.0, -30.0] {
        let lonely = [(-50.0, im), (-1.0, 0.0), (-2.0, 0.0), (-3.0, 0.0)].map(|(re, im)| Complex::new(re, im));
        let refused = observer(|s| s.poles[0] = lonely.to_vec()).unwrap_err();
        assert_eq!(refused, DesignError::UnpairedPole { joint: 0, re: -50.0, im });
    }
}

#[test]
fn poles_too_fast_for_the_period_are_refused() {
    let refused = observer(|s| s.period = 1e-2).unwrap_err();
    let DesignError::FastPole { joint: 0, speed, period, limit } = refused else { panic!("{refused}") };
    assert!((speed - 250.0).abs() < 1e-9);
    assert_eq!((period, limit), (1e-2, 200.0));
}

#[test]
fn settings_out_of_range_are_refused() {
    for value in [0.0, -1.0, f64::INFINITY] {
        let expected = "a positive number";
        let refused = observer(|s| s.period = value).unwrap_err();
        assert_eq!(refused, DesignError::Range { what: "the sampling period", value, expected });
        let refused = observer(|s| s.worst_acceleration_std = value).unwrap_err();
        assert_eq!(refused, DesignError::Range { what: "worst_acceleration_std", value, expected });
    }
    assert!(matches!(observer(|s| s.period = f64::NAN), Err(DesignError::Range { .. })));
}

#[test]
fn too_few_accelerations_are_refused_unless_given_by_joint() {
    let one_axis = Mounting { body: 2, at: [0.3, 0.0, 0.0], axes: vec![2], noise_std: 0.05 };
    let robot = Arc::new(arm(vec![drive(); 3], &[one_axis]));
    let by_sensors = settings(&robot);
    let by_joints = ObserverSettings { source: AccelerationSource::Joints, ..by_sensors.clone() };
    let refused = AccelerationObserver::new(robot.clone(), by_sensors).unwrap_err();
    assert_eq!(refused, DesignError::TooFewAccelerations { joints: 3, channels: 1 });
    assert!(AccelerationObserver::new(robot, by_joints).is_ok());
}

#[test]
fn a_start_needs_every_motor_position() {
    let signals = Signals::new(2, 0.0, &[]);
    let sample = ObserverSample {
        theta: &[0.0, f64::NAN, 0.0],
        tau: &signals.tau[..3],
        acceleration: &signals.acceleration[..3],
    };
    assert_eq!(observer(|_| ()).unwrap().step(sample), Err(RunError::Design(DesignError::NoStart { joint: 1 })));
}

#[test]
fn arrays_of_wrong_length_are_refused() {
    let mut live = observer(|_| ()).unwrap();
    let refused = live.start(&[0.0; 3], &[0.0; 3], &[0.0; 2], &[0.0; 3]).unwrap_err();
    assert_eq!(refused, DesignError::Length { what: "dtheta", found: 2, expected: 3 });
    let signals = Signals::new(4, 0.0, &[]);
    let short = ObserverRecording { tau: &signals.tau[..9], ..signals.whole() };
    let refused = live.run(short).unwrap_err();
    assert_eq!(refused, DesignError::Length { what: "tau", found: 9, expected: 12 }.into());
}

#[test]
fn an_estimate_that_is_not_finite_is_refused_by_its_sample() {
    let mut signals = Signals::new(20, 0.0, &[]);
    signals.acceleration[3 * 7 + 1] = f64::INFINITY;
    assert_eq!(observer(|_| ()).unwrap().run(signals.whole()).unwrap_err(), RunError::NotFinite { sample: 7 });
}
