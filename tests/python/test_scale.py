"""When numbers overflow, settings that are out of scale are named, and readings blamed only if they are at fault."""

import pytest

from linkside import ElasticJointFilter, EstimatorError, ExtendedKalmanFilter, Log, Noise, NumericalError, Robot, demo
from linkside.kalman.scale import blame_settings, out_of_scale

ROBOT = Robot.load(demo.ROBOT)


def test_settings_of_a_robot_are_in_scale():
    for method in (ExtendedKalmanFilter, ElasticJointFilter):
        assert list(out_of_scale(ROBOT, method(ROBOT).noise)) == []


def test_settings_out_of_scale_are_named():
    robot = ROBOT.scaled(motor_inertia=1e-12)
    error = NumericalError("the estimate is not finite after sample 3: look for infinite or absurd readings there")
    words = str(blame_settings(error, robot, Noise(jerk=1e9)))
    assert "noise.jerk = 1e+09" in words
    assert "motor_inertia of joint 'a1' = 2.2e-11" in words
    assert "readings" not in words
    assert blame_settings(error, ROBOT, Noise()) is error


def test_a_jerk_that_overflows_is_refused():
    log = Log.read(demo.LOG, ROBOT)[:50]
    with pytest.raises(EstimatorError, match=r"jerk is 10+, expected at most 1e100"):
        ExtendedKalmanFilter(ROBOT, Noise(jerk=1e300)).run(log)
