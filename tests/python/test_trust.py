"""Tolerances that count in standard deviations, and readings that contradict the model."""

from dataclasses import replace
from itertools import groupby
from typing import Any

import numpy as np
import pytest

from linkside import (
    ElasticJointFilter,
    ElasticJointSmoother,
    Estimate,
    ExtendedKalmanFilter,
    Log,
    Noise,
    RauchTungStriebelSmoother,
    Robot,
    demo,
)
from linkside._core import largest_nis
from linkside.cli import main
from linkside.control.controllers import JointPD
from linkside.recording.estimate import Status
from linkside.simulation import Sensor, simulate

from .robots import ARM, DATA, spring

ROWS = 1200
SQUARE = DATA / "arm2_square"
ESTIMATORS = [ExtendedKalmanFilter, RauchTungStriebelSmoother, ElasticJointFilter, ElasticJointSmoother]


@pytest.fixture(scope="module")
def robot() -> Robot:
    return Robot.load(SQUARE / "robot.yaml")


@pytest.fixture(scope="module")
def log(robot: Robot) -> Log:
    return Log.read(SQUARE / "log.parquet", robot)[:ROWS]


@pytest.fixture(scope="module")
def clean(robot: Robot, log: Log) -> Any:
    return ExtendedKalmanFilter(robot).run(log)


def spoiled(log: Log, signal: str, channel: int, fault: str, row: int) -> Log:
    """A log with a fault in one channel from a row on."""
    values = getattr(log, signal).copy()
    x = values[:, channel]
    after = {
        "wrap": x[row:] - 2 * np.pi,
        "step": x[row:] + (1e-3 if signal == "theta" else 1.0),
        "stuck": np.full(len(x) - row, x[row - 1]),
        "flipped": -x[row:],
        "gain": 1.2 * x[row:],
        "dead": np.zeros(len(x) - row),
    }
    values[row:, channel] = after[fault]
    return replace(log, **{signal: values})


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_tolerances_do_not_change_the_estimate(robot: Robot, log: Log, estimator: Any) -> None:
    with_them, without = (estimator(robot, tolerances=t).run(log[:400]) for t in (True, False))
    np.testing.assert_array_equal(with_them.q, without.q)
    np.testing.assert_array_equal(with_them.tool_position, without.tool_position)
    assert (with_them.q_std >= without.q_std).all()


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_a_wrong_model_is_within_its_standard_deviations(estimator: Any) -> None:
    """Stiffness, masses, damping and payload of this recording are not those of robot.yaml."""
    folder = DATA / "arm2_square_mismatch"
    robot = Robot.load(folder / "robot.yaml")
    log, truth = Log.read(folder / "log.parquet", robot)[:ROWS], Estimate.read(folder / "truth.parquet")[:ROWS]
    honest, naive = (estimator(robot, tolerances=t).run(log) for t in (True, False))
    ratio, before = (np.abs(e.q - truth.q) / e.q_std for e in (honest, naive))
    assert (ratio > 3).any(axis=1).mean() < 0.1
    assert (before > 3).any(axis=1).mean() > 0.9  # the error is the same: only what is said of it differs
    doubtful = (ratio > 3).any(axis=1) & (honest.status == Status.GOOD)
    assert doubtful.mean() < 0.02


