"""Velocity observers: held to the printed equations, to recordings with a truth, and to saying what is wrong."""

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st

from linkside import (
    Estimate,
    EstimatorError,
    HybridGain,
    Log,
    LogError,
    NicosiaTomeiObserver,
    NumericalError,
    ReducedOrderObserver,
    Robot,
    Status,
    cli,
)

from . import two_rods
from .robots import spring

DATA = Path(__file__).parents[1] / "data"
PERIOD = 1e-3
RODS = two_rods.robot()
GAINS = (13.35799, 21.39453, 29.43109, 37.46764, 45.5042)


COAXIAL = """<robot name="coaxial"><link name="base"/><link name="none"/>
  <link name="disc"><inertial>
    <mass value="1"/><inertia ixx="4" ixy="0" ixz="0" iyy="4" iyz="0" izz="4"/></inertial></link>
  <joint name="first" type="continuous"><parent link="base"/><child link="none"/><axis xyz="0 0 1"/></joint>
  <joint name="second" type="continuous"><parent link="none"/><child link="disc"/><axis xyz="0 0 1"/></joint>
</robot>"""
"""The first joint moves nothing that the second one does not."""


def drive(observer, tau, seconds, gain=GAINS[0], position_gain=0.0):
    """Sample the plant into an observer; states, estimates, and the printed observer integrated beside it."""
    slope = two_rods.nicosia_tomei(gain, position_gain, tau)
    x = np.concatenate([two_rods.START, two_rods.START[:2], np.zeros(2)])
    rows, found, levels, printed = [], [], [], []
    for sample in range(round(seconds / PERIOD) + 1):
        t = sample * PERIOD
        state = observer.step(q=x[:2], tau=tau(t + PERIOD / 2))
        rows.append(x[:4])
        found.append(state.dq)
        levels.append(state.level)
        printed.append(x[6:8] + gain * (x[:2] - x[4:6]))
        x = two_rods.rk4(slope, t, x, PERIOD)
    return np.array(rows), np.array(found), np.array(levels), np.array(printed)


def slow(t):
    return np.array([np.cos(t / 2), -np.cos(t)])


def fast(t):
    return np.array([np.sin(t), 1 + np.sin(2 * t)])


@pytest.mark.parametrize(("position_gain", "apart"), [(0.0, 1e-6), (100.0, 2e-5), (500.0, 1e-4)])
def test_follows_the_equations_as_printed(position_gain, apart):
    gain = GAINS[0]
    observer = NicosiaTomeiObserver(RODS, gain, position_gain, period=PERIOD, start="rest")
    _, found, _, printed = drive(observer, slow, 1.5, gain, position_gain)
    assert np.abs(found - printed).max() < apart  # of speeds up to 1.1 rad/s


def test_without_a_spring_the_full_observer_is_the_reduced_one():
    log = recording("arm2_square")[1]
    robot = recording("arm2_square")[0]
    full, reduced = NicosiaTomeiObserver(robot, 80, 0).run(log), ReducedOrderObserver(robot, 80).run(log)
    np.testing.assert_array_equal(full.dq, reduced.dq)


def test_settles_as_in_the_first_example():
    rows, found, _, _ = drive(ReducedOrderObserver(RODS, GAINS[0], period=PERIOD, start="rest"), slow, 10)
    error = np.linalg.norm(rows[:, 2:] - found, axis=1)
    t = PERIOD * np.arange(len(error))
    for threshold, seconds in ((0.05 * error[0], 0.209), (0.01 * error[0], 0.322), (1e-3, 0.491)):
        assert two_rods.settled(t, error, threshold) == pytest.approx(seconds, rel=0.05)
    np.testing.assert_allclose(rows[-1, :2], (-4.62535, 2.42031), atol=1e-3)


@pytest.mark.parametrize(
    ("position_gain", "five", "one"), [(10, 0.189, 1.21), (100, 0.567, 1.05), (500, 0.284, 0.540), (2000, 0.343, 0.583)]
)
def test_full_observer_settles_as_in_continuous_time(position_gain, five, one):
    observer = NicosiaTomeiObserver(RODS, GAINS[0], position_gain, period=PERIOD, start="rest")
    rows, found, _, _ = drive(observer, slow, 2.5)
    error = np.linalg.norm(rows[:, 2:] - found, axis=1)
    t = PERIOD * np.arange(len(error))
    for share, seconds in ((0.05, five), (0.01, one)):
        assert two_rods.settled(t, error, share * error[0]) == pytest.approx(seconds, rel=0.05)


