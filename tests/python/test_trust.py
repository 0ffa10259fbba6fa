"""Tolerances that count in standard deviations, and readings that contradict the model."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from linkside import Estimate, ExtendedKalmanFilter, Log, Noise, RauchTungStriebelSmoother, Robot
from linkside.cli.commands import main
from linkside.findings import largest_nis
from linkside.recording.estimate import Status

from .robots import DATA

ROWS = 1200
SQUARE = DATA / "arm2_square"


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


@pytest.mark.parametrize("estimator", [ExtendedKalmanFilter, RauchTungStriebelSmoother])
def test_tolerances_do_not_change_the_estimate(robot: Robot, log: Log, estimator: Any) -> None:
    with_them, without = (estimator(robot, tolerances=t).run(log[:400]) for t in (True, False))
    np.testing.assert_array_equal(with_them.q, without.q)
    np.testing.assert_array_equal(with_them.tool_position, without.tool_position)
    assert (with_them.q_std >= without.q_std).all()


@pytest.mark.parametrize("estimator", [ExtendedKalmanFilter, RauchTungStriebelSmoother])
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
    tiny = dict.fromkeys(("mass_scale", "damping"), 1e-12)
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
        errors.append(q - ExtendedKalmanFilter(nominal, noise, damping=False, tolerances=False).run(data).q)
    slope = (errors[0] - errors[1]) / share
    total = ExtendedKalmanFilter(nominal, noise, damping=False).run(data)
    plain = ExtendedKalmanFilter(nominal, noise, damping=False, tolerances=False).run(data)
    effect = np.sqrt(total.q_std**2 - plain.q_std**2) / share
    np.testing.assert_allclose(effect[50:], np.abs(slope)[50:], rtol=0.02, atol=0.03 * np.abs(slope).max())


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