def test_standard_deviations_are_those_of_the_parameters_effect(robot: Robot, log: Log) -> None:
    """Motor readings alone teach nothing of a spring, so that q_std² is P + Σ² std², with Σ by two true robots."""
    yaml = robot.config.model_dump()
    settings = {k: v for k, v in yaml.items() if k not in ("joints", "urdf", "accelerometers", "columns", "tolerances")}
    tiny = dict.fromkeys(("mass_scale", "damping", "lost_motion"), 1e-12)
    share = 0.01

    def build(factor: float, **tolerances: float) -> Robot:
        joints = [{**j, "damping": 0.0} for j in yaml["joints"]]
        joints[0]["stiffness"] *= factor
        more = {"tolerances": {**tiny, **tolerances, "calibrated": {"stiffness_axis3": 1e-12}}}
        return Robot.from_urdf(SQUARE / "robot.urdf", joints, **settings, **more)

    noise = Noise(jerk=1e3)
    nominal = build(1.0, stiffness=share)
    errors = []
    for factor in (np.exp(share / 2), np.exp(-share / 2)):
        true = build(factor)
        t, q = log.t[:300], log.qref[:300]
        ddq, dq = log.ddqref[:300], log.dqref[:300]
        torque = true.inverse_dynamics(q, dq, ddq)
        theta = q + torque / np.array([d.stiffness for d in true.drives])
        data = replace(log[:300], t=t, theta=theta, acceleration=None, dtheta=None)
        naive = ExtendedKalmanFilter(nominal, noise, start="rest", damping=False, tolerances=False).run(data)
        errors.append(np.stack([q - naive.q, dq - naive.dq]))
    slope, speed = (errors[0] - errors[1]) / share
    inertia = np.array([np.diag(nominal.mass_matrix(at)) for at in q])
    swing = np.sqrt(inertia / [d.stiffness for d in nominal.drives])
    total = ExtendedKalmanFilter(nominal, noise, start="rest", damping=False).run(data)
    plain = ExtendedKalmanFilter(nominal, noise, start="rest", damping=False, tolerances=False).run(data)
    effect = np.sqrt(total.q_std**2 - plain.q_std**2) / share
    # Whatever the phase of a vibration: a link's velocity over its frequency counts beside its position, and takes a
    # period to fall to 1/e.
    expected = np.hypot(slope, swing * speed)
    for row in range(1, len(expected)):
        fallen = expected[row - 1] / np.sqrt(1 + log.period / (np.pi * swing[row]))
        expected[row] = np.maximum(expected[row], fallen)
    np.testing.assert_allclose(effect[50:], expected[50:], rtol=0.05, atol=0.03 * expected.max())


def test_correct_data_raise_no_flag(clean: Any) -> None:
    assert clean.findings == ()
    assert (clean.status == Status.GOOD).all()
    assert clean.nis.sum() < largest_nis(int(clean.used.sum()))


FAULTS = [("theta", c, f) for c in (0, 1) for f in ("wrap", "step", "stuck", "flipped", "gain", "dead")]
FAULTS += [("acceleration", c, f) for c in (0, 2) for f in ("step", "stuck", "flipped", "dead")]


@pytest.mark.parametrize(("signal", "channel", "fault"), FAULTS)
def test_a_fault_is_named_within_50_ms(
    robot: Robot, log: Log, clean: Any, signal: str, channel: int, fault: str
) -> None:
    row = 600  # in motion
    estimate = ExtendedKalmanFilter(robot).run(spoiled(log, signal, channel, fault, row)[: row + 200])
    (first, *_) = estimate.findings
    assert first.channel == log.columns(signal)[channel]
    assert (estimate.status[:row] == Status.GOOD).all()
    flagged = np.flatnonzero(estimate.status & Status.FAULTY)[0]
    assert (flagged - row) * log.period <= 0.05
    if fault in ("wrap", "flipped", "dead"):
        assert first.kind == fault
    if fault == "stuck":
        assert first.kind in ("stuck", "saturated")  # at an end of what it ever read these look the same


@pytest.mark.parametrize("channel", [0, 1, 2])
def test_a_sensor_that_repeats_itself_is_stuck_at_once(robot: Robot, log: Log, channel: int) -> None:
    """Readings with noise do not come eight times to the last bit, whatever the robot does."""
    estimate = ExtendedKalmanFilter(robot).run(spoiled(log, "acceleration", channel, "stuck", 600)[:700])
    assert estimate.findings[0].channel == log.columns("acceleration")[channel]
    assert np.flatnonzero(estimate.status & Status.FAULTY)[0] < 610