def test_gain_jumps_as_in_the_second_example():
    observer = ReducedOrderObserver(RODS, HybridGain(GAINS, 1.5, 1.0), period=PERIOD, start="rest")
    rows, _, levels, _ = drive(observer, fast, 20)
    jumps = np.flatnonzero(np.diff(levels)) + 1
    expected = (0.044, 6.824, 7.532, 11.350, 12.263, 15.423, 15.809, 15.955, 16.454, 18.873, 19.264, 19.572)
    np.testing.assert_allclose(jumps * PERIOD, expected, atol=5e-3)
    assert levels.max() == 4
    speed = np.linalg.norm(rows[:, 2:], axis=1)
    assert (speed <= 1.5 * levels).all()
    np.testing.assert_allclose(rows[-1, :2], (-13.335, 26.7145), atol=1e-3)


def test_printed_sets_chatter():
    observer = ReducedOrderObserver(
        RODS, HybridGain(GAINS, 1.5, 1.0, logic="printed-sets"), period=PERIOD, start="rest"
    )
    levels = drive(observer, fast, 2)[2]
    assert np.count_nonzero(np.diff(levels)) > 1900


def test_printed_map_makes_the_estimate_jump():
    logics = {}
    for logic in ("repaired", "printed-map"):
        observer = ReducedOrderObserver(RODS, HybridGain(GAINS, 1.5, 1.0, logic=logic), period=PERIOD, start="rest")
        logics[logic] = drive(observer, fast, 0.1)[1]
    steps = {logic: np.abs(np.diff(found, axis=0)).max() for logic, found in logics.items()}
    assert steps["repaired"] < 0.1
    assert steps["printed-map"] > 1


def test_level_returns_when_the_robot_rests():
    observer = ReducedOrderObserver(RODS, HybridGain(GAINS, 1.5, 1.0), period=PERIOD)
    observer.start(dq=[5.0, 0.0])
    states = [observer.step(q=[0.3, 0.2], tau=[0, 0]) for _ in range(2000)]
    assert states[0].level == 5
    assert states[-1].level == 1
    assert (np.diff([s.level for s in states]) <= 0).all()


@settings(max_examples=25, deadline=None)
@given(
    st.lists(st.floats(-np.pi, np.pi), min_size=2, max_size=2),
    st.floats(0, 2 * np.pi),
    st.floats(0, 2 * np.pi),
    st.floats(0.1, 1.5),
)
def test_energy_of_the_error_falls_inside_the_region(q, heading, direction, speed):
    observer = ReducedOrderObserver(RODS, GAINS[0], period=PERIOD)

    def unit(angle):
        return np.array([np.cos(angle), np.sin(angle)])

    x = np.concatenate([q, speed * unit(heading)])
    observer.start(dq=x[2:] + 0.13 * unit(direction))
    energies = []
    for _ in range(200):
        error = x[2:] - observer.step(q=x[:2], tau=[0, 0]).dq
        energies.append(error @ two_rods.mass(x) @ error)
        x = two_rods.rk4(lambda _, x: np.concatenate([x[2:], two_rods.forward(x[:2], x[2:], 0)]), 0, x, PERIOD)
    assert (np.diff(energies) <= 1e-6 * energies[0]).all()
    assert energies[-1] < 0.2 * energies[0]


def recording(name):
    robot = Robot.load(DATA / name / "robot.yaml")
    return robot, Log.read(DATA / name / "log.parquet", robot), Estimate.read(DATA / name / "truth.parquet")


def velocity_rms(estimate, truth, start=200):
    return np.sqrt(((estimate - truth)[start:] ** 2).mean(axis=0))


@pytest.mark.parametrize("observer", [ReducedOrderObserver, NicosiaTomeiObserver])
def test_motor_velocities_of_a_recording(observer):
    robot, log, truth = recording("kr15_six_axes")
    estimate = observer(robot, 300).run(log)
    assert (velocity_rms(estimate.dq, truth.dtheta) < 2e-3).all()
    assert (estimate.status == Status.GOOD).all()


