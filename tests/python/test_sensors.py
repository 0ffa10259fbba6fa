"""The acceleration map: what accelerometers read, and which link accelerations that tells."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq

from linkside.errors import EstimatorError
from linkside.observability.sensors import AccelerationMap, acceleration_map
from linkside.robot import Robot

from .robots import ARM, DATA, robots, spring, states

SEEDS = st.integers(0, 2**32 - 1)
CLOSE: dict[str, Any] = {"rtol": 1e-10, "atol": 1e-10}
ARM_JOINTS = [spring("shoulder"), spring("elbow")]
HALF = np.pi / 2
UP = np.array([0, 0, 9.81])


@pytest.fixture(scope="module")
def kr15() -> Robot:
    return Robot.load(DATA / "kr15_long" / "robot.yaml")


def kr15_with(link: str, xyz: Any) -> Robot:
    """The arm of KR15 size, joints 1 to 3 elastic, with one accelerometer elsewhere."""
    joints = [spring(name) for name in ("a1", "a2", "a3")]
    sensor = {"name": "acc", "link": link, "xyz": xyz}
    return Robot.from_urdf(DATA / "kr15_long" / "robot.urdf", joints, accelerometers=[sensor])


@pytest.mark.parametrize(
    ("rpy", "reading"),
    [
        ((0, 0, 0), (0, 0, 9.81)),
        ((np.pi, 0, 0), (0, 0, -9.81)),
        ((HALF, 0, 0), (0, 9.81, 0)),
        ((-HALF, 0, 0), (0, -9.81, 0)),
        ((0, HALF, 0), (-9.81, 0, 0)),
        ((0, -HALF, 0), (9.81, 0, 0)),
    ],
)
def test_at_rest_the_axis_that_points_up_reads_plus_g(rpy: Any, reading: Any) -> None:
    sensor = {"name": "acc", "link": "hand", "xyz": [0.1, 0.2, 0.3], "rpy": rpy}
    robot, rest = Robot.from_urdf(ARM, ARM_JOINTS, accelerometers=[sensor]), np.zeros(2)
    np.testing.assert_allclose(robot.specific_force(rest, rest, rest), reading, atol=1e-12)
    np.testing.assert_allclose(acceleration_map(robot, rest).bias, reading, atol=1e-12)


def test_in_free_fall_it_reads_nothing() -> None:
    lift = ARM.replace('type="revolute"', 'type="prismatic"', 1).replace('axis xyz="0 1 0"', 'axis xyz="0 0 1"', 1)
    robot = Robot.from_urdf(lift, ARM_JOINTS, accelerometers=[{"name": "acc", "link": "hand"}])
    rest = np.zeros(2)
    np.testing.assert_allclose(robot.specific_force(rest, rest, [-9.81, 0.0]), np.zeros(3), atol=1e-12)


@settings(max_examples=40, deadline=None)
@given(robot=robots(), seed=SEEDS)
def test_the_core_and_pinocchio_agree(robot: Robot, seed: int) -> None:
    q, dq, ddq = (rows[0] for rows in states(robot, 1, seed))
    expected, (matrix, bias) = acceleration_map(robot, q, dq), robot.acceleration_map(q, dq)
    np.testing.assert_allclose(matrix, expected.matrix, **CLOSE)
    np.testing.assert_allclose(bias, expected.bias, **CLOSE)
    reading = expected.matrix @ ddq + expected.bias
    np.testing.assert_allclose(robot.specific_force(q, dq, ddq), reading, **CLOSE)
    assert expected.channels == robot.acceleration_channels
    assert expected.matrix.shape == (len(expected.channels), robot.n)


def sensor_pose(robot: Robot, q: np.ndarray) -> Any:
    """Where the first accelerometer is, from forward kinematics and the URDF convention alone."""
    sensor, data = robot.accelerometers[0], robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, robot.to_pinocchio(q))
    link = robot.model.getFrameId(sensor.link, pin.FrameType.BODY)
    return data.oMf[link] * pin.SE3(pin.rpy.rpyToMatrix(*sensor.rpy), np.array(sensor.xyz))


@settings(max_examples=40, deadline=None)
@given(robot=robots(most=5), seed=SEEDS)
def test_readings_are_the_second_difference_of_positions(robot: Robot, seed: int) -> None:
    assume(robot.accelerometers)
    q, dq, ddq = (rows[0] for rows in states(robot, 1, seed))
    step = 1e-3

    def position(t: float) -> np.ndarray:
        return np.asarray(sensor_pose(robot, q + dq * t + ddq * t**2 / 2).translation)

    # Fourth order, so that the step can be long enough for the differences to carry ten digits.
    samples = [position(k * step) for k in (-2, -1, 0, 1, 2)]
    acceleration = np.tensordot([-1, 16, -30, 16, -1], samples, axes=1) / (12 * step**2)
    force = sensor_pose(robot, q).rotation.T @ (acceleration + UP)
    axes = ["xyz".index(axis) for axis in robot.accelerometers[0].axes]
    reading = robot.specific_force(q, dq, ddq)[: len(axes)]
    np.testing.assert_allclose(reading, force[axes], rtol=1e-5, atol=1e-5)


@settings(max_examples=50, deadline=None)
@given(x=st.floats(-0.5, 0.5), z=st.floats(-0.5, 0.5), q=st.tuples(*[st.floats(-3, 3)] * 3))
def test_determinant_is_height_over_the_plane_times_distance_from_axis_1(
    x: float, z: float, q: tuple[float, float, float]
) -> None:
    """De Luca, Schröder, Thümmel 2007, Fig. 2: the two singular configurations, here with axis 2 off axis 1."""
    shoulder, upper = 0.3, 0.65
    matrix = acceleration_map(kr15_with("link3", [x, 0, z]), q).matrix
    height = z * np.cos(q[2]) - x * np.sin(q[2])
    distance = shoulder + upper * np.cos(q[1]) + x * np.cos(q[1] + q[2]) + z * np.sin(q[1] + q[2])
    np.testing.assert_allclose(np.linalg.det(matrix), -upper * height * distance, atol=1e-12)


def height_over_axes_2_and_3(robot: Robot, q: np.ndarray) -> float:
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, robot.to_pinocchio(q))
    return float(data.oMi[robot.model.getJointId("a2")].actInv(sensor_pose(robot, q).translation)[2])


def reach_from_axis_1(robot: Robot, q: np.ndarray) -> float:
    return float(sensor_pose(robot, q).translation[:2] @ [np.cos(q[0]), np.sin(q[0])])


@pytest.mark.parametrize(
    ("joint", "interval", "distance", "hidden"),
    [  # the sensor being off the arm's plane, above axis 1 what joint 1 does to it looks like joints 2 and 3
        (2, (0.0, 2.0), height_over_axes_2_and_3, [False, True, True]),
        (1, (-2.6, -1.2), reach_from_axis_1, [True, True, True]),
    ],
    ids=["in the plane of axes 2 and 3", "above axis 1"],
)
def test_one_sensor_loses_a_joint_in_each_singular_configuration(
    kr15: Robot, joint: int, interval: tuple[float, float], distance: Callable[..., float], hidden: list[bool]
) -> None:
    q = np.array([0.4, -0.8, 0.7, 0.3, -0.5, 0.2])

    def at(value: float) -> np.ndarray:
        return np.concatenate([q[:joint], [value], q[joint + 1 :]])

    singular = at(brentq(lambda value: distance(kr15, at(value)), *interval, xtol=1e-15))
    bad, good = acceleration_map(kr15, singular), acceleration_map(kr15, q)
    assert bad.singular_values[-1] < 1e-10 * bad.singular_values[0]
    assert bad.condition > 1e10
    assert good.condition < 1e4
    assert (np.abs(bad.worst_direction) > 1e-2).tolist() == hidden
    assert np.isfinite(good.acceleration_std).all()
    assert (bad.acceleration_std > 1e6).tolist() == hidden


def test_only_elastic_joints_are_asked_after(kr15: Robot) -> None:
    found = acceleration_map(kr15, np.full(6, 0.4))
    assert found.matrix.shape == (3, 6)
    assert found.whitened.shape == (3, 3)
    assert found.elastic.tolist() == [True] * 3 + [False] * 3
    assert found.joints == kr15.names


@settings(max_examples=40, deadline=None)
@given(robot=robots(), seed=SEEDS)
def test_precision_is_that_of_weighted_least_squares(robot: Robot, seed: int) -> None:
    found = acceleration_map(robot, states(robot, 1, seed)[0][0])
    count = int(robot.elastic.sum())
    assert found.singular_values.shape == found.acceleration_std.shape == found.worst_direction.shape == (count,)
    assume(count and found.condition < 1e4)
    information = found.matrix[:, robot.elastic].T @ np.diag(found.noise_std**-2) @ found.matrix[:, robot.elastic]
    np.testing.assert_allclose(found.acceleration_std, np.sqrt(np.diag(np.linalg.inv(information))), rtol=1e-6)
    worst = np.linalg.norm(found.whitened @ found.worst_direction)
    np.testing.assert_allclose(worst, found.singular_values[-1], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(found.worst_direction), 1, rtol=1e-12)


def plain_map(matrix: Any, noise_std: float = 1.0) -> AccelerationMap:
    rows, columns = np.shape(matrix)
    return AccelerationMap(
        matrix=np.asarray(matrix, dtype=float),
        bias=np.zeros(rows),
        noise_std=np.full(rows, noise_std),
        channels=tuple(f"c{row}" for row in range(rows)),
        joints=tuple(f"j{column}" for column in range(columns)),
        elastic=np.ones(columns, dtype=bool),
    )


def test_noise_scales_the_standard_deviation() -> None:
    quiet, loud = plain_map(np.diag([1.0, 2.0]), 0.1), plain_map(np.diag([1.0, 2.0]), 0.2)
    np.testing.assert_allclose(quiet.acceleration_std, [0.1, 0.05])
    np.testing.assert_allclose(loud.acceleration_std, [0.2, 0.1])
    np.testing.assert_allclose(quiet.singular_values, [20, 10])
    assert quiet.condition == loud.condition == 2.0


def test_what_is_not_seen_has_an_infinite_standard_deviation() -> None:
    few = plain_map([[2.0, 0.0, 0.0], [0.0, 1.0, 1.0]])
    assert few.acceleration_std.tolist() == [0.5, np.inf, np.inf]
    assert few.condition == np.inf
    np.testing.assert_allclose(few.singular_values, [2, np.sqrt(2), 0])
    np.testing.assert_allclose(np.abs(few.worst_direction), np.array([0, 1, 1]) / np.sqrt(2), atol=1e-15)


def test_without_accelerometers_nothing_is_seen() -> None:
    found = acceleration_map(Robot.from_urdf(ARM, ARM_JOINTS), [0.0, 0.0])
    assert found.matrix.shape == (0, 2)
    assert found.acceleration_std.tolist() == [np.inf, np.inf]
    assert (found.condition, found.channels) == (np.inf, ())


def test_without_elastic_joints_there_is_nothing_to_see() -> None:
    rigid = [{"name": name, "elastic": False} for name in ("shoulder", "elbow")]
    sensor = {"name": "acc", "link": "hand"}
    found = acceleration_map(Robot.from_urdf(ARM, rigid, accelerometers=[sensor]), [0.0, 0.0])
    assert (found.condition, found.singular_values.size, found.worst_direction.size) == (1.0, 0, 0)


def test_shapes_are_checked_by_name() -> None:
    robot = Robot.from_urdf(ARM, ARM_JOINTS)
    with pytest.raises(EstimatorError, match=r"^q: expected shape \(2,\), got \(1, 2\)$"):
        acceleration_map(robot, np.zeros((1, 2)))
    with pytest.raises(EstimatorError, match=r"^dq: expected shape \(2,\), got \(3,\)$"):
        acceleration_map(robot, np.zeros(2), np.zeros(3))
