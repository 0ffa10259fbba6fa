"""Friction by load and direction, on both sides of a gear: its laws, motion by it, estimates that know of it."""

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
    RauchTungStriebelSmoother,
    Robot,
    simulate,
)
from linkside.control import inverse_dynamics
from linkside.control.trajectories import rest_to_rest

from .robots import ARM, spring
from .test_elastic_filter import SLIDE

TIP = {"name": "tip", "link": "hand", "xyz": [0.1, 0, 0.3], "noise_std": 0.02}
CREEP, ROUNDING = 2e-3, 0.1  # rad/s and N m: 1e-5 rad of a spring of 1e4 N m/rad
MOTOR = {"viscous": 8.0, "coulomb": 6.0, "asymmetry": 2.0, "stribeck": 3.0, "stribeck_velocity": 0.05, "load": 0.05}
BEARING = {"viscous": 2.0, "coulomb": 1.5, "asymmetry": -0.5, "stribeck": 1.0, "stribeck_velocity": 0.03, "load": 0.04}
GEAR = {"driving": 0.85, "back_driving": 0.75}
ALL = {"motor_friction": MOTOR, "bearing_friction": BEARING, "efficiency": GEAR}


def arm(**drive):
    drives = [spring(name, **drive) for name in ("shoulder", "elbow")]
    return Robot.from_urdf(
        ARM, drives, accelerometers=[TIP], encoder={"resolution": 1e-6}, tool={"link": "hand", "xyz": [0, 0, 0.2]}
    )


def sign(v):
    return v / np.sqrt(v**2 + CREEP**2)


def size(torque):
    return np.sqrt(torque**2 + ROUNDING**2)


def at_speed(law, v):
    """Friction without load, as printed."""
    level = law["coulomb"] + law["stribeck"] * np.exp(-((v / law["stribeck_velocity"]) ** 2))
    return law["viscous"] * v + level * sign(v) + law["asymmetry"] * sign(v) ** 2


def of_gear(v, torque):
    """What the gear and the motor's bearings take of the torque that the spring asks for."""
    driving, driven = MOTOR["load"] + 1 / GEAR["driving"] - 1, MOTOR["load"] + 1 - GEAR["back_driving"]
    forwards = 0.5 * (1 + sign(v) * torque / size(torque))
    return (forwards * driving + (1 - forwards) * driven) * size(torque) * sign(v)


def test_a_gear_takes_its_share_of_what_passes():
    """Up: the motor gives load over efficiency; down: the load times the efficiency is left for it."""
    robot = arm(efficiency=GEAR)
    load = np.array([[40.0, -40.0]] * 2)
    turning = np.array([[1.0, -1.0], [-1.0, 1.0]])
    felt = load + robot.motor_friction(turning, load)
    assert_allclose(np.abs(felt), [[40 / 0.85] * 2, [40 * 0.75] * 2], rtol=2e-5)


def test_friction_differs_by_direction():
    robot = arm(motor_friction={"coulomb": 6.0, "asymmetry": 2.0})
    assert_allclose(robot.motor_friction([[0.5, -0.5]]), [[8, -4]], rtol=1e-4)
    assert_allclose(robot.motor_friction([[0.0, 0.0]]), 0)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.floats(-2, 2), min_size=8, max_size=8))
