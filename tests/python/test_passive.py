"""Joints without motor: bearings, links and bases that bend, in simulator, filters and smoothers."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

from linkside import (
    AccelerationObserver,
    ConfigError,
    ElasticJointFilter,
    ElasticJointSmoother,
    EstimatorError,
    ExtendedKalmanFilter,
    Log,
    MotorJerkFilter,
    MotorJerkSmoother,
    ParticleFilter,
    RauchTungStriebelSmoother,
    Robot,
    simulate,
)

from .robots import ARM, spring
from .transmissions import Gear, move, tool_error

# The arm with a link that bends: 40 cm behind the elbow the fore arm goes on about an axis across.
BENDING = ARM.replace(
    '<joint name="wrist" type="fixed"><parent link="fore"/><child link="hand"/><origin xyz="0 0 0.4"/></joint>',
    """<link name="end"><inertial><origin xyz="0 0 0.1"/><mass value="1"/>
    <inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.01"/></inertial></link>
  <joint name="bend" type="revolute"><parent link="fore"/><child link="end"/><origin xyz="0 0 0.3"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
  <joint name="wrist" type="fixed"><parent link="end"/><child link="hand"/><origin xyz="0 0 0.1"/></joint>""",
)
BEND = {"name": "bend", "passive": True, "stiffness": 4e3, "damping": 2.0}
SENSORS = [
    {"name": "mid", "link": "fore", "xyz": [0.05, 0, 0.2], "noise_std": 0.02},
    {"name": "tip", "link": "hand", "xyz": [0.1, 0, 0.1], "noise_std": 0.02},
]
GEARS = [Gear(1e4, 5.0, 1.5), Gear(1e4, 5.0, 1.5), Gear(4e3, 2.0, np.inf)]


def bending(**bend):
    drives = [spring("shoulder"), spring("elbow"), {**BEND, **bend}]
    tool = {"link": "hand", "xyz": [0, 0, 0.2]}
    return Robot.from_urdf(BENDING, drives, accelerometers=SENSORS, encoder={"resolution": 1e-6}, tool=tool)


def stiff():
    """The same robot as one believes it to be that does not bend."""
    drives = [spring("shoulder"), spring("elbow")]
    tool = {"link": "hand", "xyz": [0, 0, 0.2]}
    return Robot.from_urdf(BENDING, drives, accelerometers=SENSORS, encoder={"resolution": 1e-6}, tool=tool)


def reference(t):
    phase = np.array([3.0, 3.7]) * t
    goal, speed = np.array([0.6, -0.4]) * np.sin(phase) ** 2, np.array([0.6, -0.4]) * np.sin(2 * phase) * [3.0, 3.7]
    return np.append(goal, 0.0), np.append(speed, 0.0)


@pytest.fixture(scope="module")
def motion():
    """Of a simulator that shares no code with ours, in which the third motor is too heavy to move."""
    return move(bending(), GEARS, reference, 1.2)


def recorded(motion, robot):
    """What a controller has: no columns of a motor that is not there."""
    log = motion.log(bending(), 1e-6, 0.02)
    columns = {"t": log.t}
    for j, name in enumerate(("shoulder", "elbow")):
        columns |= {f"theta_{name}": log.theta[:, j], f"tau_{name}": log.tau[:, j]}
    columns |= {name: log.acceleration[:, k] for k, name in enumerate(log.columns("acceleration"))}
    return Log.from_table(columns, robot)


METHODS = {
    "EKF": lambda robot: ExtendedKalmanFilter(robot),
    "smoother": lambda robot: RauchTungStriebelSmoother(robot),
    "elastic filter": lambda robot: ElasticJointFilter(robot),
    "elastic smoother": lambda robot: ElasticJointSmoother(robot),
    "motor filter": lambda robot: MotorJerkFilter(robot),
    "motor smoother": lambda robot: MotorJerkSmoother(robot),
    "particles": lambda robot: ParticleFilter(robot, particles=200),
}


def test_a_log_has_no_columns_of_a_motor_that_is_not_there(motion):
    log = recorded(motion, bending())
    assert_allclose(log.theta[:, 2], 0)
    assert_allclose(log.tau[:, 2], 0)
    assert np.abs(log.theta[:, :2]).max() > 0.1


def test_estimates_know_the_link_that_bends(motion):
    robot, rigid = bending(), stiff()
    clean = move(rigid, GEARS[:2], lambda t: tuple(part[:2] for part in reference(t)), 1.2)
    for name, method in METHODS.items():
        estimate = method(robot).run(recorded(motion, robot))
        right = tool_error(estimate, motion, 200)
        assert right < 2 * tool_error(method(rigid).run(clean.log(rigid, 1e-6, 0.02)), clean, 200), name
        if name in ("EKF", "elastic filter", "motor filter"):
            assert tool_error(method(rigid).run(recorded(motion, rigid)), motion, 200) > 20 * right, name
        assert (np.abs(estimate.q - motion.q) < 3 * estimate.q_std).mean() > 0.98, name
        assert (estimate.status == 0).mean() > 0.98, name


def test_a_base_may_rock_beside():
    """Two of them, one about an axis askew."""
    rocking = BENDING.replace(
        '<link name="base"/>',
        """<link name="floor"/><link name="base"><inertial><mass value="20"/>
    <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
  <joint name="rock" type="revolute"><parent link="floor"/><child link="base"/><origin xyz="0 0 -0.3"/>
    <axis xyz="0.6 0.8 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>""",
    )
    rock = {"name": "rock", "passive": True, "stiffness": 3e4, "damping": 40.0}
    foot = {"name": "foot", "link": "base", "xyz": [0.1, 0.1, 0.1], "noise_std": 0.02}
    robot = Robot.from_urdf(
        rocking,
        [rock, spring("shoulder"), spring("elbow"), BEND],
        accelerometers=[*SENSORS, foot],
        encoder={"resolution": 1e-6},
        tool={"link": "hand", "xyz": [0, 0, 0.2]},
    )
    gears = [Gear(3e4, 40.0, np.inf), *GEARS]
    motion = move(robot, gears, lambda t: tuple(np.append(0.0, part) for part in reference(t)), 0.8)
    assert np.ptp(motion.q[:, 0]) > 1e-3
    for name in ("EKF", "elastic smoother", "motor smoother"):
        estimate = METHODS[name](robot).run(motion.log(robot, 1e-6, 0.02))
        assert tool_error(estimate, motion, 200) < 4e-3, name
        assert (np.abs(estimate.q - motion.q) < 3 * estimate.q_std).mean() > 0.98, name