@pytest.mark.parametrize("joint", [0, 1])
def test_an_encoder_that_stays_while_its_motor_turns_is_stuck(joint: int) -> None:
    """Without a sensor on the links only the motor's velocity says so; its noise alone, at rest, does not."""
    blind = Robot.from_urdf(ARM, [spring("shoulder"), spring("elbow")], encoder={"resolution": 1e-5})
    log = moved(blind, 1.0, 1000.0, sensors={"theta": Sensor(resolution=1e-5), "dtheta": Sensor(noise=1e-3)}).log
    assert log.dtheta is not None
    row = 200 + int(np.argmax(np.abs(log.dtheta[200:, joint]) > 0.1))
    estimate = ExtendedKalmanFilter(blind).run(spoiled(log, "theta", joint, "stuck", row))
    (found,) = estimate.findings
    assert found.channel == log.columns("theta")[joint]
    assert found.kind in ("stuck", "saturated", "dead")
    assert abs(found.since - row) <= 1
    assert (estimate.status[row + 100 :] & Status.FAULTY).all()
    still = replace(log, theta=np.tile(log.theta[:1], (len(log), 1)))
    for speed in (0.0, 0.01):  # a tachometer's zero
        noise = speed + 1e-3 * np.random.default_rng(0).standard_normal(log.theta.shape)
        assert ExtendedKalmanFilter(blind).run(replace(still, dtheta=noise)).findings == ()


def test_a_coarse_accelerometer_at_rest_is_not_stuck() -> None:
    """A digit of its readings is larger than its noise: at rest they repeat for good reason."""
    sensors = [{"name": "acc", "link": "hand", "xyz": [0.02, 0.05, 0.1], "noise_std": 0.15}]
    robot = Robot.from_urdf(ARM, [spring("shoulder"), spring("elbow")], accelerometers=sensors)
    coarse = {"acceleration": Sensor(noise=0.02, resolution=0.4)}
    run = moved(robot, 1.0, 1000.0, rest=1.0, sensors=coarse)
    longest = max(len(list(group)) for _, group in groupby(run.log.acceleration[:, 0]))
    assert longest > 100
    found = ExtendedKalmanFilter(robot).run(run.log).findings
    assert not [f for f in found if f.kind in ("stuck", "saturated", "dead")]


def test_a_wrong_model_is_nobodys_fault_and_inside_its_standard_deviations() -> None:
    """Springs, masses and payload of this recording are off; each of its sensors is as it should be."""
    folder = DATA / "arm2_square_mismatch"
    robot = Robot.load(folder / "robot.yaml")
    log = Log.read(folder / "log.parquet", robot)
    truth = Estimate.read(folder / "truth.parquet")
    for method in (ExtendedKalmanFilter, ElasticJointFilter):
        estimate = method(robot).run(log)
        assert [f.channel for f in estimate.findings if f.channel is not None] == []
        assert (np.abs(estimate.q - truth.q[: len(log)]) < 1.5 * estimate.q_std).all()


def test_torque_noise_of_motors_behind_rigid_drives_is_no_contradiction() -> None:
    """It is acceleration at once, of light links many times the noise of an accelerometer."""
    robot = Robot.load(demo.ROBOT)
    estimate = ElasticJointFilter(robot).run(Log.read(demo.LOG, robot))
    assert estimate.findings == ()
    assert (estimate.status == Status.GOOD).all()
    assert estimate.nis.sum() < estimate.used.sum()


