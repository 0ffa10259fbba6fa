//! What promises not to allocate does not: a control loop must not wait for memory.
#![allow(unsafe_code)] // an allocator that counts

mod arm;

use arm::{Mounting, arm, drive};
use core::cell::Cell;
use core::hint::black_box;
use linkside_core::dynamics::{Kinematics, Loads};
use linkside_core::estimate::kalman::{
    ExtendedKalmanFilter, FilterSettings, FixedLagSmoother, Inputs, JerkDriven, JerkModel, JerkNoise, KalmanSample,
    Lateness, LinkDisturbance, NoiseLoss, SigmaRule, Tolerance, Uncertain, WrenchLaw,
};
use linkside_core::estimate::measurement::Kind;
use linkside_core::estimate::observer::{
    AccelerationObserver, AccelerationSource, Complex, Form, ObserverSample, ObserverSettings, Start, Uncertainty,
    link_position_at_rest,
};
use linkside_core::estimate::particle::{
    Collapse, Density, Marginalised, ParticleFilter, ParticleSettings, Proposal, Resampling,
};
use linkside_core::estimate::velocity::{self, GainMap, Gains, Logic, Schedule, VelocityObserver};
use linkside_core::robot::{
    Acting, Anchor, Counterbalance, Drive, FrictionElement, Hysteresis, Robot, Strut, TorqueHarmonic, TorqueSeries,
    Wrench,
};
use linkside_core::simulate::{Adaptive, Plant, StepTolerance};
use linkside_core::spatial::Vec3;
use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::Arc;

/// The system's allocator, which counts how often each thread asks it.
struct Counting;

thread_local! {
    static COUNT: Cell<usize> = const { Cell::new(0) };
}

