//! Dynamics and sensor kernels on random trees: identities of mechanics, derivatives, lanes; and what is refused.

mod support;

use linkside_core::error::RobotError;
use linkside_core::robot::{BodySpec, Drive, Frame, JointKind, Robot, Sensor, Tree};
use linkside_core::scalar::{Dual, Lanes, Scalar};
use linkside_core::spatial::{Mat3, Vec3};
use nalgebra::{DMatrix, DVector};
use proptest::prelude::*;
use support::{
    Case, DIRECTIONS, Kernels, State, balanced_cases, cases, check_close, check_same_bits, config, gradients, multiply,
    packed, rigid_body, transposed, varied,
};

proptest! {
    #![proptest_config(config())]

    #[test]
    fn torque_is_the_sum_of_inertial_coriolis_and_gravity_torque(case in cases()) {
        let State { dq, ddq, .. } = case.state();
        let mut kernels = Kernels::new(&case.tree, case.state());
        let (inertial, coriolis) = (multiply(&kernels.mass(), ddq), multiply(&kernels.coriolis(), dq));
        let gravity = Kernels::new(&case.tree, &case.state().at_rest()).torque();
        let sum: Vec<_> = (0..dq.len()).map(|i| inertial[i] + coriolis[i] + gravity[i]).collect();
        check_close(&kernels.torque(), &sum)?;
    }

    #[test]
    fn mass_matrix_is_symmetric_and_positive_definite(case in cases()) {
        let n = case.tree.len();
        let mass = Kernels::new(&case.tree, case.state()).mass();
        check_same_bits(&mass, &transposed(&mass, n))?;
        prop_assert!(DMatrix::from_row_slice(n, n, &mass).cholesky().is_some());
    }

    #[test]
    fn coriolis_torque_is_symmetric_in_both_velocities(case in cases()) {
        let [u, w, ..] = &case.states;
        let at = |dq: &[f64]| State { q: u.q.clone(), dq: dq.to_vec(), ddq: u.ddq.clone() };
        let [by_u, by_w] = [u, w].map(|s| Kernels::new(&case.tree, &at(&s.dq)).coriolis());
        check_close(&multiply(&by_u, &w.dq), &multiply(&by_w, &u.dq))?;
    }

    #[test]
    fn coriolis_matrix_is_half_the_derivative_of_its_torque(case in cases()) {
        let state = varied(case.state());
        let torque = multiply(&Kernels::new(&case.tree, &state).coriolis(), &state.dq);
        let [_, by_dq, by_ddq] = gradients(&torque, case.tree.len());
        let twice: Vec<_> = Kernels::new(&case.tree, case.state()).coriolis().iter().map(|c| 2.0 * c).collect();
        check_close(&twice, &by_dq)?;
        prop_assert!(by_ddq.iter().all(|&d| d == 0.0));
    }

    /// For a symmetric Ṁ, Ṁ − 2C is skew just when Ṁ = C + Cᵀ.
    #[test]
    fn mass_rate_less_twice_coriolis_is_skew(case in cases()) {
        let mut kernels = Kernels::new(&case.tree, &case.state().in_time());
        let rate: Vec<_> = kernels.mass().iter().map(|m| m.gradient[0]).collect();
        let coriolis = Kernels::new(&case.tree, case.state()).coriolis();
        let sum: Vec<_> = coriolis.iter().zip(transposed(&coriolis, case.tree.len())).map(|(a, b)| a + b).collect();
        check_close(&sum, &rate)?;
    }

    #[test]
    fn torque_derivatives_are_those_of_dual_numbers(case in cases()) {
        let torque = Kernels::new(&case.tree, &varied(case.state())).torque();
        let mut kernels = Kernels::new(&case.tree, case.state());
        let (tau, derivatives) = kernels.torque_derivatives();
        for (found, expected) in derivatives.iter().zip(gradients(&torque, case.tree.len())) {
            check_close(found, &expected)?;
        }
        check_close(&tau, &kernels.torque())?;
        check_close(&derivatives[2], &kernels.mass())?;
    }

    #[test]
    fn counterbalances_have_the_derivatives_of_dual_numbers(case in balanced_cases()) {
        let n = case.tree.len();
        let torque = Kernels::new(&case.tree, &varied(case.state())).torque();
        let (tau, [by_q, by_dq, mass]) = Kernels::new(&case.tree, case.state()).torque_derivatives();
        for (found, expected) in [&by_q, &by_dq, &mass].into_iter().zip(gradients(&torque, n)) {
            check_close(found, &expected)?;
        }
        let own = Kernels::new(&case.tree, case.state()).in_own_axes(&case.frame());
        check_close(&tau, &own[..n])?;
        // Of a potential: curl-free.
        let rest = case.state().at_rest();
        let (_, [by_q, ..]) = Kernels::new(&case.tree, &rest).torque_derivatives();
        check_close(&by_q, &transposed(&by_q, n))?;
        check_lanes::<8>(&case)?;
    }

    #[test]
    fn sensor_derivatives_are_those_of_dual_numbers(case in cases()) {
        let (frame, zero) = (case.frame(), vec![0.0; 3 * case.tree.len()]);
        let [position, force, rate] = sensor_gradients(&case, &frame);
        let kernels = Kernels::new(&case.tree, case.state());
        let [rate_by_q, rate_by_dq] = kernels.rate_derivatives(&frame);
        check_matrices(&[kernels.position_jacobian(&frame), zero.clone(), zero.clone()], &position)?;
        check_matrices(&kernels.force_derivatives(&frame), &force)?;
        check_matrices(&[rate_by_q, rate_by_dq, zero], &rate)?;
        check_close(&kernels.acceleration_map(&frame), &force[2])?;
    }

    #[test]
    fn loads_and_readings_are_the_same_in_the_bodies_own_axes(case in cases()) {
        let frame = case.frame();
        let mut kernels = Kernels::new(&case.tree, case.state());
        let sensed = kernels.sensed(&frame);
        let expected: Vec<_> = kernels.torque().into_iter().chain(sensed.into_iter().flat_map(|v| v.0)).collect();
        check_close(&kernels.in_own_axes(&frame), &expected)?;
        check_close(&kernels.mass_in_own_axes(), &kernels.mass())?;
    }

    #[test]
    fn lanes_hold_the_bits_of_one_sample_alone(case in cases()) {
        check_lanes::<4>(&case)?;
        check_lanes::<8>(&case)?;
    }

    #[test]
    fn scratch_remembers_nothing(case in cases()) {
        let (frame, [first, second, ..]) = (case.frame(), &case.states);
        let mut used = Kernels::new(&case.tree, first);
        used.everything(&frame);
        used.set(second);
        check_same_bits(&used.everything(&frame), &Kernels::new(&case.tree, second).everything(&frame))?;
    }

    #[test]
    fn power_of_the_joints_changes_the_energy(case in cases()) {
        let torque = Kernels::new(&case.tree, case.state()).torque();
        let power = dot(&case.state().dq, &torque);
        check_close(&[mechanical_energy(&case, &case.state().in_time()).gradient[0]], &[power])?;
    }

    #[test]
    fn accelerometer_at_rest_reads_gravity_upwards(case in cases()) {
        let kernels = Kernels::new(&case.tree, &case.state().at_rest());
        let [_, force, rate] = kernels.sensed(&case.frame());
        let expected = -orientation(&case, &kernels).apply_transposed(&case.gravity);
        check_close(&force.0, &expected.0)?;
        prop_assert_eq!(rate, Vec3([0.0; 3]));
    }

    /// Whatever its spin and its speed: joints without torque along x, y and z let the centre of mass fall.
    #[test]
    fn accelerometer_at_the_centre_of_mass_of_a_falling_body_reads_nothing(
        (falling, state) in falling_bodies(),
        gravity in support::vectors(10.0),
    ) {
        let tree = Tree::new(gravity, &falling).unwrap();
        let com = tree.frame("sensor", 3, &Mat3::IDENTITY, &falling[3].com).unwrap();
        let [_, force, _] = Kernels::new(&tree, &free_motion(&tree, state)).sensed(&com);
        check_close(&force.0, &[0.0; 3])?;
    }

    #[test]
    fn dual_arithmetic_follows_the_rules_of_calculus(x in -10.0..10.0, y in -10.0..10.0, c in -10.0..10.0) {
        let (a, b) = (Dual::<2>::variable(x, 0), Dual::<2>::variable(y, 1));
        let dual = |value: f64, gradient: [f64; 2]| Dual { value, gradient };
        prop_assert_eq!(a + b, dual(x + y, [1.0, 1.0]));
        prop_assert_eq!(a - b, dual(x - y, [1.0, -1.0]));
        prop_assert_eq!(a * b, dual(x * y, [y, x]));
        prop_assert_eq!(-a, dual(-x, [-1.0, 0.0]));
        prop_assert_eq!(a * c, dual(x * c, [c, 0.0]));
        prop_assert_eq!(a + c, dual(x + c, [1.0, 0.0]));
        prop_assert_eq!(accumulated(a, b), a * b + a - b);
        prop_assert_eq!(Dual::<2>::constant(c), dual(c, [0.0, 0.0]));
    }

    /// sin(x y) cos(x), and sin² + cos² = 1.
    #[test]
    fn dual_sine_and_cosine_obey_the_chain_rule(x in -10.0..10.0_f64, y in -10.0..10.0_f64) {
        let (a, b) = (Dual::<2>::variable(x, 0), Dual::<2>::variable(y, 1));
        let ((sin, cos), (sin_a, cos_a)) = ((a * b).sin_cos(), a.sin_cos());
        let by_x = y * (x * y).cos() * x.cos() - (x * y).sin() * x.sin();
        let by_y = x * (x * y).cos() * x.cos();
        let Dual { value, gradient } = sin * cos_a;
        check_close(&[value, gradient[0], gradient[1]], &[(x * y).sin() * x.cos(), by_x, by_y])?;
        for one in [sin * sin + cos * cos, sin_a * sin_a + cos_a * cos_a] {
            check_close(&[one.value, one.gradient[0], one.gradient[1]], &[1.0, 0.0, 0.0])?;
        }
    }

    #[test]
    fn lanes_compute_like_numbers_alone(x in numbers(), y in numbers(), c in -10.0..10.0) {
        let (a, b) = (Lanes(x), Lanes(y));
        let lanes = |f: fn(f64, f64, f64) -> f64| core::array::from_fn::<_, 4, _>(|i| f(x[i], y[i], c));
        check_same_bits(&(a + b).0, &lanes(|x, y, _| x + y))?;
        check_same_bits(&(a - b).0, &lanes(|x, y, _| x - y))?;
        check_same_bits(&(a * b).0, &lanes(|x, y, _| x * y))?;
        check_same_bits(&(-a).0, &lanes(|x, _, _| -x))?;
        check_same_bits(&(a * c).0, &lanes(|x, _, c| x * c))?;
        check_same_bits(&(a + c).0, &lanes(|x, _, c| x + c))?;
        check_same_bits(&accumulated(a, b).0, &lanes(|x, y, _| accumulated(x, y)))?;
        check_same_bits(&Scalar::sin_cos(a).0.0, &lanes(|x, _, _| Scalar::sin_cos(x).0))?;
        check_same_bits(&Scalar::sin_cos(a).1.0, &lanes(|x, _, _| Scalar::sin_cos(x).1))?;
    }

    #[test]
    fn sine_and_cosine_are_those_of_the_standard_library(x in numbers()) {
        for x in x {
            let ((sin, cos), (s, c)) = (Scalar::sin_cos(x), x.sin_cos());
            prop_assert!((sin - s).abs() < 2.3e-16 && (cos - c).abs() < 2.3e-16, "{}", x);
        }
    }

    #[test]
    fn frames_are_where_the_specification_puts_them(case in cases()) {
        let (q, mounting) = (&case.state().q, &case.mounting);
        let [position, ..] = Kernels::new(&case.tree, case.state()).sensed(&case.frame());
        check_close(&position.0, &placed(&case.specs, q, mounting.body, mounting.translation).0)?;
    }

    #[test]
    fn kinetic_energy_is_that_of_every_body_as_specified(case in cases()) {
        let State { dq, .. } = case.state();
        let mut kernels = Kernels::new(&case.tree, &case.state().in_time());
        let mass: Vec<_> = kernels.mass().iter().map(|m| m.value).collect();
        let energies = case.specs.iter().enumerate().map(|(body, spec)| {
            let [centre, _, rate] = kernels.sensed(&case.frame_at(body, &Mat3::IDENTITY, &spec.com));
            let (velocity, rate) = (centre.0.map(|x| x.gradient[0]), Vec3(rate.0.map(|w| w.value)));
            0.5 * (spec.mass * dot(&velocity, &velocity) + rate.dot(&spec.inertia.apply(&rate)))
        });
        check_close(&[0.5 * dot(dq, &multiply(&mass, dq))], &[energies.sum()])?;
    }
}

