"""Trackers: what they read, what they teach, and where they stand."""

import dataclasses
from contextlib import suppress

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from linkside import (
    ConfigError,
    ElasticJointFilter,
    ElasticNoise,
    EstimatorError,
    ExtendedKalmanFilter,
    Log,
    MotorJerkFilter,
    Noise,
    RauchTungStriebelSmoother,
    Robot,
    Status,
)
from linkside.calibration import align_tracker, calibrate
from linkside.cli import main
from linkside.control.controllers import JointPD
from linkside.simulation import Sensor, simulate

from .robots import ARM, spring

TURNING = ARM.replace('<axis xyz="0 1 0"/>\n    <limit lower="-3"', '<axis xyz="0 0 1"/>\n    <limit lower="-3"', 1)
"""The shoulder turns about the vertical, so that points of the hand move in space."""

PLACE = {"xyz": [1.0, 0.5, 0.2], "rpy": [0.1, -0.2, 2.0]}
LASER = {"name": "laser", "link": "hand", "xyz": [0.02, 0.03, 0.1], "place": PLACE, "noise_std": 2e-5}
MOTORS = {"theta": Sensor(noise=1e-6)}


def arm(urdf=TURNING, **laser):
    return Robot.from_urdf(urdf, [spring("shoulder"), spring("elbow")], trackers=[LASER | laser])


def moved(robot, seconds=3.0, seed=0, sensors=MOTORS):
    times = np.linspace(0, seconds, 201)
    theta = np.array([0.3, 0.9]) + 0.3 * (1 - np.cos(4 * times))[:, None] * [1, -1]
    control = JointPD(kp=2000, kd=200, times=times, theta=list(theta), tau=np.zeros(2))
    return simulate(robot, control, seconds, 500, substeps=8, q=theta[0], seed=seed, sensors=sensors)


@pytest.fixture(scope="module")
def run():
    return moved(arm())


def seen(robot, q):
    """By Pinocchio: the target in the tracker's axes."""
    model, frame = robot.model, robot.model.getFrameId("hand")
    data = model.createData()
    place = pin.SE3(pin.rpy.rpyToMatrix(*PLACE["rpy"]), np.array(PLACE["xyz"]))
    points = []
    for row in q:
        pin.framesForwardKinematics(model, data, robot.to_pinocchio(row))
        points.append(place.actInv(data.oMf[frame].act(np.array(LASER["xyz"]))))
    return np.array(points)


def test_reads_the_target_in_its_own_axes(run):
    expected = seen(arm(), run.truth["q"])
    assert run.log.columns("position") == ("laser_px", "laser_py", "laser_pz")
    error = run.log.position - expected
    assert np.abs(error).max() < 6 * LASER["noise_std"]
    assert error.std() == pytest.approx(LASER["noise_std"], rel=0.1)


@given(q=st.tuples(*[st.floats(-3, 3)] * 2), axes=st.sampled_from(["x", "yz", "xyz"]))
def test_its_derivative_is_that_of_its_reading(q, axes):
    robot = arm(axes=axes)
    deaf = Noise(transmission=1e6)  # to motors
    start = np.array([*q, 0, 0, 0, 0]), np.eye(6)
    model = ExtendedKalmanFilter(robot, deaf, biases=(), tolerances=False, start=start)
    step = 1e-6
    jacobian = np.array([(seen(robot, [np.add(q, e)]) - seen(robot, [np.subtract(q, e)]))[0] for e in step * np.eye(2)])
    rows = ["xyz".index(a) for a in axes]
    jacobian = jacobian.T[rows] / (2 * step)
    log = Log.from_table(
        {"t": [0.0, 0.01], "theta_shoulder": [0.0, 0.0], "theta_elbow": [0.0, 0.0]}
        | {f"laser_p{a}": [x, np.nan] for a, x in zip(axes, seen(robot, [q])[0][rows], strict=True)},
        robot,
        check=False,
        allow_gaps=True,
    )
    found = model.run(log, covariance=True).covariance[0, :2, :2]
    information = np.eye(2) + jacobian.T @ jacobian / LASER["noise_std"] ** 2
    np.testing.assert_allclose(found, np.linalg.inv(information), rtol=1e-4, atol=1e-12)


TRUSTED = {"position_bias": 0.0, "position_bias_walk": 0.0}


@pytest.mark.parametrize(
    ("method", "noise"),
    [(ExtendedKalmanFilter, Noise), (RauchTungStriebelSmoother, Noise), (ElasticJointFilter, ElasticNoise)],
)
def test_moves_links_where_it_is_trusted(run, method, noise):
    """By default it may be off by a bias, so that wrong springs stay; without one it contradicts them."""
    robot = arm()
    bare = Robot(robot.config.model_copy(update={"trackers": ()}), robot.tree)
    settings = {"without": (bare, None), "biased": (robot, None), "trusted": (robot, noise(**TRUSTED))}
    errors = {}
    for name, (one, levels) in settings.items():
        estimate = method(one.scaled(stiffness=1.3), levels).run(run.log)
        error = np.abs(estimate.q - run.truth["q"])
        errors[name] = error.max(axis=0)
        assert name == "trusted" or (error < 3 * estimate.q_std).all()
    np.testing.assert_allclose(errors["biased"], errors["without"], rtol=0.1)
    assert errors["trusted"].sum() < 0.98 * errors["without"].sum()


@pytest.mark.parametrize("method", [ExtendedKalmanFilter, ElasticJointFilter, MotorJerkFilter])
def test_may_stand_half_a_millimetre_off(run, method):
    place = PLACE | {"xyz": [1.0004, 0.5, 0.1997]}
    estimate = method(arm(place=place)).run(run.log)
    assert not (estimate.status & Status.CONTRADICTED).any()
    assert (np.abs(estimate.q - run.truth["q"]) < 3 * estimate.q_std).all()