def test_run_is_step_and_pieces_to_the_last_bit():
    robot, log, _ = recording("arm2_square")
    observer = ReducedOrderObserver(robot, [60, 90])
    whole = observer.run(log)
    pieces = Estimate.concatenate(observer.run_pieces([log[:700], log[700:701], log[701:]]))
    np.testing.assert_array_equal(whole.dq, pieces.dq)
    stepped = [observer.step(q=q, tau=tau) for q, tau in zip(log.theta[:300], log.tau[:300], strict=True)]
    np.testing.assert_array_equal(whole.dq[:300], [s.dq for s in stepped])
    np.testing.assert_array_equal(whole.tool_position[:300], [s.tool_position for s in stepped])
    observer.reset()
    np.testing.assert_array_equal(observer.step(q=log.theta[0], tau=log.tau[0]).dq, np.zeros(2))


def test_links_alone_when_their_positions_are_known():
    robot, log, truth = recording("arm2_square")
    torque = robot.inverse_dynamics(truth.q, truth.dq, truth.ddq)
    columns = {"t": log.t} | {
        f"{signal}_{name}": values[:, j]
        for signal, values in (("theta", log.theta), ("q", truth.q), ("torque", torque))
        for j, name in enumerate(robot.names)
    }
    estimate = ReducedOrderObserver(robot, 100, side="links").run(Log.from_table(columns, robot))
    assert (velocity_rms(estimate.dq, truth.dq) < 5e-4).all()
    assert np.isnan(estimate.theta).all()


def test_an_encoder_wrap_is_put_right_and_flagged():
    robot, log, _ = recording("arm2_square")
    observer = ReducedOrderObserver(robot)
    expected = observer.run(log)
    theta = log.theta.copy()
    theta[1000:, 1] -= 2 * np.pi
    wrapped = observer.run(changed(log, robot, theta))
    np.testing.assert_allclose(wrapped.dq, expected.dq, atol=1e-9)
    np.testing.assert_allclose(wrapped.q, expected.q, atol=1e-9)
    assert np.flatnonzero(wrapped.status & Status.UNWRAPPED).tolist() == [1000]


def test_missing_readings_are_bridged_and_flagged():
    robot, log, truth = recording("arm2_square")
    theta = log.theta.copy()
    theta[1000:1020] = np.nan
    estimate = ReducedOrderObserver(robot, 300).run(changed(log, robot, theta))
    assert np.count_nonzero(estimate.status & Status.BRIDGED) == 20
    assert (velocity_rms(estimate.dq, truth.dtheta) < 0.01).all()
    theta[1000:1200] = np.nan
    with pytest.raises(LogError, match=r"theta_axis2.*longer than an observer can bridge"):
        ReducedOrderObserver(robot).run(changed(log, robot, theta))


def changed(log, robot, theta):
    signals = (("theta", theta), ("tau", log.tau))
    columns = {f"{s}_{name}": v[:, j] for s, v in signals for j, name in enumerate(robot.names)}
    return Log.from_table({"t": log.t, **columns}, robot, check=False)  # the observer itself is to find the wrap


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"gain": 2001.0}, "a gain of 2001.0000 1/s is too fast for a period of 0.001 s: at most 2000.0000"),
        ({"gain": -1.0}, "a gain is -1, expected greater than 0"),
        ({"gain": [1.0, 2.0, 3.0]}, "gain has 3 entries, expected 1 or 2"),
        ({"gain": 10, "period": 0.0}, "the sampling period is 0"),
        ({"gain": 10, "wrap": 0.0}, "wrap is 0"),
        ({"gain": 10, "side": "left"}, "side is 'left'"),
        ({"gain": HybridGain((), 1.5, 1.0)}, "gains has 0 entries"),
        ({"gain": HybridGain((9.0,), -1.5, 1.0)}, "the bound of a level is -1.5"),
        ({"gain": HybridGain((9.0,), 1.5, 0.0)}, "the margin is 0"),
        ({"gain": HybridGain((9.0,), 1.5, 1.0, hysteresis=2.0)}, "the hysteresis is 2"),
        ({"gain": HybridGain((9.0,), 1.5, 1.0, start=2)}, "the start level is 2"),
        ({"gain": HybridGain((9.0, 9.0), 1.0, 1.5, start=1)}, "the start level is 1, expected one whose bound"),
        ({"gain": HybridGain((9.0,), 1.5, 1.0, dwell=-1)}, "dwell -1"),
        ({"gain": HybridGain((9.0,), 1.5, 1.0, logic="other")}, '"other" is not a logic of levels'),
    ],
)
def test_refuses_settings(settings, words):
    with pytest.raises(EstimatorError) as error:
        ReducedOrderObserver(RODS, **{"period": PERIOD, **settings})
    assert words in str(error.value)