fn dot<T: Scalar>(a: &[T], b: &[T]) -> T {
    multiply(a, b)[0]
}

fn check_matrices(found: &[Vec<f64>], expected: &[Vec<f64>]) -> Result<(), TestCaseError> {
    found.iter().zip(expected).try_for_each(|(f, e)| check_close(f, e))
}

/// Position, specific force, angular rate: their derivatives by q, q̇ and q̈, each 3 × n.
fn sensor_gradients(case: &Case, frame: &Frame) -> [[Vec<f64>; 3]; 3] {
    let sensed: [Vec3<Dual<DIRECTIONS>>; 3] = Kernels::new(&case.tree, &varied(case.state())).sensed(frame);
    sensed.map(|v| gradients(&v.0, case.tree.len()))
}

fn check_lanes<const L: usize>(case: &Case) -> Result<(), TestCaseError> {
    let (frame, states) = (case.frame(), &case.states[..L]);
    let together = Kernels::new(&case.tree, &packed::<L>(states)).everything(&frame);
    for (lane, state) in states.iter().enumerate() {
        let found: Vec<_> = together.iter().map(|value| value.0[lane]).collect();
        check_same_bits(&found, &Kernels::new(&case.tree, state).everything(&frame))?;
    }
    Ok(())
}

/// ½ q̇ᵀ M q̇ less the work of gravity, from where the centres of mass are.
fn mechanical_energy<T: Scalar>(case: &Case, state: &State<T>) -> T {
    let mut kernels = Kernels::new(&case.tree, state);
    let mut energy = dot(&state.dq, &multiply(&kernels.mass(), &state.dq)) * 0.5;
    for (body, spec) in case.specs.iter().enumerate() {
        let [centre, ..] = kernels.sensed(&case.frame_at(body, &Mat3::IDENTITY, &spec.com));
        energy -= centre.dot(&Vec3::constant(&(case.gravity * spec.mass)));
    }
    energy
}

