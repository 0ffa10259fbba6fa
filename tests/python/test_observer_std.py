"""Standard deviations of the acceleration-driven observer, held to robots that differ, and its ultimate bound."""

import dataclasses
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from linkside import AccelerationObserver, Estimate, EstimatorError, Log, Robot, Status
from linkside.control import inverse_dynamics
from linkside.control.trajectories import rest_to_rest

from .test_observers import ONE_LINK, RECORDINGS, load, one_joint

FOLDER = Path(__file__).parents[1] / "data/arm2_square"
OFFSET = 1e-5
"""What every link may be off by beside all else [rad]."""
EXACT = dict.fromkeys(
    ("stiffness", "cubic_stiffness", "damping", "motor_inertia", "torque_constant", "motor_friction", "link_friction"),
    1e-12,
) | {"translation": 1e-12, "rotation": 1e-12, "scale": 1e-12, "bias": 1e-12, "lost_motion": 0.0, "mass_scale": 1.0}
"""Tolerances of a robot that is as its robot.yaml says, but for masses, which an observer does not use."""
TOLERANCE = 0.1
COUNTED = np.expm1(3 * TOLERANCE) / 3
"""What a tolerance of a logarithm counts for."""


@cache
def smooth():
    """A robot without dry friction, whose sign no derivative tells, and what it reads but for the noise of torques."""
    robot = Robot.load(FOLDER / "robot.yaml")
    log, truth = Log.read(FOLDER / "log.parquet", robot), Estimate.read(FOLDER / "truth.parquet")
    dry = [drive.motor_friction.coulomb for drive in robot.drives] * truth.dtheta / np.hypot(truth.dtheta, 2e-3)
    joints = [
        drive.model_copy(update={"motor_friction": drive.motor_friction.model_copy(update={"coulomb": 0.0})})
        for drive in robot.drives
    ]
    robot = Robot(robot.config.model_copy(update={"joints": tuple(joints)}), robot.tree)
    exact = robot.specific_force(truth.q, truth.dq, truth.ddq)
    return robot, dataclasses.replace(log, theta=truth.theta, acceleration=exact, tau=log.tau - dry)[:1800]


def changed(robot, key, factor):
    """The robot with one number of each joint, or of its sensor, off."""
    config = robot.config
    if key in ("xyz", "rpy"):
        moved = tuple(s.model_copy(update={key: tuple(np.add(getattr(s, key), factor))}) for s in config.accelerometers)
        return Robot(config.model_copy(update={"accelerometers": moved}), robot.tree)
    if key == "viscous":
        friction = [d.motor_friction.model_copy(update={key: d.motor_friction.viscous * factor}) for d in config.joints]
        joints = [d.model_copy(update={"motor_friction": f}) for d, f in zip(config.joints, friction, strict=True)]
    else:
        joints = [d.model_copy(update={key: getattr(d, key) * factor}) for d in config.joints]
    return Robot(config.model_copy(update={"joints": tuple(joints)}), robot.tree)


def with_tolerances(robot, **known):
    tolerances = robot.config.tolerances.model_copy(update=EXACT | known)
    return Robot(robot.config.model_copy(update={"tolerances": tolerances}), robot.tree)


DRIVES = {
    "stiffness": "stiffness",
    "damping": "damping",
    "motor_inertia": "motor_inertia",
    "motor_friction": "viscous",
}


def share(**known):
    """By how much numbers that are known so well widen deviations (rows, n)."""
    robot, log = smooth()
    wide, exact = (AccelerationObserver(with_tolerances(robot, **k)).run(log).q_std for k in (known, {}))
    return np.sqrt(np.maximum(wide**2 - exact**2, 0))


def agrees(stated, moved, spread):
    """Whether that is what numbers that are off move the links by, where it is more than a tenth of the most.

    It is computed every few samples, which a few rows of fast motion show.
    """
    stated, moved = stated[900:], np.abs(moved)[900:]
    for j in range(moved.shape[1]):
        large = moved[:, j] > 0.1 * moved[:, j].max()
        low, median, high = np.quantile(stated[large, j] / moved[large, j], [0.1, 0.5, 0.9])
        assert median == pytest.approx(1, abs=0.04)
        assert 1 - spread < low < high < 1 + spread, (low, high)


@pytest.mark.parametrize("name", DRIVES)
def test_a_number_of_a_drive_moves_links_as_it_says(name):
    """Against observers of robots that are truly different, each with gains of its own."""
    robot, log = smooth()
    key = DRIVES[name]
    more, less = (AccelerationObserver(changed(robot, key, np.exp(e)), std=False).run(log).q for e in (1e-3, -1e-3))
    agrees(share(**{name: TOLERANCE}), COUNTED * (more - less) / 2e-3, 0.2)