def test_refuses_a_spring_that_would_swing_up_and_no_other():
    q, tau = np.zeros(2), np.zeros(2)
    taken = 1 - np.exp(-10 * PERIOD)
    limit = 10 / PERIOD / taken * (4 - 2 * taken) / (1 - taken / 3) * np.linalg.eigvalsh(two_rods.mass(q)).min()
    NicosiaTomeiObserver(RODS, 10, 0.99 * limit, period=PERIOD).step(q=q, tau=tau)
    with pytest.raises(EstimatorError, match="unstable at this rate"):
        NicosiaTomeiObserver(RODS, 10, 1.01 * limit, period=PERIOD).step(q=q, tau=tau)
    with pytest.raises(EstimatorError, match="gains has 0 entries"):
        NicosiaTomeiObserver(RODS, HybridGain((), 1.5, 1.0), period=PERIOD)
    with pytest.raises(EstimatorError, match="a position gain is -1"):
        NicosiaTomeiObserver(RODS, 10, -1, period=PERIOD)


def test_refuses_to_start_without_positions_or_a_period():
    with pytest.raises(EstimatorError, match="joint 1 is missing"):
        ReducedOrderObserver(RODS, 10, period=PERIOD).step(q=[0.0, np.nan], tau=[0, 0])
    with pytest.raises(EstimatorError, match="needs the sampling period"):
        ReducedOrderObserver(RODS, 10).step(q=[0, 0], tau=[0, 0])
    with pytest.raises(EstimatorError, match="dq has 1 entries, expected 2"):
        ReducedOrderObserver(RODS, 10, period=PERIOD).start(dq=[0])


def test_names_the_sample_of_a_singular_inertia():
    robot = Robot.from_urdf(COAXIAL, [spring("first"), spring("second")])
    observer = ReducedOrderObserver(robot, 10, side="links", period=PERIOD)
    with pytest.raises(NumericalError, match="singular at the posture of sample 0"):
        observer.step(q=[0, 0], tau=[0, 0])


def test_names_the_sample_that_is_no_number():
    robot, log, _ = recording("arm2_square")
    theta = log.theta.copy()
    theta[500] = np.inf
    with pytest.raises((NumericalError, LogError)):
        ReducedOrderObserver(robot).run(changed(log, robot, theta))


@pytest.mark.parametrize("method", ["reduced-order", "nicosia-tomei"])
def test_command_line(method, tmp_path):
    robot, log, _ = recording("arm2_square")
    folder, out = DATA / "arm2_square", tmp_path / "estimate.parquet"
    arguments = ["estimate", folder / "robot.yaml", folder / "log.parquet", "--with", method, "--gain", "80"]
    result = CliRunner().invoke(cli.main, [*map(str, arguments), "--out", str(out)])
    assert result.exit_code == 0, result.output
    observer = {"reduced-order": ReducedOrderObserver, "nicosia-tomei": NicosiaTomeiObserver}[method]
    np.testing.assert_array_equal(Estimate.read(out).dq, observer(robot, 80).run(log).dq)


def test_command_line_says_that_a_gain_is_too_fast(tmp_path):
    folder = DATA / "arm2_square"
    arguments = ["estimate", folder / "robot.yaml", folder / "log.parquet", "--with", "reduced-order", "--gain", "1e5"]
    result = CliRunner().invoke(cli.main, [*map(str, arguments), "--out", str(tmp_path / "estimate.parquet")])
    assert result.exit_code == 2
    assert "too fast for a period" in result.stderr
    assert len(result.stderr.splitlines()) == 1