// SAFETY: every call is handed on to the system's allocator as it came.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        COUNT.set(COUNT.get() + 1);
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        COUNT.set(COUNT.get() + 1);
        unsafe { System.dealloc(pointer, layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        COUNT.set(COUNT.get() + 1);
        unsafe { System.realloc(pointer, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// How often this thread asks for memory, or gives it back, in `work`.
fn allocations(work: impl FnOnce()) -> usize {
    let before = COUNT.get();
    work();
    COUNT.get() - before
}

/// Six joints, the last one rigid, two sensors and what carries some of the weight.
fn robot() -> Robot {
    let sensor = |body, at| Mounting { body, at, axes: vec![0, 1, 2], noise_std: 0.05 };
    let mut drives = vec![drive(); 6];
    drives[5].elastic = false;
    let robot = arm(drives, &[sensor(2, [0.3, 0.2, 0.1]), sensor(4, [0.3, 0.1, 0.2])]);
    let ends = [(None, [0.2, 0.1, 0.0]), (Some(2), [0.1, 0.2, 0.3])].map(|(body, p)| Anchor { body, point: Vec3(p) });
    let strut = Strut::Spring { stiffness: 300.0, length: 0.2 };
    let series = TorqueSeries(vec![TorqueHarmonic { order: 2, cosine: 3.0, sine: -1.0 }]);
    let carried = [Counterbalance::Between { ends, strut }, Counterbalance::Turning { joints: vec![1, 2], series }];
    robot.with_counterbalances(&carried).unwrap()
}

fn poles(drive: &Drive) -> Vec<Complex> {
    let real = if drive.elastic { 5 } else { 3 };
    (0..real).map(|i| Complex::new(-200.0 - 10.0 * f64::from(i), 0.0)).collect()
}

fn observer(form: Form, source: AccelerationSource) -> AccelerationObserver {
    let robot = robot();
    let settings = ObserverSettings {
        period: 5e-4,
        poles: robot.drives.iter().map(poles).collect(),
        bias: true,
        form,
        source,
        worst_acceleration_std: 10.0,
        start: Start::Rest,
    };
    let tolerances = (0..6).map(|j| Tolerance { parameter: Uncertain::Stiffness(j), std: 0.2 });
    let rigid = Tolerance { parameter: Uncertain::Yielding(5), std: 1e-5 };
    let uncertainty = Uncertainty {
        tolerances: tolerances.chain([rigid]).collect::<Vec<_>>().into(),
        encoder: vec![1e-6; 6],
        torque: vec![1.0; 6],
        bias: 0.5,
        scale: 0.03,
    };
    AccelerationObserver::new(Arc::new(robot), settings).unwrap().with_uncertainty(&uncertainty).unwrap()
}

#[test]
fn the_counter_counts() {
    assert_eq!(allocations(|| drop(black_box(vec![1.0; 3]))), 2);
    assert!(allocations(|| drop(link_position_at_rest(&robot(), &[0.0; 6]))) > 0);
}

#[test]
fn a_step_allocates_nothing() {
    let theta: Vec<_> = (0..6).map(|j| 0.1 * f64::from(j)).collect();
    for form in [Form::Current, Form::Predictor] {
        for source in [AccelerationSource::Sensors, AccelerationSource::Joints] {
            let mut observer = observer(form, source);
            let mut step = |theta: &[f64], acceleration: &[f64]| {
                observer.step(ObserverSample { theta, tau: &[1.0; 6], acceleration }).unwrap();
            };
            step(&theta, &[0.5; 6]);
            let missing = [f64::NAN; 6];
            let count = allocations(|| {
                for acceleration in [[0.5; 6], missing, [0.1; 6]] {
                    step(&theta, &acceleration);
                }
                step(&missing, &[0.5; 6]);
            });
            assert_eq!(count, 0, "{form:?}, {source:?}");
        }
    }
}

#[test]
fn a_kalman_step_allocates_nothing() {
    check_kalman_step(false, None);
    check_kalman_step(true, None);
    check_kalman_step(false, Some(SigmaRule::Unscented));
}

fn check_kalman_step(disturbed: bool, points: Option<SigmaRule>) {
    let mut robot = robot();
    robot.drives[1].hysteresis = Hysteresis { elements: vec![FrictionElement::dahl(5e4, 20.0)] };
    if disturbed {
        let frame = robot.tool.clone().unwrap();
        robot = robot.with_wrenches(vec![Wrench { frame, acting: Acting::Varying { measured: false } }]).unwrap();
    }
    let mut model = JerkModel::new(
        Arc::new(robot),
        &[Kind::Motor, Kind::Acceleration, Kind::MotorVelocity, Kind::Link, Kind::Torque],
        &[true; 30],
    )
    .unwrap();
    if disturbed {
        let law = LinkDisturbance { initial: vec![5.0; 6], walk: vec![20.0; 6], time: 1.0 };
        let wrenches = WrenchLaw { initial: vec![20.0; 6], walk: vec![30.0; 6] };
        model = model.with_disturbances(Some(law), wrenches).unwrap();
    }
    let noise = JerkNoise {
        jerk: vec![20.0; 6],
        link_walk: vec![0.0; 12],
        reading: vec![1e-3; 30],
        torsion: 1e-3,
        bias_walk: vec![1e-6; 30],
        bias_time: vec![50.0; 30],
        initial: vec![1e-3; 18],
        initial_bias: vec![1e-4; 30],
    };
    let settings = FilterSettings { gate: Some(50.0), iterations: 2 };
    let mut filter = ExtendedKalmanFilter::new(JerkDriven::new(model, noise, true).unwrap(), settings).unwrap();
    filter.set_losses(&[NoiseLoss::StudentT; 30]).unwrap();
    filter.set_points(points);
    let mut lagged = FixedLagSmoother::new(&filter, 3).unwrap();
    let (readings, missing) = ([0.1; 30], [f64::NAN; 30]);
    let mut step = |readings: &[f64], dtheta: &[f64]| {
        let inputs = Inputs { dtheta, jerk: &[0.5; 6], tau: &[] };
        filter.step(KalmanSample { dt: 5e-4, readings, inputs }).unwrap();
        lagged.step(KalmanSample { dt: 5e-4, readings, inputs }).unwrap();
    };
    step(&readings, &[0.0; 6]);
    let count = allocations(|| {
        for dtheta in [[0.0; 6], [f64::NAN; 6]] {
            step(&readings, &dtheta);
            step(&missing, &dtheta);
            step(&readings, &dtheta);
        }
    });
    assert_eq!(count, 0);
}

#[test]
fn a_velocity_observers_step_allocates_nothing() {
    let schedule = Schedule {
        gains: vec![50.0, 80.0, 110.0],
        bound: 0.5,
        margin: 0.1,
        hysteresis: 0.05,
        start: 1,
        dwell: 0,
        logic: Logic::Repaired,
    };
    let mut linear = vec![0.0; 36];
    linear.iter_mut().step_by(7).for_each(|gain| *gain = 50.0);
    let map = GainMap { linear, waves: vec![1.0; 12], sine: vec![2.0; 12], cosine: vec![1.0; 12] };
    let kinds = [(Gains::Constant(vec![50.0; 6]), 100.0), (Gains::Scheduled(schedule), 0.0), (Gains::Mapped(map), 0.0)];
    for (gains, spring) in kinds {
        let settings = velocity::VelocitySettings {
            period: 5e-4,
            gains,
            spring: vec![spring; 6],
            motors: true,
            start: Start::Rest,
            wrap: vec![core::f64::consts::TAU; 6],
        };
        let mut observer = VelocityObserver::new(Arc::new(robot()), settings).unwrap();
        observer.step(&[0.1; 6], &[1.0; 6]).unwrap();
        let count = allocations(|| {
            for (q, torque) in [([0.1; 6], [1.0; 6]), ([f64::NAN; 6], [f64::NAN; 6]), ([0.13; 6], [2.0; 6])] {
                observer.step(&q, &torque).unwrap();
            }
        });
        assert_eq!(count, 0);
        assert!(observer.is_finite());
    }
}

#[test]
fn a_particle_filters_step_allocates_nothing() {
    let inside = Some(Lateness { time_constant: 2e-3, delay: 1.2e-3, steps: 4 });
    let late = [vec![], [vec![None; 6], vec![inside; 6]].concat()];
    let kinds = [Marginalised::Nothing, Marginalised::Biases, Marginalised::Accelerations];
    for (marginalised, late) in kinds.into_iter().flat_map(|kind| late.iter().map(move |late| (kind, late))) {
        let model = JerkModel::new(Arc::new(robot()), &[Kind::Motor, Kind::Acceleration], &[true; 12]).unwrap();
        let noise = JerkNoise {
            jerk: vec![20.0; 6],
            link_walk: vec![1e-5; 12],
            reading: vec![1e-2; 12],
            torsion: 1e-3,
            bias_walk: vec![1e-6; 12],
            bias_time: vec![50.0; 12],
            initial: vec![1e-3; 18],
            initial_bias: vec![1e-4; 12],
        };
        let settings = ParticleSettings {
            particles: 600,
            seed: 0,
            proposal: Proposal::Linearised { iterations: 2, tail: Some(4) },
            resampling: Resampling::Residual,
            threshold: 1.0, // particles are chosen at every step
            kernel: Some(0.5),
            densities: vec![Density::Normal; 12],
            limits: vec![(-1e3, 1e3); 6],
            initial: vec![],
            collapse: Collapse::Flag,
            quantiles: vec![],
        };
        let model = JerkDriven::new(model, noise, true).unwrap().with_late(late).unwrap();
        let mut filter = ParticleFilter::new(model, settings, marginalised).unwrap();
        let mut step = |readings: &[f64]| {
            let inputs = Inputs { dtheta: &[0.1; 6], jerk: &[0.5; 6], tau: &[] };
            filter.step(KalmanSample { dt: 5e-4, readings, inputs }).unwrap();
        };
        step(&[0.1; 12]);
        let count = allocations(|| {
            for readings in [[0.1; 12], [f64::NAN; 12], [0.2; 12], [-0.2; 12]] {
                step(&readings);
            }
        });
        assert_eq!(count, 0, "{marginalised:?} {}", late.len());
    }
}

#[test]
fn an_adaptive_step_allocates_nothing() {
    let robot = robot();
    let mut plant = Plant::new(&robot);
    let mut adaptive = Adaptive::new(&plant, StepTolerance { rtol: 1e-6, atol: 1e-9 }).unwrap();
    let mut x = vec![0.1; plant.layout.dense];
    let mut advance = |t: f64| adaptive.advance(&robot, &mut plant, &mut x, &[3.0; 6], (t, 1e-3)).unwrap();
    advance(0.0);
    assert_eq!(allocations(|| (1..50).for_each(|i| advance(1e-3 * f64::from(i)))), 0);
    assert!(x.iter().all(|x| x.is_finite()));
}

#[test]
fn kernels_allocate_nothing() {
    let robot = robot();
    let (tree, n) = (&robot.tree, robot.len());
    let mut kinematics = Kinematics::new(tree);
    let mut loads = Loads::new(tree);
    let mut tau = vec![0.0; n];
    let mut matrices = [vec![0.0; n * n], vec![0.0; n * n], vec![0.0; n * n]];
    let (q, dq, ddq) = ([0.3; 6], [0.2; 6], [0.1; 6]);
    let mut sum = 0.0;
    let count = allocations(|| {
        let [by_q, by_dq, mass] = &mut matrices;
        kinematics.set(tree, &q, &dq, &ddq);
        loads.inverse_dynamics_into(tree, &kinematics, &mut tau);
        loads.coriolis_matrix_into(tree, &kinematics, by_q);
        loads.mass_matrix_into(tree, &kinematics, mass);
        loads.inverse_dynamics_derivatives_into(tree, &kinematics, &mut tau, by_q, by_dq, mass);
        for sensor in &robot.accelerometers {
            sum += kinematics.specific_force(&sensor.frame).0[0];
            kinematics.acceleration_map(tree, &sensor.frame, |_, column| sum += column.0[0]);
            kinematics.specific_force_derivatives(tree, &sensor.frame, |_, [by_q, ..]| sum += by_q.0[0]);
        }
    });
    assert_eq!(count, 0);
    assert!(sum.is_finite() && tau[1] != 0.0);
}
