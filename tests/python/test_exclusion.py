"""Faulty channels that are left out from where their fault began: against the same runs without those channels."""

from dataclasses import replace

import numpy as np
import pytest

from linkside import (
    ElasticJointFilter,
    Estimate,
    EstimatorError,
    ExtendedKalmanFilter,
    IteratedSmoother,
    Log,
    RauchTungStriebelSmoother,
    Robot,
    Status,
    smooth_file,
)
from linkside.cli import main
from linkside.kalman.exclusion import LEAD

from .robots import DATA
from .test_trust import spoiled

SQUARE = DATA / "arm2_square"
ROWS, BEGIN, LATE = 1600, 800, 20
FAULTS = ("dead", "stuck", "saturated", "flipped", "step", "gain", "late")


@pytest.fixture(scope="module")
def square():
    """The simulated arm, a recording of it, and where its links were."""
    robot = Robot.load(SQUARE / "robot.yaml")
    log = Log.read(SQUARE / "log.parquet", robot)[:ROWS]
    truth = Estimate.read(SQUARE / "truth.parquet")
    return robot, log, truth.q[np.searchsorted(truth.t, log.t - 1e-9)]


def broken(log, signal, channel, fault):
    """A log with a fault in one channel from the row BEGIN on."""
    if fault not in ("saturated", "late"):
        return spoiled(log, signal, channel, fault, BEGIN)
    values = getattr(log, signal).copy()
    x = values[:, channel].copy()
    most = np.median(np.abs(x[BEGIN:]))
    values[BEGIN:, channel] = np.clip(x[BEGIN:], -most, most) if fault == "saturated" else x[BEGIN - LATE : -LATE]
    return replace(log, **{signal: values})


def without(log, signal, channel, since):
    """The same log, whose channel has no reading from a row on."""
    values = getattr(log, signal).copy()
    values[since:, channel] = np.nan
    return replace(log, **{signal: values})


def error(estimate, q):
    return np.sqrt(np.mean((estimate.q - q)[BEGIN:] ** 2))


def off_and_good(estimate, q):
    good = estimate.status & (Status.CONTRADICTED | Status.FAULTY) == 0
    return np.mean((np.abs(estimate.q - q) > 3 * estimate.q_std).any(axis=1) & good)


@pytest.mark.parametrize("method", [ExtendedKalmanFilter, RauchTungStriebelSmoother, ElasticJointFilter])
def test_the_estimate_is_that_without_the_channel(square, method):
    robot, log, q = square
    named = 0
    for signal, channels in (("acceleration", 3), ("theta", 2)):
        for channel in range(channels):
            column = log.columns(signal)[channel]
            # What goes on without a motor's position is a walk: a few rows more or less may move its end either way.
            missing = (without(log, signal, channel, since) for since in (BEGIN, BEGIN - LEAD))
            bound = 1.2 * max(error(estimate, q) for estimate in method(robot).run(list(missing)))
            for fault in FAULTS:
                what = f"{column} {fault}"
                found = method(robot, exclude_faulty=True).run(broken(log, signal, channel, fault))
                excluded = [finding.channel for finding in found.findings if finding.left_out]
                assert excluded in ([column], []), what
                assert off_and_good(found, q) <= 0.02, what
                if excluded:
                    # Of readings that are late the first ones are right, and are used until they contradict.
                    assert fault == "late" or error(found, q) <= bound, what
                    assert (found.status[BEGIN:] & Status.BRIDGED)[LATE:].any(), what
                    assert not (found.status & (Status.CONTRADICTED | Status.FAULTY)).any(), what
                named += len(excluded)
    assert named >= 28  # of 35: what is not named does not move links, as readings across the plane of the arm