def test_a_torque_constant_moves_links_as_it_says():
    robot, log = smooth()
    observer = AccelerationObserver(robot, std=False)
    more, less = (observer.run(dataclasses.replace(log, tau=log.tau * np.exp(e))).q for e in (1e-3, -1e-3))
    agrees(share(torque_constant=TOLERANCE), COUNTED * (more - less) / 2e-3, 0.2)


SENSORS = {"translation": 0.02, "rotation": 0.05, "bias": 0.5, "scale": TOLERANCE}


@pytest.mark.parametrize("name", SENSORS)
def test_numbers_of_an_accelerometer_move_links_as_they_say(name):
    """All axes at once: the squares of what each does add up."""
    robot, log = smooth()
    squares = np.zeros_like(log.theta)
    for axis in range(3):
        unit = 1e-4 * np.eye(3)[axis]
        pair = []
        for sign in (1, -1):
            other, readings = robot, log.acceleration
            if name == "translation":
                other = changed(robot, "xyz", sign * turned(robot) @ unit)
            elif name == "bias":
                readings = readings + sign * unit
            elif name == "scale":
                readings = readings * np.exp(sign * unit)
            else:
                readings = readings + sign * np.cross(readings, unit)
            run = AccelerationObserver(other, std=False).run(dataclasses.replace(log, acceleration=readings))
            pair.append(run.q)
        by = (pair[0] - pair[1]) / 2e-4 * (COUNTED if name == "scale" else SENSORS[name])
        squares += by**2
    agrees(share(**{name: SENSORS[name]}), np.sqrt(squares), 0.3)


def turned(robot):
    """The axes of the first accelerometer on its link."""
    r, p, y = robot.config.accelerometers[0].rpy
    about = [
        np.array([[1, 0, 0], [0, np.cos(r), -np.sin(r)], [0, np.sin(r), np.cos(r)]]),
        np.array([[np.cos(p), 0, np.sin(p)], [0, 1, 0], [-np.sin(p), 0, np.cos(p)]]),
        np.array([[np.cos(y), -np.sin(y), 0], [np.sin(y), np.cos(y), 0], [0, 0, 1]]),
    ]
    return about[2] @ about[1] @ about[0]


@pytest.mark.parametrize("frequency", [60.0, 250.0, 1900.0])
@pytest.mark.parametrize("signal", ["theta", "tau", "acceleration"])
def test_noise_is_as_large_as_it_says(signal, frequency):
    """A joint at rest at 1 kHz, on poles up to as fast as can be: its errors over many samples."""
    size = {"theta": 1e-4, "tau": 50.0, "acceleration": 2.0}
    noise = {name: size[name] if name == signal else 1e-9 for name in size}
    sensor = {"name": "s", "link": "arm", "xyz": [1, 0, 0], "noise_std": noise["acceleration"], "axes": "y"}
    joint = {"name": "a", "stiffness": 1.2e5, "damping": 60.0, "motor_inertia": 30.0}
    robot = Robot.from_urdf(
        ONE_LINK,
        [joint],
        accelerometers=[sensor],
        encoder={"resolution": noise["theta"] * 12**0.5},
        torque={"noise_std": noise["tau"]},
    )
    t = np.arange(20_000) * 1e-3
    rng = np.random.default_rng(1)
    columns = {"t": t} | {
        column: noise[name] * rng.standard_normal(len(t))
        for name, column in (("theta", "theta_a"), ("tau", "tau_a"), ("acceleration", "s_y"))
    }
    log = Log.from_table(columns, robot, check=False)
    for bias in (False, True):
        estimate = AccelerationObserver(robot, frequency, tolerances=False, bias=bias).run(log)
        found = estimate.q[500:, 0].std()
        stated = np.sqrt(estimate.q_std[500:, 0] ** 2 - OFFSET**2 - noise["theta"] ** 2)
        assert np.ptp(stated) < 1e-9 + 1e-6 * stated.max()
        if stated[0] > 1e-7:
            assert found == pytest.approx(stated[0], rel=0.12), (bias, found, stated[0])


def test_without_them_estimates_are_the_same():
    robot, log, _ = load("kr15_short")
    log = log[:400]
    on, off, plain = (AccelerationObserver(robot, **s).run(log) for s in ({}, {"std": False}, {"tolerances": False}))
    for other in (off, plain):
        for name in ("q", "dq", "ddq", "theta", "dtheta", "tool_position", "status"):
            assert np.array_equal(getattr(on, name), getattr(other, name))
    assert off.q_std is None
    assert off.tool_std is None
    assert (plain.q_std < on.q_std).all()
    with pytest.raises(EstimatorError, match="no q_std"):
        off.require("q_std")