def test_an_arm_that_bends_moves_as_the_other_simulator_says(motion):
    robot = bending()

    def servo(t, state):
        goal, speed = reference(t)
        return hold + 3e3 * (goal - state.theta) + 150.0 * (speed - state.dtheta)

    start = {"q": motion.q[0], "theta": motion.theta[0]}
    hold = robot.gravity_torque(motion.q[0])
    ours = simulate(robot, servo, 0.3, 20000.0, **start, keep_every=20).truth
    assert_allclose(ours["q"][:300], motion.q[:300], atol=2e-5)
    assert np.ptp(motion.q[:300, 2]) > 2e-4


def test_a_link_without_motor_hangs_and_swings_as_a_pendulum_on_a_spring():
    """A base that rocks under a post: ẍ = (m g l sin x − K x − D ẋ)/J."""
    robot = Robot.from_urdf(
        ARM, [{"name": "shoulder", "passive": True, "stiffness": 80.0, "damping": 0.5}, spring("elbow")]
    )
    start = simulate(robot, lambda t, state: np.zeros(2), 0.001, 1000.0, q=[0, 0.3]).truth
    load = robot.gravity_torque(start["q"][0])
    rest = simulate(robot, lambda t, state: load, 0.1, 1000.0, q=[0, 0.3]).truth
    assert_allclose(-80.0 * rest["q"][0, 0], load[0], rtol=1e-12)
    assert_allclose(rest["dq"], 0, atol=1e-9)
    locked = Robot.from_urdf(
        ARM.replace('name="elbow" type="revolute"', 'name="elbow" type="fixed"'),
        [{"name": "shoulder", "elastic": False}],
    )
    inertia = locked.mass_matrix([0.0])[0, 0]
    drives = [
        {"name": "shoulder", "passive": True, "stiffness": 80.0, "damping": 0.5},
        {"name": "elbow", "elastic": False, "motor_inertia": 1e9},
    ]
    robot = Robot.from_urdf(ARM, drives)
    ours = simulate(robot, lambda t, state: np.zeros(2), 1.0, 2000.0, q=[0.2, 0.0], theta=[0, 0], tau=[0, 0]).truth

    def rate(t, x):
        return [x[1], (9.81 * (0.6 + 1.4) * np.sin(x[0]) - 80.0 * x[0] - 0.5 * x[1]) / inertia]

    expected = solve_ivp(rate, (0, 1), [0.2, 0], "DOP853", ours["t"], rtol=1e-11, atol=1e-13).y[0]
    assert np.ptp(expected) > 0.2
    assert_allclose(ours["q"][:, 0], expected, atol=1e-6)


@pytest.mark.parametrize(
    ("joint", "expected"),
    [
        ({"motor_inertia": 1.0}, "motor_inertia: expected none: the joint is passive"),
        ({"elastic": False}, "passive"),
        ({"stiffness": None}, "missing key 'stiffness'"),
        ({"efficiency": {"driving": 0.8}}, "efficiency: expected none: the joint is passive"),
        ({"gear_ratio": 3.0}, "gear_ratio: expected none"),
    ],
)
def test_passive_joints_that_cannot_be_are_refused_with_their_key(joint, expected):
    with pytest.raises(ConfigError, match=expected):
        bending(**joint)


def test_a_robot_needs_a_motor():
    with pytest.raises(ConfigError, match="all are passive"):
        Robot.from_urdf(BENDING, [BEND])


def test_observers_say_why_they_cannot():
    with pytest.raises(EstimatorError, match=r"'bend' passive, which the acc.* observer .*: no motor moves it"):
        AccelerationObserver(bending())