/// A point of a body in the base frame, carried there joint by joint.
fn placed(specs: &[BodySpec], q: &[f64], body: usize, point: Vec3<f64>) -> Vec3<f64> {
    let spec = &specs[body];
    let moved = match spec.kind {
        JointKind::Revolute => turned(&spec.axis, q[spec.joint], &point),
        JointKind::Prismatic => point + spec.axis * q[spec.joint],
    };
    let carried = spec.translation + spec.rotation.apply(&moved);
    spec.parent.map_or(carried, |parent| placed(specs, q, parent, carried))
}

/// Rodrigues' formula.
fn turned(axis: &Vec3<f64>, angle: f64, v: &Vec3<f64>) -> Vec3<f64> {
    let (sin, cos) = angle.sin_cos();
    *v * cos + axis.cross(v) * sin + *axis * (axis.dot(v) * (1.0 - cos))
}

/// The sensor's axes in the base frame, from the positions of points along them.
fn orientation(case: &Case, kernels: &Kernels<'_, f64>) -> Mat3<f64> {
    let mounting = &case.mounting;
    let at =
        |offset| kernels.sensed(&case.frame_at(mounting.body, &Mat3::IDENTITY, &(mounting.translation + offset)))[0];
    Mat3(mounting.rotation.0.map(|axis| at(axis) - at(Vec3([0.0; 3]))))
}