def test_the_tool_is_as_uncertain_as_its_joints_make_it():
    """One joint: its tool moves along the arc."""
    robot = Robot.from_urdf(
        ONE_LINK,
        [{"name": "a", "stiffness": 1.2e5, "motor_inertia": 30.0}],
        tool={"link": "arm", "xyz": [2.0, 0.0, 0.0]},
    )
    t = np.arange(300) * 1e-3
    columns = {"t": t, "theta_a": 0.5 + 0 * t, "tau_a": 200.0 + 0 * t, "ddq_a": 0 * t}
    estimate = AccelerationObserver(robot, accelerations="joints").run(Log.from_table(columns, robot, check=False))
    q = estimate.q[:, 0]
    expected = 2.0 * estimate.q_std[:, :1] * np.abs(np.stack([np.sin(q), np.cos(q), 0 * q], axis=1))
    np.testing.assert_allclose(estimate.tool_std[100:], expected[100:], rtol=1e-6, atol=1e-15)


def test_errors_that_go_together_are_not_counted_twice():
    """A spring and a torque constant that are off alike twist the link alike: q = θ − τ/K."""
    robot, log = smooth()
    known = {"stiffness": TOLERANCE, "torque_constant": TOLERANCE}
    apart = AccelerationObserver(with_tolerances(robot, **known)).run(log)
    together = {f"stiffness_{name}": {f"torque_constant_{name}": 0.999999} for name in robot.names}
    alike = AccelerationObserver(with_tolerances(robot, **known, correlations=together)).run(log)
    slow = np.abs(np.diff(log.tau, axis=0)).max(axis=1) < 30
    assert np.median(alike.q_std[400:] / apart.q_std[400:]) < 0.4
    assert slow.any()


@pytest.mark.parametrize("name", RECORDINGS)
def test_recordings_are_inside_them(name):
    robot, log, truth = load(name)
    estimate, truth = AccelerationObserver(robot).run(log), Estimate.read(truth)
    off = (np.abs(estimate.q - truth.q) > 3 * estimate.q_std).any(axis=1)
    tool = (np.abs(estimate.tool_position - truth.tool_position) > 3 * estimate.tool_std + 1e-12).any(axis=1)
    assert off.mean() <= 0.02
    assert tool.mean() <= 0.02
    assert (estimate.status == Status.GOOD).all()


@pytest.mark.parametrize("tolerances", [-3, -1, 1, 3])
def test_a_spring_that_is_off_is_inside_its_tolerance(tolerances):
    robot, log, truth = load("arm2_square")
    estimate = AccelerationObserver(changed(robot, "stiffness", np.exp(0.2 * tolerances))).run(log)
    ratio = np.abs(estimate.q - Estimate.read(truth).q) / estimate.q_std
    assert (ratio > 3).any(axis=1).mean() <= 0.02
    assert np.median(ratio) > 0.2
    assert not estimate.status.any()


def failing(log, signal, channel, kind, at=1300):
    values = getattr(log, signal).copy()
    rest = values[at:, channel]
    rest[:] = {"stuck": rest[0] + 0 * rest, "flipped": -rest, "dead": 0 * rest, "gain": 1.2 * rest}[kind]
    return dataclasses.replace(log, **{signal: values})


@pytest.mark.parametrize("kind", ["stuck", "flipped", "dead", "gain"])
@pytest.mark.parametrize(
    ("signal", "channel"), [("theta", 1), ("tau", 0), ("tau", 1), ("acceleration", 0), ("acceleration", 2)]
)
def test_a_channel_that_fails_does_not_make_a_good_row_wrong(signal, channel, kind):
    robot, log, truth = load("arm2_square")
    if signal == "theta" and kind in ("flipped", "dead"):
        pytest.skip("a jump of radians, which test_slip.py is about")
    estimate = AccelerationObserver(robot).run(failing(log, signal, channel, kind))
    off = (np.abs(estimate.q - Estimate.read(truth).q) > 3 * estimate.q_std).any(axis=1)
    silent = (off & (estimate.status == Status.GOOD)).mean()
    assert silent <= 0.02, silent
    if kind in ("stuck", "dead") and signal != "theta":
        assert (estimate.status[1420:] & Status.FAULTY).all()
    assert not estimate.status[:1300].any()


