"""The ROS node's core: which reading of which message goes into which sample, without ROS."""

import subprocess
from pathlib import Path

import numpy as np
import pytest

import linkside
from linkside import AccelerationObserver, ExtendedKalmanFilter

ROOT = Path(__file__).parents[2]

START = 1_700_000_000_000_000_000
"""Stamp of the first message [ns]."""

STARTED, EARLY = 1, 2


@pytest.fixture(scope="module")
def robot():
    return linkside.Robot.load(linkside.demo.ROBOT)


@pytest.fixture(scope="module")
def log(robot):
    return linkside.Log.read(linkside.demo.LOG, robot)[:200]


@pytest.fixture(scope="module")
def replay(build):
    package = ROOT / "ros/linkside_ros"
    return build(ROOT / "tests/cpp/replay.cpp", package / "src/follower.cpp", include=[package / "include"])


def stamp(log, row):
    return START + round(1e9 * log.period) * row


def joints(robot, log, row):
    """A JointState, its joints in another order than the log's, one of another robot among them."""
    states = [(name, log.theta[row, j], np.nan, log.tau[row, j]) for j, name in enumerate(robot.names)]
    states = [("gripper", 9.0, 9.0, 9.0), *reversed(states)]
    words = " ".join(f"{name} {q!r} {dq!r} {tau!r}" for name, q, dq, tau in (map(plain, s) for s in states))
    return f"joints {stamp(log, row)} {len(states)} {words}"


def plain(value):
    return value if isinstance(value, str) else float(value)


def imu(robot, log, row):
    [sensor] = robot.accelerometers
    values = dict(zip(robot.acceleration_channels, map(float, log.acceleration[row]), strict=True))
    forces = [values.get(f"{sensor.name}_{axis}", 0.0) for axis in "xyz"]
    return f"imu {sensor.name} {stamp(log, row)} {' '.join(map(repr, forces))} 0 0 0"


def followed(replay, estimator, messages, folder):
    """Outcome, status and positions after each joint message, and the counts."""
    estimator.compile(folder / "robot.lsr")
    done = subprocess.run(
        [replay, folder / "robot.lsr"], input="\n".join(messages), capture_output=True, text=True, check=True
    )
    rows = [line.split() for line in done.stdout.splitlines()]
    return (
        [int(row[0]) for row in rows],
        np.array([[float(x) for x in row[2:]] for row in rows]),
        [int(x) for x in done.stderr.split()],
    )


def test_a_filter_takes_each_reading_once(replay, robot, log, tmp_path):
    """The IMU comes at half the rate: a sample between has none, which is what Python is given."""
    ekf = ExtendedKalmanFilter(robot, start="rest")
    messages, expected = [], []
    for row in range(len(log)):
        messages += [imu(robot, log, row)] * (row % 2) + [joints(robot, log, row)]
        if row:
            force = log.acceleration[row] if row % 2 else np.full(log.acceleration.shape[1], np.nan)
            dt = 1e-9 * (stamp(log, row) - stamp(log, row - 1))
            expected.append(ekf.step(dt=dt, theta=log.theta[row], acceleration=force).q)
    outcomes, q, counts = followed(replay, ExtendedKalmanFilter(robot, start="rest"), messages, tmp_path)
    assert outcomes == [STARTED] + [0] * (len(log) - 1)
    np.testing.assert_array_equal(q[1:], expected)
    assert counts == [len(log) - 1, 1, 0, 0]


def test_an_observer_holds_readings_and_bridges_messages_that_did_not_come(replay, robot, log, tmp_path):
    observer, messages, expected = AccelerationObserver(robot, period=log.period), [], []
    lost = {50, 51, 120}
    held, torque = np.full(log.acceleration.shape[1], np.nan), None
    for row in range(len(log)):
        messages += [imu(robot, log, row)] * (row % 2)
        if row % 2:
            fresh = log.acceleration[row]
        if row in lost:
            expected.append(observer.step(theta=np.full(robot.n, np.nan), tau=torque, acceleration=held).q)
            continue
        messages.append(joints(robot, log, row))
        if row:
            held, torque = fresh, log.tau[row]
            expected.append(observer.step(theta=log.theta[row], tau=torque, acceleration=held).q)
    _, q, counts = followed(replay, AccelerationObserver(robot, period=log.period), messages, tmp_path)
    there = [row - 1 for row in range(1, len(log)) if row not in lost]
    np.testing.assert_array_equal(q[1:], np.array(expected)[there])
    assert counts == [len(log) - 1 - len(lost), 1, 0, len(lost)]


def test_repeated_late_and_interrupted_messages(replay, robot, log, tmp_path):
    rows = [0, 1, 2, 2, 1, 3]
    messages = [joints(robot, log, row) for row in rows]
    gap = joints(robot, log, 4).replace(str(stamp(log, 4)), str(stamp(log, 4) + 10**9))
    back = joints(robot, log, 5).replace(str(stamp(log, 5)), str(START - 10**10))
    outcomes, _, _ = followed(replay, ExtendedKalmanFilter(robot, start="rest"), [*messages, gap, back], tmp_path)
    assert outcomes == [STARTED, 0, 0, EARLY, EARLY, 0, STARTED, STARTED]


def test_a_sensor_that_is_not_read_is_said(replay, robot, log, tmp_path):
    ExtendedKalmanFilter(robot, start="rest").compile(tmp_path / "robot.lsr")
    message = imu(robot, log, 0).replace(robot.accelerometers[0].name, "other")
    done = subprocess.run([replay, tmp_path / "robot.lsr"], input=message, capture_output=True, text=True, check=True)
    assert done.stdout == "no such sensor\n"
