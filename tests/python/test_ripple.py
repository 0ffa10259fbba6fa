"""Gears with a kinematic error: its law, motion by it, and estimates that know of it."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

from linkside import (
    AccelerationObserver,
    ConfigError,
    ElasticJointFilter,
    ElasticJointSmoother,
    EstimatorError,
    ExtendedKalmanFilter,
    ParticleFilter,
    RauchTungStriebelSmoother,
    Robot,
    simulate,
)
from linkside.control import inverse_dynamics
from linkside.control.trajectories import rest_to_rest

from .robots import ARM, spring
from .test_elastic_filter import SLIDE
from .transmissions import Gear, move, tool_error

WAVES = [{"order": 2, "amplitude": 4e-5, "phase": 0.3}, {"order": 3, "amplitude": 2e-4, "phase": -1.0, "of": "output"}]
TIP = {"name": "tip", "link": "hand", "xyz": [0.1, 0, 0.3], "noise_std": 0.02}


def arm(**drive):
    drives = [spring(name, gear_ratio=-100.0, **drive) for name in ("shoulder", "elbow")]
    return Robot.from_urdf(
        ARM, drives, accelerometers=[TIP], encoder={"resolution": 1e-6}, tool={"link": "hand", "xyz": [0, 0, 0.2]}
    )


def gears(robot):
    return [Gear(d.stiffness, d.damping, d.motor_inertia, [tuple(h) for h in d.harmonics]) for d in robot.drives]


def test_harmonics_count_turns_of_the_motor_or_of_the_output():
    assert_allclose(arm(ripple=WAVES).drives[0].harmonics, [[4e-5, -200.0, 0.3], [2e-4, 3.0, -1.0]])


@settings(max_examples=50, deadline=None)
@given(
    st.lists(st.tuples(st.floats(-9e-4, 9e-4), st.integers(1, 100), st.floats(-4, 4)), min_size=1, max_size=2),
    st.lists(st.floats(-2, 2), min_size=8, max_size=8),
)
def test_link_and_motor_feel_the_spring_with_equal_power(waves, state):
    """δ̇ τ_e is what spring and damper take: the motor gives (1 + ε′) θ̇ τ_e, the link gets q̇ τ_e."""
    robot = arm(ripple=[{"order": n, "amplitude": a, "phase": p, "of": "output"} for a, n, p in waves])
    q, dq, twist, dtheta = np.array(state).reshape(4, 1, 2)
    theta = q + 1e-2 * twist
    angle, ratio, _ = Gear(0, 0, 0, waves).output(theta)
    load = 1e4 * (angle - q) + 5.0 * (ratio * dtheta - dq)
    ddq, ddtheta = robot.forward_dynamics(q, dq, theta, dtheta, np.zeros((1, 2)))
    assert_allclose(-1.5 * ddtheta, ratio * load, rtol=1e-10, atol=1e-9)
    assert_allclose(robot.inverse_dynamics(q, dq, ddq), load, rtol=1e-9, atol=1e-12 + 1e-9 * np.abs(load).max())


@pytest.mark.parametrize("integrator", ["fixed", "adaptive"])
def test_a_cart_moves_as_scipy_says(integrator):
    """A cart of 30 kg and its motor, pushed through many cycles of a large error."""
    wave = {"order": 40, "amplitude": 2e-3, "phase": 0.7, "of": "output"}
    robot = Robot.from_urdf(SLIDE, [spring("x", ripple=[wave])], gravity=[0, 0, 0])
    gear, push, start = Gear(1e4, 5.0, 1.5, [(2e-3, 40.0, 0.7)]), 60.0, -2e-3 * np.sin(0.7)

    def rate(t, x):
        q, dq, theta, dtheta = x
        angle, ratio, _ = gear.output(theta)
        load = gear.stiffness * (angle - q) + gear.damping * (ratio * dtheta - dq)
        return [dq, load / 30.0, dtheta, (push - ratio * load) / gear.inertia]

    steps = {"substeps": 20} if integrator == "fixed" else {"integrator": "adaptive", "rtol": 1e-10, "atol": 1e-12}
    motion = simulate(robot, lambda t, state: np.array([push]), 0.6, 1000.0, q=[-start], theta=[0.0], **steps).truth
    reference = solve_ivp(rate, (0, 0.6), [-start, 0, 0, 0], "DOP853", motion["t"], rtol=1e-11, atol=1e-13).y.T
    ours = np.column_stack([motion[k][:, 0] for k in ("q", "dq", "theta", "dtheta")])
    assert ours[-1, 2] > 0.3  # two cycles
    assert_allclose(ours, reference, atol=1e-7)


def test_a_free_arm_keeps_its_energy():
    """A motor that felt the torque without 1 + ε′ would make energy out of nothing."""
    robot = arm(ripple=[{"order": 5, "amplitude": 0.02, "of": "output"}], damping=0.0)
    start = {"q": [0.3, -0.4], "dq": [1.0, -2.0], "tau": [0, 0], "substeps": 20}
    truth = simulate(robot, lambda t, state: np.zeros(2), 0.5, 2000.0, **start).truth
    total = []
    for q, dq, theta, dtheta in zip(*(truth[k][::40] for k in ("q", "dq", "theta", "dtheta")), strict=True):
        torsion = theta + 0.02 * np.sin(5 * theta) - q
        height = 9.81 * (3 * 0.2 * np.cos(q[0]) + 2 * (0.5 * np.cos(q[0]) + 0.2 * np.cos(q.sum())))
        kinetic = 0.5 * dq @ robot.mass_matrix(q) @ dq + 0.75 * dtheta @ dtheta
        total.append(kinetic + 0.5e4 * torsion @ torsion + height)
    assert np.ptp(total) < 1e-6 * np.ptp(0.75 * truth["dtheta"] ** 2)


@pytest.mark.parametrize("damping", [0.0, 5.0])
def test_inverse_dynamics_turns_the_motor_behind_its_gear(damping):
    robot = arm(ripple=[{"order": 30, "amplitude": 1e-3, "phase": 1.0, "of": "output"}], damping=damping)
    step = 1e-4
    desired = inverse_dynamics(robot, rest_to_rest([[0.2, 0.1], [0.7, 0.5]], 0.4, step, degree=13))
    load = robot.inverse_dynamics(desired.q, desired.dq, desired.ddq)
    angle, ratio, _ = Gear(0, 0, 0, [(1e-3, 30.0, 1.0)]).output(desired.theta)
    slip = ratio * desired.dtheta - desired.dq
    assert_allclose(1e4 * (angle - desired.q) + damping * slip, load, atol=1e-6 * np.abs(load).max())
    ddtheta = np.gradient(desired.dtheta, step, axis=0)[2:-2]
    assert_allclose(desired.tau[2:-2], 1.5 * ddtheta + (ratio * load)[2:-2], atol=1e-4 * np.abs(desired.tau).max())


KALMAN = {
    "EKF": lambda robot: ExtendedKalmanFilter(robot),
    "smoother": lambda robot: RauchTungStriebelSmoother(robot),
    "elastic filter": lambda robot: ElasticJointFilter(robot),
    "elastic smoother": lambda robot: ElasticJointSmoother(robot),
}
METHODS = KALMAN | {"particles": lambda robot: ParticleFilter(robot, particles=200)}


def reference(t):
    phase = np.array([3.0, 3.7]) * t
    return [0.6, -0.4] * np.sin(phase) ** 2, [0.6, -0.4] * np.sin(2 * phase) * [3.0, 3.7]


@pytest.fixture(scope="module")
def recordings():
    """Of a simulator that shares no code with ours, without and with an error of two cycles a motor turn."""
    plain, rippled = arm(), arm(ripple=WAVES[:1])
    return {robot: move(robot, gears(robot), reference, 1.2) for robot in (plain, rippled)}


def test_estimates_know_the_error_that_robot_yaml_declares(recordings):
    (plain, clean), (rippled, motion) = recordings.items()

    def errors(told, motion, methods):
        log = motion.log(told, 1e-6, 0.02)
        return {name: tool_error(method(told).run(log), motion, 200) for name, method in methods.items()}

    right, wrong = errors(rippled, motion, METHODS), errors(plain, motion, KALMAN)
    exact = errors(plain, clean, METHODS)
    for method in METHODS:
        assert right[method] < 2 * exact[method], method
    for method in KALMAN:
        assert wrong[method] > 5 * right[method], method


def test_estimates_are_as_uncertain_as_they_say(recordings):
    rippled, motion = list(recordings.items())[1]
    for method in KALMAN.values():
        estimate = method(rippled).run(motion.log(rippled, 1e-6, 0.02))
        assert (np.abs(estimate.q - motion.q) < 3 * estimate.q_std).mean() > 0.99
        assert (estimate.status == 0).mean() > 0.99


def test_a_rested_robot_stands_where_its_gear_is():
    robot = arm(ripple=[{"order": 7, "amplitude": 0.01, "of": "output"}])
    motion = simulate(robot, lambda t, state: np.zeros(2), 0.001, 1000.0, q=[0.4, 0.3])
    theta = motion.truth["theta"][0]
    load = robot.gravity_torque(np.array([0.4, 0.3]))
    assert_allclose(theta + 0.01 * np.sin(7 * theta) - [0.4, 0.3], load / 1e4, atol=1e-14)


@pytest.mark.parametrize(
    ("drive", "expected"),
    [
        ({"ripple": [{"order": 0, "amplitude": 1e-5}]}, "order"),
        ({"ripple": [{"amplitude": 1e-5}]}, "missing key 'order'"),
        ({"ripple": [{"order": 2, "amplitude": 1e-5, "of": "link"}]}, "of"),
        ({"ripple": [{"order": 3, "amplitude": 1e-3}]}, "at most 0.2 of it, got 0.3"),
        ({"ripple": WAVES, "elastic": False}, "the joint is rigid"),
    ],
)
def test_errors_that_are_none_are_refused_with_their_key(drive, expected):
    with pytest.raises(ConfigError, match=expected):
        arm(**drive)


def test_turns_of_a_motor_need_its_gear_ratio():
    with pytest.raises(ConfigError, match="missing key 'gear_ratio'"):
        Robot.from_urdf(ARM, [spring("shoulder", ripple=WAVES), spring("elbow")])


def test_observers_refuse_ripple():
    with pytest.raises(EstimatorError, match="'shoulder', 'elbow' ripple, which the acceleration-driven observer"):
        AccelerationObserver(arm(ripple=WAVES))
