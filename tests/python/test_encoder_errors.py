"""Encoders that read wrong: what is known of it is taken off as a log is read, what is not counts in deviations."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from linkside import (
    ConfigError,
    ElasticJointFilter,
    ExtendedKalmanFilter,
    Log,
    RauchTungStriebelSmoother,
    Robot,
    Sensor,
    simulate,
)
from linkside.robot.encoders import EncoderReading

from .robots import ARM, spring

TIP = {"name": "tip", "link": "hand", "xyz": [0.1, 0, 0.3], "noise_std": 0.02}
KNOWN = {
    "zero": 0.01,
    "scale": 1.009,
    "harmonics": [
        {"order": 1, "amplitude": 2e-4, "phase": 0.5, "of": "output"},
        {"order": 2, "amplitude": 5e-5, "phase": -1.0},
    ],
}


def arm(error=None, link=None, **settings):
    drives = [
        spring(n, gear_ratio=100.0, encoder_error=error or {}, link_encoder_error=link or {})
        for n in ("shoulder", "elbow")
    ]
    given = {"encoder": {"resolution": 1e-6}, "torque": {"noise_std": 1e-3}} | settings
    return Robot.from_urdf(ARM, drives, accelerometers=[TIP], tool={"link": "hand"}, **given)


@settings(max_examples=50, deadline=None)
@given(
    st.floats(0.6, 1.9),
    st.floats(-1, 1),
    st.lists(st.tuples(st.floats(0, 1), st.floats(0.5, 500), st.floats(-3, 3)), max_size=3),
    st.lists(st.floats(-20, 20), min_size=1, max_size=20),
)
def test_each_reading_has_its_angle(scale, zero, waves, angles):
    """EncoderReading rise with the angle, their slope is the complex step's, and angles come back."""
    encoder = EncoderReading(scale, zero, [(0.06 * size / cycles, cycles, phase) for size, cycles, phase in waves])
    angle = np.array(angles)
    assert_allclose(encoder.angle(encoder.of(angle)), angle, atol=1e-13)
    assert_allclose(_slope(encoder, angle), encoder.rate(angle), rtol=1e-12)


def _slope(encoder, angle):
    """By the complex step."""
    x = angle + 1e-30j
    found = encoder.scale * x + encoder.zero
    for amplitude, cycles, phase in encoder.harmonics:
        found = found + amplitude * np.sin(cycles * x + phase)
    return found.imag / 1e-30


def servo(robot):
    hold = robot.gravity_torque(np.zeros(2))

    def torque(t, state):
        goal = np.array([0.5, -0.4]) * np.sin(3 * t) ** 2
        return hold + 3e3 * (goal - state.theta) - 150 * state.dtheta

    return torque


def moved(robot, seed=1, **sensors):
    return simulate(robot, servo(robot), 0.8, 1000.0, substeps=4, seed=seed, sensors=sensors)


def test_what_is_known_of_an_encoder_is_taken_off(tmp_path):
    robot, plain = arm(KNOWN), arm()
    run = moved(robot, dtheta=Sensor())
    run.write(tmp_path)
    path = tmp_path / "log.parquet"
    read, raw = Log.read(path, robot), Log.read(path, plain, check=False)
    theta = run.truth["theta"]
    assert_allclose(read.theta, theta, atol=1e-6)
    printed = 1.009 * theta + 0.01 + 2e-4 * np.sin(theta + 0.5) + 5e-5 * np.sin(200 * theta - 1)
    assert_allclose(raw.theta, printed, atol=1e-6)
    assert_allclose(read.dtheta, run.truth["dtheta"], atol=1e-4)

    def error(robot, log):
        return np.sqrt(np.mean((ExtendedKalmanFilter(robot).run(log).q - run.truth["q"]) ** 2))

    assert error(robot, read) < 1e-5 < 1e-3 < error(plain, raw)


def test_a_link_encoder_may_read_wrong_too(tmp_path):
    robot = arm(link={"scale": 0.99, "harmonics": [{"order": 1, "amplitude": 1e-3, "phase": 1.0, "of": "output"}]})
    run = moved(robot, q=Sensor())
    run.write(tmp_path)
    q, raw = run.truth["q"], Log.read(tmp_path / "log.parquet", arm(), check=False).q
    assert_allclose(raw, 0.99 * q + 1e-3 * np.sin(q + 1.0), atol=1e-12)
    assert_allclose(Log.read(tmp_path / "log.parquet", robot).q, q, atol=1e-12)


LINES = {"harmonics": [{"order": 4, "amplitude": 2e-4}]}


@pytest.mark.parametrize("method", [ExtendedKalmanFilter, RauchTungStriebelSmoother, ElasticJointFilter])
def test_lines_of_unknown_phase_count_in_deviations(method):
    """Their phase is another one in each run: deviations hold it, and are larger than those of a clean encoder."""
    tight = {"tolerances": {"lost_motion": 1e-6, "encoder_zero": 0.0}}
    robot = arm(LINES, **tight)
    errors, stds = [], []
    for seed in range(6):
        run = moved(robot, seed)
        estimate = method(robot).run(run.log)
        errors.append(estimate.q - run.truth["q"])
        stds.append(estimate.q_std)
    assert 5e-5 < np.std([run[0, 0] for run in errors]) < 4e-4
    within = np.mean(np.abs(errors) <= 3 * np.array(stds))
    assert within > 0.99, within
    clean = method(arm(**tight)).run(moved(arm(**tight)).log)
    assert np.median(stds) > 1.3 * np.median(clean.q_std)


def test_lines_of_a_run_differ_and_repeat_with_the_seed():
    robot = arm(LINES)
    first, again, other = (moved(robot, seed).log.theta for seed in (1, 1, 2))
    assert_allclose(first, again)
    assert np.abs(first - other).max() > 1e-5


@pytest.mark.parametrize(
    ("error", "expected"),
    [
        ({"scale": 3.0}, "encoder_error.scale: expected 0.5 to 2"),
        ({"harmonics": [{"order": 1, "amplitude": 0.01}]}, "encoder_error: expected to change a reading's rate"),
        ({"harmonics": [{"order": 0, "amplitude": 0.01}]}, "order"),
    ],
)
def test_errors_that_are_none_are_refused_with_their_key(error, expected):
    with pytest.raises(ConfigError, match=expected):
        arm(error)


def test_a_link_encoder_turns_with_its_link():
    with pytest.raises(ConfigError, match="expected 'output': the link's encoder turns with the link"):
        arm(link=LINES)