def test_a_start_at_rest_contains_what_the_springs_hold() -> None:
    """The first row's standard deviation is a third of what three tolerances of the spring do to its torsion."""
    sensors = [{"name": "acc", "link": "hand", "noise_std": 0.05}]
    tiny = dict.fromkeys(("mass_scale", "damping", "lost_motion"), 1e-9)
    robot = Robot.from_urdf(ARM, [spring("shoulder"), spring("elbow")], accelerometers=sensors, tolerances=tiny)
    q = np.array([0.9, 0.6])
    torsion = robot.gravity_torque(q) / 1e4
    rows = {"t": 1e-3 * np.arange(20)} | {
        f"theta_{n}": np.full(20, q[i] + torsion[i]) for i, n in enumerate(robot.names)
    }
    still = robot.specific_force(q, 0 * q, 0 * q)
    rows |= {name: np.full(20, value) for name, value in zip(robot.acceleration_channels, still, strict=True)}
    estimate = ExtendedKalmanFilter(robot, Noise(transmission=1e-6)).run(Log.from_table(rows, robot))
    third = np.expm1(3 * 0.2) / 3
    np.testing.assert_allclose(estimate.q_std[0], third * np.abs(torsion), rtol=0.1)
    np.testing.assert_allclose(estimate.q_std[-1], third * np.abs(torsion), rtol=0.2)


def test_motor_velocities_from_steps_of_an_encoder_are_as_uncertain_as_they_are() -> None:
    """Without motor velocities the damping torque is that of motor positions, coarse and with gaps."""
    sensors = [{"name": "acc", "link": "hand", "xyz": [0.02, 0.05, 0.1], "noise_std": 0.05}]
    joints = [spring("shoulder", damping=20.0), spring("elbow", damping=20.0)]
    robot = Robot.from_urdf(ARM, joints, accelerometers=sensors, encoder={"resolution": 1e-4}, tool={"link": "hand"})
    run = moved(robot, 4.0, 1000.0)
    theta = run.log.theta.copy()
    theta[1:][np.random.default_rng(1).random(theta[1:].shape) < 0.1] = np.nan
    log = replace(run.log, theta=theta, dtheta=None)
    estimate = ExtendedKalmanFilter(robot, tolerances=False).run(log)
    ratio = np.abs(estimate.q - run.truth["q"]) / estimate.q_std
    assert (ratio > 4).any(axis=1).mean() < 0.01
    assert estimate.findings == ()


def moved(robot: Robot, duration: float, rate: float, *, rest: float = 0.0, **settings: Any) -> Any:
    """A robot that goes from one random posture to the next for so long, and rests."""
    rng = np.random.default_rng(0)
    times = np.arange(0.2, duration, 0.4)
    theta = 0.15 * rng.normal(size=(len(times), robot.n))
    theta[0] = 0.0
    start = np.zeros(robot.n)
    inertia = np.diag(robot.mass_matrix(start))
    tau = robot.gravity_torque(start)
    control = JointPD(kp=100 * inertia, kd=14 * inertia, times=times, theta=list(theta), tau=tau)
    return simulate(robot, control, duration + rest, rate, substeps=2, q=start, seed=1, **settings)


@pytest.mark.parametrize("duration", [20.0, pytest.param(400.0, marks=pytest.mark.slow)])
def test_errors_and_their_standard_deviations_stay_in_proportion(robot: Robot, duration: float) -> None:
    """With all biases: they wander no further than they may, and the estimate does not follow them away."""
    run = moved(robot, duration, 2000.0)
    ekf = ExtendedKalmanFilter(robot, Noise(jerk=500.0), tolerances=False)
    pieces = list(ekf.run_pieces(run.log[i : i + 20_000] for i in range(0, len(run.log), 20_000)))
    q, std = (np.concatenate([getattr(p, name) for p in pieces]) for name in ("q", "q_std"))
    errors = q - run.truth["q"]
    late = slice(-20_000, None)
    assert 0.2 < np.sqrt(np.mean((errors[late] / std[late]) ** 2)) < 1.5
    assert (np.abs(errors[late].mean(axis=0)) < 0.3 * std[-1]).all()
    assert pieces[-1].findings == ()