/// Three massless slides along x, y and z, then a body that turns about any axis off its centre of mass.
fn falling_bodies() -> impl Strategy<Value = (Vec<BodySpec>, State<f64>)> {
    let signal = || prop::collection::vec(-3.0..3.0, 4);
    let state = (signal(), signal()).prop_map(|(q, dq)| State { q, dq, ddq: vec![0.0; 4] });
    let bodies = rigid_body(0).prop_map(|body| {
        let slide = |joint: usize| BodySpec {
            parent: joint.checked_sub(1),
            joint,
            kind: JointKind::Prismatic,
            rotation: Mat3::IDENTITY,
            axis: Mat3::IDENTITY.0[joint],
            mass: 0.0,
            inertia: Mat3::default(),
            ..body.clone()
        };
        let turning = BodySpec { parent: Some(2), joint: 3, kind: JointKind::Revolute, ..body.clone() };
        vec![slide(0), slide(1), slide(2), turning]
    });
    (bodies, state)
}

/// The state with q̈ = M⁻¹(−C q̇ − g): no torque anywhere.
fn free_motion(tree: &Tree, mut state: State<f64>) -> State<f64> {
    let mut kernels = Kernels::new(tree, &state);
    let mass = DMatrix::from_row_slice(tree.len(), tree.len(), &kernels.mass());
    let torque = DVector::from_vec(kernels.torque());
    state.ddq = mass.cholesky().unwrap().solve(&-torque).as_slice().to_vec();
    state
}