@pytest.mark.parametrize("step", [0.0, 0.05])
@pytest.mark.parametrize("name", ["arm2_square", "kr15_six_axes"])
def test_a_commanded_torque_may_stay_what_it_is_at_rest(name, step):
    """From one posture to another by torques without noise, which then hold gravity, the same in every row."""
    robot, log, _ = load(name)
    motion = rest_to_rest([log.theta[0], log.theta[0] + 0.3], duration=0.6, period=log.period).held(0.1, 1.0)
    wanted, rng = inverse_dynamics(robot, motion), np.random.default_rng(0)
    noise = np.concatenate([np.full(len(s.axes), s.noise_std) for s in robot.accelerometers])
    force = robot.specific_force(motion.q, motion.dq, motion.ddq)
    resolution = robot.config.encoder.resolution
    signals = {
        "theta": np.round(wanted.theta / resolution) * resolution,
        "tau": np.round(wanted.tau / step) * step if step else wanted.tau,
        "acceleration": force + noise * rng.standard_normal(force.shape),
    }
    columns = {c: x for s, values in signals.items() for c, x in zip(log.columns(s), values.T, strict=True)}
    recording = Log.from_table({"t": motion.t - motion.t[0]} | columns, robot, check=False)
    assert not AccelerationObserver(robot).run(recording).status.any()


def test_torques_in_another_unit_are_in_the_deviations():
    """Torques of the motor shaft: the spring seems to hold nothing, and masses say that it does."""
    robot, log, truth = load("arm2_square")
    estimate = AccelerationObserver(robot).run(dataclasses.replace(log, tau=log.tau / 160))
    ratio = np.abs(estimate.q - Estimate.read(truth).q) / estimate.q_std
    assert (ratio > 3).any(axis=1)[100:].mean() <= 0.05
    assert 0.5 < np.median(ratio) < 1.5


# The ultimate bound


drives = st.fixed_dictionaries(
    {"stiffness": st.floats(1e3, 1e6), "damping": st.floats(0, 300), "motor_inertia": st.floats(0.3, 100)}
)


def responses(observer, robot, signal, count=700):
    """Link position and velocity after a unit in one sample of a signal, by the observer itself (rows, 2)."""
    zero = {
        "t": np.arange(count) * 1e-3,
        "theta_a": np.zeros(count),
        "tau_a": np.zeros(count),
        "ddq_a": np.zeros(count),
    }
    pulse = np.zeros(count)
    pulse[20] = 1e-3
    estimate = observer.run(Log.from_table(zero | {signal: pulse}, robot, check=False))
    return 1e3 * np.stack([estimate.q[:, 0], estimate.dq[:, 0]], axis=1)


@settings(max_examples=15, deadline=None)
@given(drive=drives, frequency=st.floats(60, 1500), form=st.sampled_from(["current", "predictor"]), bias=st.booleans())
def test_the_bound_is_what_the_observer_does_at_worst(drive, frequency, form, bias):
    """The sum of its own responses without signs, which a disturbance of those signs reaches."""
    robot = one_joint(**drive)
    settings = {"form": form, "bias": bias, "accelerations": "joints", "period": 1e-3, "start": "rest", "std": False}
    observer = AccelerationObserver(robot, frequency, **settings)
    bound = observer.bound()
    for size, signal in ((bound.theta, "theta_a"), (bound.acceleration, "ddq_a")):
        found = np.abs(responses(observer, robot, signal)).sum(axis=0)
        np.testing.assert_allclose(size[0], found, rtol=1e-6)
    held = np.abs(responses(observer, robot, "tau_a")).sum(axis=0)
    assert (bound.torque[0] >= held * (1 - 1e-9)).all()
    assert (bound.torque[0] <= held * (1.05 + 0.5 * frequency * 1e-3)).all()


def test_the_bound_adds_up_and_is_never_exceeded():
    robot = one_joint()
    settings = {"accelerations": "joints", "period": 1e-3, "start": "rest", "std": False}
    observer = AccelerationObserver(robot, 250, **settings)
    sizes = {"torque": 30.0, "acceleration": 0.5, "theta": 1e-5}
    bound = observer.bound(**sizes)
    parts = [observer.bound(**{name: size}) for name, size in sizes.items()]
    assert bound.q == pytest.approx(sum(part.q for part in parts), rel=1e-12)
    rng, count = np.random.default_rng(0), 4000
    signs = np.sign(rng.standard_normal((3, count // 25))).repeat(25, axis=1)
    columns = dict(zip(("tau_a", "ddq_a", "theta_a"), signs * np.array(list(sizes.values()))[:, None], strict=True))
    estimate = observer.run(Log.from_table({"t": np.arange(count) * 1e-3} | columns, robot, check=False))
    assert np.abs(estimate.q[200:]).max() <= bound.q[0]
    assert np.abs(estimate.q[200:]).max() > 0.2 * bound.q[0]
    assert np.abs(estimate.dq[200:]).max() <= bound.dq[0]


def test_what_a_bound_cannot_be_of_is_refused():
    observer = AccelerationObserver(one_joint(), accelerations="joints")
    with pytest.raises(EstimatorError, match="bound needs the sampling period"):
        observer.bound(torque=1.0)
    with pytest.raises(EstimatorError, match="torque has 2 entries, expected 1"):
        observer.bound(torque=[1.0, 2.0], period=1e-3)
