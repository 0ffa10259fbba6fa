"""Trajectories: derivatives against each other, continuity as stated, lines of the tool against Pinocchio."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import BarycentricInterpolator
from scipy.special import betainc

import linkside
from linkside import EstimatorError, Robot
from linkside.control.trajectories import Trajectory, polyline, rest_to_rest, spline

from .robots import ARM, spring

SIX = Robot.load(linkside.demo.ROBOT)
HOME = np.array([0.3, -0.9, 1.1, 0.4, 0.8, -0.2])


def check_derivatives(motion, order=4, rows=slice(None)):
    """Each derivative is that of the one before, by differences of sixth order."""
    h = motion.t[1] - motion.t[0]
    weights = np.array([-1, 9, -45, 0, 45, -9, 1]) / (60 * h)
    for k in range(order):
        values = motion.derivatives[k]
        slope = sum(w * values[i : len(values) - 6 + i] for i, w in enumerate(weights))
        exact = motion.derivatives[k + 1][3:-3]
        assert np.abs(slope - exact)[rows].max() < 1e-5 * max(1, np.abs(exact).max()), k


@given(st.sampled_from(range(5, 34, 2)), st.floats(0.3, 5), st.integers(0, 2**32 - 1))
@settings(max_examples=30, deadline=None)
def test_rest_to_rest_is_the_incomplete_beta_function(degree, duration, seed):
    start, end = np.random.default_rng(seed).uniform(-2, 2, (2, 3))
    period = duration / 40
    motion = rest_to_rest([start, end], duration, period, degree=degree)
    m = degree // 2
    share = betainc(m + 1, m + 1, np.linspace(0, 1, 41))[:, None]
    assert np.abs(motion.q - start - share * (end - start)).max() < 1e-12
    ends = (
        motion.derivatives[1 : motion.continuity + 1][:, [0, -1]] * duration ** np.arange(1, m + 1)[:, None, None, None]
    )
    assert np.abs(ends).max() < 1e-6 * np.abs(motion.derivatives[m] * duration**m).max() + 1e-12
    assert np.abs(motion.derivatives[m + 1, 0]).max() > 0
    assert motion.continuity == m


@pytest.mark.parametrize(
    ("degree", "coefficients"),
    [(5, [10, -15, 6]), (7, [35, -84, 70, -20]), (9, [126, -420, 540, -315, 70])],
)
def test_low_degrees_are_the_polynomials_of_the_textbook(degree, coefficients):
    motion = rest_to_rest([[0.0], [1.0]], 1, 0.05, degree=degree)
    polynomial = np.polynomial.Polynomial([0] * (degree // 2 + 1) + coefficients)
    for order in range(degree + 3):
        expected = (polynomial.deriv(order) if order else polynomial)(motion.t)
        assert np.abs(motion.derivatives[order, :, 0] - expected).max() < 1e-12 * max(1, np.abs(expected).max())


def test_derivatives_are_those_of_the_motion():
    check_derivatives(rest_to_rest([[0, 1], [0.5, -1], [0.2, 0]], [0.8, 0.4], 2e-3), rows=slice(None, 380))
    check_derivatives(spline([0, 0.3, 0.9, 1.4], [[0, 1], [0.5, -1], [0.2, 0], [1, 1]], 1e-3))


@pytest.mark.parametrize("continuity", [2, 3, 4])
def test_a_spline_passes_its_points_from_rest_to_rest(continuity):
    times, points = [0, 0.3, 0.9, 1.4], np.random.default_rng(0).uniform(-1, 1, (4, 3))
    motion = spline(times, points, 0.1, continuity=continuity)
    assert np.abs(motion.q[[0, 3, 9, 14]] - points).max() < 1e-12
    assert np.abs(motion.derivatives[1 : continuity + 1][:, [0, -1]]).max() < 1e-6
    assert motion.continuity == continuity


def test_pauses_are_at_rest():
    motion = rest_to_rest([[0.0], [1.0]], 0.5, 0.01)
    held = motion.held(0.1, 0.2)
    assert len(held) == len(motion) + 30
    assert np.allclose(np.diff(held.t), 0.01)
    assert np.array_equal(held.derivatives[:, 10:-20], motion.derivatives)
    assert (held.q[-20:] == 1).all()
    assert not held.derivatives[1:, :10].any()


def tool(robot, q):
    frame = robot.model.frames[robot.model.getFrameId(robot.tool.link, pin.FrameType.BODY)]
    offset = pin.SE3(pin.rpy.rpyToMatrix(*robot.tool.rpy), np.array(robot.tool.xyz))
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, robot.to_pinocchio(q))
    placed = data.oMi[frame.parentJoint] * frame.placement * offset
    return placed.translation.copy(), placed.rotation.copy()


def test_the_tool_goes_straight_and_keeps_its_orientation():
    begin, turned = tool(SIX, HOME)
    corners = begin + np.array([[-0.1, 0.0, 0.1], [-0.1, 0.2, 0.0]])
    motion = polyline(SIX, corners, [0.5, 0.6], 1e-3, start=HOME, orientation=True)
    places, rotations = zip(*(tool(SIX, q) for q in motion.q), strict=True)
    places = np.array(places)
    share = betainc(5, 5, np.linspace(0, 1, 501))[:, None]
    assert np.abs(places[:501] - begin - share * (corners[0] - begin)).max() < 2e-9
    assert np.abs(places[-1] - corners[1]).max() < 2e-9
    assert max(np.linalg.norm(pin.log3(turned.T @ r)) for r in rotations) < 2e-9
    first = Trajectory(motion.t[:501], motion.derivatives[:, :501], 4)
    check_derivatives(first)


def test_an_arm_in_a_plane_and_some_joints_of_many():
    arm = Robot.from_urdf(ARM, [spring("shoulder"), spring("elbow")], tool={"link": "hand"})
    start = np.array([0.3, 0.8])
    begin = arm.tool_position(start)
    motion = polyline(arm, [begin[[0, 2]] + [0.05, -0.1]], 0.5, 0.01, start=start, axes="xz")
    assert np.abs(arm.tool_position(motion.q[-1]) - begin - [0.05, 0, -0.1]).max() < 2e-9
    motion = polyline(SIX, [tool(SIX, HOME)[0] + [0, 0, 0.1]], 0.5, 0.01, start=HOME, joints=("a1", "a2", "a3"))
    assert np.abs(motion.q[:, 3:] - HOME[3:]).max() < 1e-13
    assert np.abs(SIX.tool_position(motion.q[-1]) - tool(SIX, HOME)[0] - [0, 0, 0.1]).max() < 2e-9


def test_time_between_corners_is_that_of_interpolated_joints():
    """Derivatives of composed series against an interpolant of the same positions."""
    motion = polyline(SIX, [tool(SIX, HOME)[0] + [0, 0.1, 0]], 0.4, 0.01, start=HOME, joints=("a1", "a2", "a3"))
    t = 0.2 - 0.2 * np.cos(np.pi * np.arange(41) / 40)
    nodes = np.unique(np.round(t / 0.01).astype(int))
    curve = BarycentricInterpolator(motion.t[nodes], motion.q[nodes])
    middle = slice(15, 26)
    assert np.abs(curve.derivative(motion.t[middle]) - motion.dq[middle]).max() < 1e-5


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: rest_to_rest([[0.0]], 1, 0.1), "expected 2 rows or more"),
        (lambda: rest_to_rest([[0.0], [np.nan]], 1, 0.1), "finite numbers"),
        (lambda: rest_to_rest([[0.0], [1.0]], [1, 2], 0.1), "2 given, for 1 movements"),
        (lambda: rest_to_rest([[0.0], [1.0]], 0.95, 0.1), "multiple of the period"),
        (lambda: rest_to_rest([[0.0], [1.0]], -1, 0.1), "multiple of the period"),
        (lambda: rest_to_rest([[0.0], [1.0]], 1, 0), "expected a positive number of seconds"),
        (lambda: rest_to_rest([[0.0], [1.0]], 1, 0.1, degree=6), "odd number from 3 to 33"),
        (lambda: spline([0, 1, 1], [[0], [1], [2]], 0.1), "3 rising times from 0"),
        (lambda: spline([0, 1], [[0], [1]], 0.1, continuity=0), "expected 1 to 7"),
        (lambda: Trajectory(np.arange(3), np.zeros((3, 4, 1)), 2), r"got \(3,\) and \(3, 4, 1\)"),
        (lambda: polyline(SIX, [[0, 0, 1]], 1, 0.1, start=HOME), "6 joints move and 3 coordinates"),
        (lambda: polyline(SIX, [[0, 0]], 1, 0.1, start=HOME, joints=("a1", "a2", "a3")), "expected 3 coordinates"),
        (lambda: polyline(SIX, [[9, 0, 0]], 1, 0.1, start=HOME, joints=("a1", "a2", "a3")), "line 0: the tool cannot"),
        (lambda: polyline(SIX, [[0, 0, 1]], 1, 0.1, start=HOME[:2], joints=("a1", "a2", "a3")), r"shape \(6,\)"),
        (lambda: polyline(SIX, [[0, 0, 1]], 1, 0.1, start=HOME, joints=("a1", "b", "c")), "no joint 'b'"),
        (lambda: polyline(SIX, [[0, 0, 1]], 1, 0.1, start=HOME, axes="xw"), "expected some of 'xyz'"),
    ],
)
def test_what_cannot_be_planned_is_refused(call, words):
    with pytest.raises(EstimatorError, match=words):
        call()


def test_a_robot_without_tool_has_no_lines():
    arm = Robot.from_urdf(ARM, [spring("shoulder"), spring("elbow")])
    with pytest.raises(EstimatorError, match="no tool"):
        polyline(arm, [[0, 0]], 1, 0.1, start=[0, 0], axes="xz")