/// `a · b + a − b`, by assignment.
fn accumulated<T: Scalar>(a: T, b: T) -> T {
    let mut sum = a * b;
    sum += a;
    sum -= b;
    sum
}

/// Four numbers each, from small to beyond what the fast reduction of angles takes.
fn numbers() -> impl Strategy<Value = [f64; 4]> {
    prop::array::uniform4(prop_oneof![-10.0..10.0, -1e6..1e6, -1e9..1e9])
}

/// A ball of 1 kg on a hinge.
fn ball(parent: Option<usize>, joint: usize) -> BodySpec {
    BodySpec {
        parent,
        joint,
        kind: JointKind::Revolute,
        rotation: Mat3::IDENTITY,
        translation: Vec3([0.0; 3]),
        axis: Vec3([0.0, 0.0, 1.0]),
        mass: 1.0,
        com: Vec3([0.1, 0.0, 0.0]),
        inertia: Mat3::IDENTITY,
    }
}

fn tree_error(specs: &[BodySpec]) -> RobotError {
    Tree::new(Vec3([0.0, 0.0, -9.81]), specs).unwrap_err()
}

fn range(what: &'static str, owner: &str, value: f64, expected: &'static str) -> RobotError {
    RobotError::Range { what, owner: owner.into(), value, expected }
}

#[test]
fn a_tree_needs_a_body() {
    assert_eq!(tree_error(&[]), RobotError::NoBodies);
}

#[test]
fn a_body_comes_after_its_parent() {
    for parent in [1, 2, 7] {
        assert_eq!(tree_error(&[ball(None, 0), ball(Some(parent), 1)]), RobotError::Order { body: 1, parent });
    }
    assert_eq!(tree_error(&[ball(Some(0), 0)]), RobotError::Order { body: 0, parent: 0 });
}

#[test]
fn a_joint_moves_exactly_one_body() {
    let found = |a, b| tree_error(&[ball(None, a), ball(Some(0), b)]);
    assert_eq!(found(0, 0), RobotError::Joint { joint: 0, count: 2 });
    assert_eq!(found(1, 1), RobotError::Joint { joint: 0, count: 0 });
    assert_eq!(found(0, 2), RobotError::Joint { joint: 1, count: 0 });
}

#[test]
fn an_axis_has_length_one() {
    let found = |axis| tree_error(&[ball(None, 0), BodySpec { axis: Vec3(axis), ..ball(Some(0), 1) }]);
    assert_eq!(found([0.0, 3.0, 4.0]), RobotError::Axis { body: 1, length: 5.0 });
    assert_eq!(found([0.0; 3]), RobotError::Axis { body: 1, length: 0.0 });
    assert!(matches!(found([0.0, f64::NAN, 0.0]), RobotError::Axis { body: 1, length } if length.is_nan()));
}

#[test]
fn a_mass_is_not_negative() {
    let found = |mass| tree_error(&[BodySpec { mass, ..ball(None, 0) }]);
    assert_eq!(found(-1.0), range("mass", "body 0", -1.0, "at least 0"));
    assert_eq!(found(f64::NAN).to_string(), "mass of body 0 is NaN, expected at least 0");
}