def test_calibrates_springs(run):
    found = calibrate(arm().scaled(stiffness=1.4), [run.log], free=["stiffness"])
    for estimated in found.estimates:
        assert estimated.value == pytest.approx(1e4, abs=3 * estimated.std)
        assert estimated.value == pytest.approx(1e4, rel=0.1)


def test_finds_where_a_tracker_stands(run):
    """Also from a place that is nothing like it."""
    found = align_tracker(arm(place={}), run.log)
    place = found.tracker.place
    turn = pin.rpy.rpyToMatrix(*place.rpy) @ pin.rpy.rpyToMatrix(*PLACE["rpy"]).T
    assert np.abs(pin.log3(turn)).max() < 4 * found.std["turn"].max() + 1e-4
    np.testing.assert_allclose(place.xyz, PLACE["xyz"], atol=2e-4)
    assert abs(found.delay) < 1e-4
    assert found.residual < 5e-5


def test_finds_its_delay_and_its_target():
    late = moved(arm(delay=0.012))
    found = align_tracker(arm(place={}, xyz=[0.0, 0.03, 0.15]), late.log, "laser", ["place", "delay", "xyz"])
    assert found.tracker.delay == pytest.approx(0.012, abs=2e-4)
    np.testing.assert_allclose(found.tracker.xyz[:2], LASER["xyz"][:2], atol=2e-3)


def test_early_readings_are_not_called_late(run):
    log, early = run.log, {"t": run.log.t[10:-10]}
    for signal, rows in (("theta", slice(10, -10)), ("position", slice(20, None))):
        early |= dict(zip(log.columns(signal), getattr(log, signal)[rows].T, strict=True))
    with pytest.raises(EstimatorError, match=r"is 2\d(\.\d)? ms early: its clock is ahead"):
        align_tracker(arm(place={}), Log.from_table(early, arm(), check=False))


@pytest.mark.parametrize(
    ("made", "words"),
    [
        (1e3 * np.eye(3), "do not follow the target"),
        (np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0.5]]), "do not follow the target"),
        (np.diag([1, 1, -1]), "left-handed"),
        (-np.eye(3), "left-handed"),
        (np.nan * np.eye(3), "no row has readings"),
    ],
    ids=["millimetres", "skew", "one sign", "all signs", "none"],
)
def test_readings_of_something_else_are_refused(run, made, words):
    with pytest.raises(EstimatorError, match=words):
        align_tracker(arm(place={}), dataclasses.replace(run.log, position=run.log.position @ made))


@pytest.mark.parametrize("rows", [12, 60, 150])
def test_a_short_recording_is_aligned_or_refused_in_words(run, rows):
    with suppress(EstimatorError):
        assert align_tracker(arm(place={}), run.log[300 : 300 + rows]).residual < 1e-4


@pytest.mark.parametrize("rows", [slice(0, 110), slice(1400, 1501), slice(750, 757)])
def test_readings_in_a_part_alone_are_aligned_or_refused_in_words(run, rows):
    seen = np.full_like(run.log.position, np.nan)
    seen[rows] = run.log.position[rows]
    with suppress(EstimatorError):
        assert align_tracker(arm(place={}), dataclasses.replace(run.log, position=seen)).residual < 1e-4


def test_a_motion_along_a_line_does_not_tell_axes():
    robot = arm()
    t = 0.002 * np.arange(500)
    still = {"theta_shoulder": np.full(500, 0.3), "theta_elbow": np.full(500, 0.9)}
    readings = np.tile(seen(robot, [[0.3, 0.9]]), (500, 1))
    log = Log.from_table({"t": t} | still | {f"laser_p{a}": readings[:, i] for i, a in enumerate("xyz")}, robot)
    with pytest.raises(EstimatorError, match="moves along a line at most"):
        align_tracker(robot, log)


@pytest.mark.parametrize(
    ("robot", "settings", "words"),
    [
        (arm(axes="xy"), {}, "records xy; its place takes all three axes"),
        (arm(), {"name": "camera"}, "no tracker 'camera'; the robot has laser"),
        (arm(), {"free": ["scale"]}, "free: 'scale' is not one of"),
    ],
)
def test_refuses(run, robot, settings, words):
    with pytest.raises(EstimatorError, match=words):
        align_tracker(robot, run.log, **settings)


def test_a_link_that_is_none_is_refused():
    with pytest.raises(ConfigError, match=r"trackers\[0\].*no link 'paw'"):
        arm(link="paw")


def test_command_line(run, tmp_path, capsys):
    (tmp_path / "robot.urdf").write_text(TURNING)
    (tmp_path / "robot.yaml").write_text(
        "urdf: robot.urdf\n"
        "joints:\n- {name: shoulder, stiffness: 10000, damping: 5, motor_inertia: 1.5}\n"
        "- {name: elbow, stiffness: 10000, damping: 5, motor_inertia: 1.5}\n"
        "trackers:  # in the hall\n- {name: laser, link: hand, xyz: [0.02, 0.03, 0.1], noise_std: 2.0e-5}\n"
    )
    run.log.write(tmp_path / "log.parquet")
    out = tmp_path / "robot.aligned.yaml"
    with pytest.raises(SystemExit) as end:
        main(["align", str(tmp_path / "robot.yaml"), str(tmp_path / "log.parquet"), "--out", str(out)])
    assert not end.value.code
    assert "laser: 0.0" in capsys.readouterr().out
    assert "# in the hall" in out.read_text()
    np.testing.assert_allclose(Robot.load(out).trackers[0].place.xyz, PLACE["xyz"], atol=2e-4)