@pytest.mark.parametrize("estimator", [ExtendedKalmanFilter, RauchTungStriebelSmoother])
@pytest.mark.parametrize("every", [4, 20, 40])
@pytest.mark.filterwarnings("ignore::linkside.errors.RecordingWarning")
def test_errors_and_their_standard_deviations_are_in_proportion_at_any_rate(estimator: Any, every: int) -> None:
    """One row in so many, the others cut out or there without readings: constant offsets are no filter's to see."""
    robot = Robot.load(demo.ROBOT)
    whole, truth = Log.read(demo.LOG, robot), Estimate.read(demo.TRUTH).q[:, :3]
    rows = np.arange(len(whole)) % every == 0
    columns = dict(zip(whole.columns("theta"), whole.theta.T, strict=True))
    columns |= dict(zip(whole.columns("acceleration"), whole.acceleration.T, strict=True))
    cut = {"t": whole.t[rows]} | {name: values[rows] for name, values in columns.items()}
    bare = {"t": whole.t} | {name: np.where(rows, values, np.nan) for name, values in columns.items()}
    for data, seen in ((cut, slice(None)), (bare, rows)):
        estimate = estimator(robot, tolerances=False).run(Log.from_table(data, robot))
        error = estimate.q[seen, :3] - truth[rows]
        error -= error.mean(axis=0)
        assert 0.3 < np.sqrt(np.mean((error / estimate.q_std[seen, :3]) ** 2)) < 2
        assert not (estimate.status & Status.CONTRADICTED).any()


def test_pieces_and_steps_judge_as_the_run_does(robot: Robot, log: Log) -> None:
    bad = spoiled(log, "acceleration", 0, "flipped", 600)[:800]
    noise = Noise(jerk=1e3)
    whole = ExtendedKalmanFilter(robot, noise).run(bad)
    pieces = list(ExtendedKalmanFilter(robot, noise).run_pieces([bad[:500], bad[500:]]))
    np.testing.assert_array_equal(np.concatenate([p.status for p in pieces]), whole.status)
    assert pieces[-1].findings == whole.findings
    live = ExtendedKalmanFilter(robot, noise, damping=False)
    for row in range(620):
        live.step(dt=bad.period, theta=bad.theta[row], acceleration=bad.acceleration[row])
    assert live.status & Status.FAULTY
    smoothed = RauchTungStriebelSmoother(robot, noise).run(bad)
    np.testing.assert_array_equal(smoothed.status, whole.status)


def test_the_command_line_says_which_channel_and_strict_fails(robot: Robot, log: Log, tmp_path: Any) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = pq.read_table(SQUARE / "log.parquet").slice(0, 900)
    bad = table["tool_acc_x"].to_numpy().copy()
    bad[600:] *= 1.3  # nothing that a look at the readings alone would tell
    table = table.set_column(table.column_names.index("tool_acc_x"), "tool_acc_x", pa.array(bad))
    pq.write_table(table, tmp_path / "log.parquet")
    out = tmp_path / "estimate.parquet"
    arguments = [
        "estimate",
        str(SQUARE / "robot.yaml"),
        str(tmp_path / "log.parquet"),
        "--with",
        "ekf",
        "--out",
        str(out),
    ]
    for extra, status in ([], 0), (["--strict"], 3):
        with pytest.raises(SystemExit) as stop:
            main.main([*arguments, *extra])
        assert (stop.value.code or 0) == status
    written = Estimate.read(out)
    assert written.nis is not None
    assert (written.status & Status.FAULTY).any()


@pytest.mark.parametrize("estimator", ESTIMATORS)
@pytest.mark.parametrize("joint", [0, 1])
def test_a_start_that_was_fitted_to_contradictions_is_not_good(
    robot: Robot, log: Log, estimator: Any, joint: int
) -> None:
    """A motor's shaft taken for its link: each row is wrong, also those before the contradiction is large enough."""
    theta = log.theta[:400].copy()
    theta[:, joint] *= 160
    estimate = estimator(robot).run(replace(log[:400], theta=theta))
    contradicted = estimate.status & Status.CONTRADICTED > 0
    assert contradicted[:32].all()