def test_two_faults_are_left_out_one_after_the_other(square):
    robot, log, q = square
    both = spoiled(spoiled(log, "acceleration", 0, "dead", 600), "acceleration", 2, "flipped", 1000)
    found = ExtendedKalmanFilter(robot, exclude_faulty=True).run(both)
    assert [finding.channel for finding in found.findings if finding.left_out] == ["tool_acc_x", "tool_acc_z"]
    readings = log.acceleration.copy()
    readings[600:, 0], readings[1000:, 2] = np.nan, np.nan
    expected = ExtendedKalmanFilter(robot).run(replace(log, acceleration=readings))
    assert error(found, q) <= 1.2 * error(expected, q)
    assert "left out from there on" in str(found.findings[0])


def test_a_sound_recording_keeps_all_of_its_channels(square):
    robot, log, _ = square
    plain, careful = (ExtendedKalmanFilter(robot, exclude_faulty=wanted).run(log) for wanted in (False, True))
    assert careful.findings == ()
    np.testing.assert_array_equal(careful.q, plain.q)


def test_a_start_that_was_fitted_to_wrong_readings_stays_flagged(square):
    """It looks like another posture, and the accelerometer as if it were wrong."""
    robot, log, _ = square
    theta = log.theta.copy()
    theta[:, 0] = -theta[:, 0]
    faulty = replace(log, theta=theta)
    plain, careful = (ExtendedKalmanFilter(robot, exclude_faulty=wanted).run(faulty) for wanted in (False, True))
    assert plain.findings
    assert careful.findings == plain.findings
    np.testing.assert_array_equal(careful.status, plain.status)


def test_a_sensor_that_is_dead_from_the_beginning_is_left_out(square):
    robot, log, q = square
    dead = replace(log, acceleration=np.zeros_like(log.acceleration))
    found = ExtendedKalmanFilter(robot, exclude_faulty=True).run(dead)
    assert {finding.channel for finding in found.findings if finding.left_out} == {"tool_acc_x", "tool_acc_z"}
    assert error(found, q) <= 1.2 * error(ExtendedKalmanFilter(robot).run(without_accelerometer(log)), q)


def without_accelerometer(log):
    return replace(log, acceleration=np.full_like(log.acceleration, np.nan))


def test_several_logs_and_the_most_probable_motion(square):
    robot, log, _ = square
    faulty = broken(log, "acceleration", 0, "flipped")
    found = ExtendedKalmanFilter(robot, exclude_faulty=True).run([log, faulty])
    assert [len(estimate.findings) for estimate in found] == [0, 1]
    best = IteratedSmoother(robot, exclude_faulty=True).run(faulty[:1200])
    assert [finding.channel for finding in best.findings if finding.left_out] == ["tool_acc_x"]


def test_pieces_are_refused(square, tmp_path):
    robot, log, _ = square
    with pytest.raises(EstimatorError, match="exclude_faulty"):
        list(ExtendedKalmanFilter(robot, exclude_faulty=True).run_pieces([log]))
    with pytest.raises(EstimatorError, match="exclude_faulty"):
        list(ElasticJointFilter(robot, exclude_faulty=True).run_pieces([log]))
    smoother = RauchTungStriebelSmoother(robot, exclude_faulty=True)
    with pytest.raises(EstimatorError, match="exclude_faulty"):
        smooth_file(smoother, SQUARE / "log.parquet", robot, tmp_path / "out.parquet")


@pytest.mark.parametrize("method", ["ekf", "smoother", "elastic-ekf"])
def test_on_the_command_line(square, tmp_path, capsys, method):
    _, log, q = square
    broken(log, "acceleration", 0, "flipped").write(tmp_path / "log.parquet")
    words = [
        "estimate",
        str(SQUARE / "robot.yaml"),
        str(tmp_path / "log.parquet"),
        "--with",
        method,
        "--exclude-faulty",
    ]
    with pytest.raises(SystemExit) as ended:
        main.main([*words, "--no-check", "--out", str(tmp_path / "out.parquet")])
    assert ended.value.code == 0
    assert "left out from there on" in capsys.readouterr().out
    found = Estimate.read(tmp_path / "out.parquet")
    assert not (found.status & Status.CONTRADICTED).any()
    assert off_and_good(found, q) <= 0.02