#[test]
fn a_frame_is_on_a_body() {
    let tree = Tree::new(Vec3([0.0; 3]), &[ball(None, 0)]).unwrap();
    let error = tree.frame("tool", 1, &Mat3::IDENTITY, &Vec3([0.0; 3])).unwrap_err();
    assert_eq!(error, RobotError::Body { owner: "tool".into(), body: 1, count: 1 });
}

/// Two joints, two springs, one accelerometer.
#[derive(Clone)]
struct Parts {
    drives: Vec<Drive>,
    coupling: Vec<f64>,
    noise_std: f64,
}

impl Parts {
    fn new() -> Self {
        let drive = Drive::spring(1e4, 5.0, 1.5);
        Self { drives: vec![drive; 2], coupling: vec![0.0, 0.1, 0.0, 0.0], noise_std: 0.05 }
    }

    fn build(self) -> Result<Robot, RobotError> {
        let tree = Tree::new(Vec3([0.0; 3]), &[ball(None, 0), ball(Some(0), 1)])?;
        let frame = tree.frame("sensor", 1, &Mat3::IDENTITY, &Vec3([0.0; 3]))?;
        let sensor = Sensor { frame, axes: vec![0, 2], noise_std: self.noise_std };
        Robot::new(tree, self.drives, self.coupling, vec![sensor], vec![], None)
    }

    /// The error once `spoil` has had its way.
    fn error(spoil: impl FnOnce(&mut Self)) -> RobotError {
        let mut parts = Self::new();
        spoil(&mut parts);
        parts.build().unwrap_err()
    }
}

#[test]
fn a_robot_counts_its_joints_and_channels() {
    let robot = Parts::new().build().unwrap();
    assert_eq!((robot.len(), robot.acceleration_channels(), robot.gyroscope_channels()), (2, 2, 0));
}

#[test]
fn parts_of_a_robot_fit_together() {
    let length = |what, found, expected| RobotError::Length { what, found, expected };
    assert_eq!(Parts::error(|p| p.drives.truncate(1)), length("drives", 1, 2));
    assert_eq!(Parts::error(|p| p.coupling.truncate(3)), length("coupling", 3, 4));
}

#[test]
fn drives_are_in_range_where_there_is_a_spring() {
    let greater = "greater than 0";
    for bad in [0.0, -1.0] {
        let stiffness = Parts::error(|p| p.drives[1].stiffness = bad);
        assert_eq!(stiffness, range("stiffness", "joint 1", bad, greater));
        let motor_inertia = Parts::error(|p| p.drives[0].motor_inertia = bad);
        assert_eq!(motor_inertia, range("motor inertia", "joint 0", bad, greater));
    }
    assert_eq!(Parts::error(|p| p.drives[1].damping = -1.0), range("damping", "joint 1", -1.0, "at least 0"));
    assert!(Parts::error(|p| p.drives[0].stiffness = f64::NAN).to_string().contains("stiffness of joint 0 is NaN"));
    let infinite = Parts::error(|p| p.drives[1].link_friction[3] = f64::INFINITY);
    assert_eq!(infinite, range("link friction", "joint 1", f64::INFINITY, "a finite number"));
    let mut rigid = Parts::new();
    rigid.drives[0] = Drive { elastic: false, stiffness: 0.0, motor_inertia: 0.0, ..rigid.drives[0].clone() };
    assert!(rigid.build().is_ok());
}

#[test]
fn coupling_is_strictly_upper_triangular() {
    for entry in [0, 2, 3] {
        let error = Parts::error(|p| p.coupling[entry] = 0.1);
        assert!(matches!(error, RobotError::Range { what: "coupling", value: 0.1, .. }), "{error}");
    }
    let error = Parts::error(|p| p.coupling[1] = f64::NAN);
    assert!(error.to_string().contains("coupling of motor 1 to link 0 is NaN"), "{error}");
}

#[test]
fn a_sensor_has_noise() {
    for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let error = Parts::error(|p| p.noise_std = bad);
        assert!(matches!(error, RobotError::Range { what: "noise_std", .. }), "{error}");
    }
}