def test_both_sides_feel_what_is_printed(state):
    """What springs and friction leave moves links, by `inverse_dynamics`, which Pinocchio is held to elsewhere."""
    robot = arm(**ALL)
    q, dq, twist, dtheta = np.array(state).reshape(4, 1, 2)
    theta = q + 1e-2 * twist
    load = 1e4 * (theta - q) + 5.0 * (dtheta - dq)
    ddq, ddtheta = robot.forward_dynamics(q, dq, theta, dtheta, np.full((1, 2), 9.0))
    motor = at_speed(MOTOR, dtheta) + of_gear(dtheta, load)
    assert_allclose(1.5 * ddtheta, 9.0 - load - motor, rtol=1e-9, atol=1e-9)
    link = load - at_speed(BEARING, dq) - BEARING["load"] * size(load) * sign(dq)
    assert_allclose(robot.inverse_dynamics(q, dq, ddq), link, rtol=1e-8, atol=1e-8)
    # And back: from the motion the torque that the spring holds, and the motor's.
    moved = robot.inverse_dynamics(q, dq, ddq)
    assert_allclose(moved + robot.link_friction(dq, moved), load, rtol=1e-8, atol=1e-8)
    assert_allclose(robot.motor_friction(dtheta, load), motor, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("integrator", ["fixed", "adaptive"])
def test_a_cart_moves_as_scipy_says(integrator):
    """A cart of 30 kg and its motor, pushed to and fro: driving, driven, reversing."""
    robot = Robot.from_urdf(SLIDE, [spring("x", **ALL)], gravity=[0, 0, 0])

    def push(t):
        return 90.0 * np.sin(9.0 * t)

    def rate(t, x):
        q, dq, theta, dtheta = x
        load = 1e4 * (theta - q) + 5.0 * (dtheta - dq)
        link = load - at_speed(BEARING, dq) - BEARING["load"] * size(load) * sign(dq)
        motor = push(np.floor(t * 1000 + 1e-6) / 1000) - load - at_speed(MOTOR, dtheta) - of_gear(dtheta, load)
        return [dq, link / 30.0, dtheta, motor / 1.5]

    steps = {"substeps": 40} if integrator == "fixed" else {"integrator": "adaptive", "rtol": 1e-9, "atol": 1e-11}
    motion = simulate(robot, lambda t, state: np.array([push(t)]), 0.6, 1000.0, q=[0], theta=[0], **steps).truth
    x, reference = [0.0] * 4, []
    for t in motion["t"]:
        reference.append(x)
        x = solve_ivp(rate, (t, t + 1e-3 - 1e-9), x, "LSODA", rtol=1e-10, atol=1e-12).y[:, -1]
    ours = np.column_stack([motion[k][:, 0] for k in ("q", "dq", "theta", "dtheta")])
    reference = np.array(reference)
    assert np.ptp(reference[:, 1]) > 0.3
    assert (np.diff(np.sign(reference[20:, 1])) != 0).any()
    assert np.abs(ours - reference)[:, [0, 2]].max() < 2e-5 * np.ptp(reference[:, 0]) + 1e-6


def test_friction_takes_what_energy_is_missing():
    """A free arm loses exactly what its frictions take."""
    robot = arm(damping=0.0, **ALL)
    start = {"q": [0.3, -0.4], "dq": [1.0, -2.0], "tau": [0, 0], "integrator": "adaptive", "rtol": 1e-9, "atol": 1e-11}
    truth = simulate(robot, lambda t, state: np.zeros(2), 0.3, 20000.0, **start).truth
    q, dq, theta, dtheta = (truth[k] for k in ("q", "dq", "theta", "dtheta"))
    load = 1e4 * (theta - q)
    lost = (at_speed(MOTOR, dtheta) + of_gear(dtheta, load)) * dtheta
    lost += (at_speed(BEARING, dq) + BEARING["load"] * size(load) * sign(dq)) * dq
    height = 9.81 * (3 * 0.2 * np.cos(q[:, 0]) + 2 * (0.5 * np.cos(q[:, 0]) + 0.2 * np.cos(q.sum(1))))
    kinetic = 0.5 * np.einsum("ti,tij,tj->t", dq, robot.mass_matrix(q), dq) + 0.75 * (dtheta**2).sum(1)
    total = kinetic + 0.5e4 * ((theta - q) ** 2).sum(1) + height
    assert (lost >= 0).all()
    work = np.concatenate([[0], np.cumsum(0.5 * (lost[1:] + lost[:-1]).sum(1)) / 20000.0])
    assert work[-1] > 0.5
    assert_allclose(total[0] - total, work, atol=2e-4 * work[-1])


@pytest.mark.parametrize("damping", [0.0, 5.0])
def test_inverse_dynamics_overcomes_friction(damping):
    robot = arm(**{**ALL, "damping": damping})
    desired = inverse_dynamics(robot, rest_to_rest([[0.2, 0.1], [0.7, 0.5]], 0.4, 1e-4, degree=13))
    load = robot.inverse_dynamics(desired.q, desired.dq, desired.ddq)
    load = load + robot.link_friction(desired.dq, load)
    slip = desired.dtheta - desired.dq
    assert_allclose(1e4 * (desired.theta - desired.q) + damping * slip, load, atol=1e-5 * np.abs(load).max())
    ddtheta = np.gradient(desired.dtheta, 1e-4, axis=0)
    motor = at_speed(MOTOR, desired.dtheta) + of_gear(desired.dtheta, load)
    apart = np.abs(desired.tau - (1.5 * ddtheta + load + motor)) / np.abs(desired.tau).max()
    # Where the load changes its sign, and at standstill, friction turns within samples, and differences are coarse.
    assert np.quantile(apart, 0.97) < 1e-4


METHODS = {
    "EKF": lambda robot: ExtendedKalmanFilter(robot),
    "smoother": lambda robot: RauchTungStriebelSmoother(robot),
    "elastic filter": lambda robot: ElasticJointFilter(robot),
    "elastic smoother": lambda robot: ElasticJointSmoother(robot),
}


@pytest.fixture(scope="module")
def motion():
    """A motion to and fro by PD control on the motors, recorded with encoders and noise."""
    robot = arm(**ALL)

    def servo(t, state):
        goal = np.array([0.6, -0.4]) * np.sin(np.array([3.0, 3.7]) * t) ** 2
        return 3e3 * (goal - state.theta) - 150.0 * state.dtheta

    return simulate(robot, servo, 1.5, 1000.0, q=[0.0, 0.0], substeps=10, seed=1)


def test_estimates_know_the_friction_that_robot_yaml_declares(motion):
    truth = motion.truth["q"]
    for name, method in METHODS.items():
        errors = {}
        for told in (arm(**ALL), arm(motor_friction={**MOTOR, "load": 0, "asymmetry": 0})):
            estimate = method(told).run(motion.log)
            errors[told] = np.abs(estimate.q - truth)[200:]
        right, wrong = errors.values()
        assert np.median(right) < 1.5e-6, name
        # The rest is where links break away at a reversal, between two samples.
        assert np.sqrt(np.mean(wrong**2)) > 10 * np.sqrt(np.mean(right**2)), name


def test_estimates_are_as_uncertain_as_they_say(motion):
    for name, method in METHODS.items():
        estimate = method(arm(**ALL)).run(motion.log)
        assert (np.abs(estimate.q - motion.truth["q"]) < 3 * estimate.q_std).mean() > 0.98, name


@pytest.mark.parametrize(
    ("drive", "expected"),
    [
        ({"motor_friction": {"coulomb": 2, "asymmetry": 3}}, "at most the coulomb friction of 2, got 3"),
        ({"bearing_friction": {"load": 1}}, "load"),
        ({"efficiency": {"driving": 0}}, "driving"),
        ({"efficiency": {"back_driving": 1.1}}, "back_driving"),
        ({"motor_friction": {"load": 0.5}, "efficiency": {"back_driving": 0.4}}, "more than the load friction of 0.5"),
        ({"elastic": False, "efficiency": GEAR}, "efficiency: expected none: the joint is rigid"),
        ({"elastic": False, "bearing_friction": {"load": 0.1}}, "load: expected none: the joint is rigid"),
    ],
)
def test_frictions_that_cannot_be_are_refused_with_their_key(drive, expected):
    with pytest.raises(ConfigError, match=expected):
        arm(**drive)


def test_observers_refuse_what_grows_with_load():
    with pytest.raises(EstimatorError, match="'shoulder', 'elbow' efficiency, which the acceleration-driven observer"):
        AccelerationObserver(arm(efficiency=GEAR))
