"""Recordings with a mistake are refused, put right or warned of; recordings without are left alone."""

import warnings
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

import linkside
from linkside import ExtendedKalmanFilter, Log, LogError, RecordingWarning, Robot, Sensor, demo, inspect, simulate

from .robots import build_model

DATA = Path(__file__).parents[1] / "data"
ROBOT = Robot.load(demo.ROBOT)
TABLE = pq.read_table(demo.LOG).to_pandas()
THETA = [f"theta_{name}" for name in ROBOT.names]
TAU = [f"tau_{name}" for name in ROBOT.names]
ACC = list(ROBOT.acceleration_channels)
ROW = 900
UNEVEN = TABLE.t + 5e-5 * np.random.default_rng(0).uniform(-1, 1, len(TABLE))


def scaled(columns, factor):
    return TABLE.assign(**{c: TABLE[c] * factor for c in columns})


def after(column, values):
    """A column that is something else from `ROW` on."""
    return TABLE.assign(**{column: np.where(TABLE.index >= ROW, values, TABLE[column])})


REFUSED = {
    "degrees": (scaled(THETA, 180 / np.pi), "theta_a3", "degrees"),
    "motor shaft": (scaled(THETA, ROBOT.gear_ratio[0]), "theta_a3", "motor"),
    "g": (scaled(ACC, 1 / 9.80665), "acc_link4_x", "multiply by 9.80665"),
    "sign of all": (scaled(ACC, -1), "acc_link4_x", "sign turned"),
    "sign of one": (scaled(ACC[:1], -1), "acc_link4_x", "acc_link4_x alone"),
    "sentinel": (TABLE.assign(tau_a1=np.where(TABLE.index == ROW, -9999.0, TABLE.tau_a1)), "tau_a1", f"row {ROW} "),
    "huge": (TABLE.assign(tau_a1=np.where(TABLE.index == ROW, 1e30, TABLE.tau_a1)), "tau_a1", f"row {ROW} "),
    "joined": (after("theta_a1", TABLE.theta_a1 - 0.4), "theta_a1", f"row {ROW} "),
    "float32": (TABLE.assign(t=(TABLE.t + 3000).astype("float32")), "t", "32 bits"),
}

WARNED = {
    "rate": (TABLE.assign(t=2 * TABLE.t), "t", "rate"),
    "uneven": (TABLE.assign(t=UNEVEN), "t", "uneven"),
    "stuck": (after("acc_link4_x", TABLE.acc_link4_x[ROW]), "acc_link4_x", "stuck"),
    "dead": (TABLE.assign(acc_link4_x=0.0), "acc_link4_x", "dead"),
    "saturated": (TABLE.assign(acc_link4_x=TABLE.acc_link4_x.clip(-8.7, 8)), "acc_link4_x", "saturated"),
    "held": (TABLE.assign(acc_link4_y=np.repeat(TABLE.acc_link4_y.to_numpy()[::8], 8)), "acc_link4_y", "held"),
    "axes": (TABLE.assign(acc_link4_x=TABLE.acc_link4_y, acc_link4_y=TABLE.acc_link4_x), "acc_link4_x", "axes"),
    "torque sign": (scaled(TAU, -1), "tau_a2", "torque sign"),
    "torque side": (scaled(TAU, 1 / ROBOT.gear_ratio[0]), "tau_a2", "torque side"),
    "velocity": (scaled(["dtheta_a1"], 180 / np.pi), "dtheta_a1", "velocity"),
    "limits": (scaled(["theta_a6"], 1).assign(theta_a6=TABLE.theta_a6 + 7), "theta_a6", "limits"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_is_impossible_is_refused_by_column_with_a_remedy(what):
    table, column, words = REFUSED[what]
    with pytest.raises(LogError, match=words) as refused:
        Log.from_table(table, ROBOT)
    assert f"column '{column}'" in str(refused.value)
    assert "\n" not in str(refused.value)
    assert any(f.verdict == "refused" and f.column == column for f in inspect(taken(table), ROBOT))
    assert Log.from_table(table, ROBOT, check=False).findings == ()


@pytest.mark.parametrize("what", WARNED)
def test_what_is_suspicious_is_warned_of(what):
    table, column, kind = WARNED[what]
    with pytest.warns(RecordingWarning) as said:
        log = Log.from_table(table, ROBOT)
    assert [str(one.message) for one in said] == [f"table: {found}" for found in log.findings]
    assert (column, kind) in {(f.column, f.kind) for f in log.findings}
    assert all(f.verdict == "suspicious" for f in log.findings)


def test_samples_that_were_taken_at_uneven_times_are_none_of_an_uneven_clock():
    moved = {column: np.interp(UNEVEN, TABLE.t, TABLE[column]) for column in THETA}
    assert inspect(taken(TABLE.assign(t=UNEVEN, **moved)), ROBOT) == ()
    (found,) = inspect(taken(TABLE.assign(t=UNEVEN)), ROBOT)
    assert found.kind == "uneven"
    assert found.size == pytest.approx(5e-5 / np.sqrt(3), rel=0.05)


def taken(table):
    return Log.from_table(table, ROBOT, check=False)


def test_a_stuck_channel_is_said_with_its_first_row_and_time():
    with pytest.warns(RecordingWarning, match="stuck"):
        log = Log.from_table(WARNED["stuck"][0], ROBOT)
    (found,) = log.findings
    assert (found.row, found.time, found.size) == (ROW, TABLE.t[ROW], TABLE.acc_link4_x[ROW])


@pytest.mark.parametrize("rows", [None, 100, 901, 4096])
def test_an_encoder_that_wraps_is_put_right_whole_or_in_pieces(tmp_path, rows):
    turned = TABLE.assign(theta_a1=np.where((TABLE.index >= ROW) & (TABLE.index < 1500), 0, 2 * np.pi) + TABLE.theta_a1)
    turned.to_parquet(tmp_path / "log.parquet")
    stream = Log.stream(tmp_path / "log.parquet", ROBOT, rows or len(TABLE))
    with pytest.warns(RecordingWarning, match=rf"column 'theta_a1' wraps by 6\.28319.*row {ROW} "):
        logs = list(stream)
    theta = np.concatenate([log.theta[:, 0] for log in logs])
    np.testing.assert_allclose(theta - 2 * np.pi, TABLE.theta_a1, atol=1e-12)
    assert [f.verdict for f in logs[-1].findings] == ["mended"]


def test_a_motor_shaft_that_wraps_is_put_right():
    turn = 2 * np.pi / abs(ROBOT.gear_ratio[0])
    start = np.floor(TABLE.theta_a1[0] / turn) * turn
    with pytest.warns(RecordingWarning, match="motor shaft") as warned:
        log = Log.from_table(TABLE.assign(theta_a1=np.mod(TABLE.theta_a1, turn) + start), ROBOT)
    np.testing.assert_allclose(log.theta[:, 0], TABLE.theta_a1, atol=1e-12)
    assert len(warned) == 1


@pytest.mark.parametrize(("unit", "factor"), [("milliseconds", 1e3), ("microseconds", 1e6), ("nanoseconds", 1e9)])
def test_a_time_in_another_unit_is_read_as_such(tmp_path, unit, factor):
    table = TABLE.assign(t=(TABLE.t * factor).round(6).astype("int64" if factor > 1e3 else float))
    with pytest.warns(RecordingWarning, match=f"is in {unit}"):
        log = Log.from_table(table, ROBOT)
    np.testing.assert_allclose(log.t, TABLE.t, rtol=1e-12)
    assert log.period == pytest.approx(0.0005)
    table.to_csv(tmp_path / "log.csv", index=False)
    with pytest.warns(RecordingWarning, match=f"is in {unit}"):
        pieces = list(Log.stream(tmp_path / "log.csv", ROBOT, 777))
    np.testing.assert_allclose(np.concatenate([piece.t for piece in pieces]), TABLE.t, rtol=1e-12)


def test_after_mending_the_filter_is_as_right_as_without_the_mistake():
    spoilt = after("theta_a1", TABLE.theta_a1 - 2 * np.pi).assign(t=TABLE.t * 1e3)
    with pytest.warns(RecordingWarning):
        log = Log.from_table(spoilt, ROBOT)
    filter = ExtendedKalmanFilter(ROBOT)
    np.testing.assert_allclose(filter.run(log).q, filter.run(Log.read(demo.LOG, ROBOT)).q, atol=1e-9)


@pytest.mark.parametrize("folder", ["arm2_square", "arm2_square_mismatch", "kr15_long", "kr15_six_axes"])
@pytest.mark.parametrize("rows", [None, 500, 2000])
def test_recordings_without_a_mistake_are_left_alone(folder, rows):
    robot, path = Robot.load(DATA / folder / "robot.yaml"), DATA / folder / "log.parquet"
    if not path.exists():
        pytest.skip("no recording")
    *_, log = [Log.read(path, robot)] if rows is None else Log.stream(path, robot, rows)
    assert log.findings == ()
    assert inspect(log, robot) == ()


@pytest.mark.parametrize("seed", range(16))
def test_simulated_recordings_of_any_robot_are_left_alone(seed):
    """Turning and sliding joints, at rest, slow, noisy, without noise; nothing is wrong with them."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 8))
    model = build_model(list(range(n)), rng.integers(0, 6, n).tolist(), rng)
    model.gravity.linear = np.array([0, 0, -9.81])
    drives = [
        {
            "name": f"joint{i}",
            "stiffness": float(10 ** rng.uniform(3.5, 5)),
            "damping": float(rng.uniform(1, 50)),
            "motor_inertia": float(rng.uniform(0.5, 5)),
            "gear_ratio": float(rng.choice([1, 50, 160, -100])),
            "motor_friction": {"viscous": 5.0, "coulomb": float(rng.choice([0, 3.0]))},
        }
        for i in range(n)
    ]
    sensor = {"link": f"link{int(rng.integers(0, n))}", "xyz": rng.uniform(-0.3, 0.3, 3), "rpy": rng.uniform(-3, 3, 3)}
    robot = Robot.from_pinocchio(
        model, drives, accelerometers=[{"name": "acc", "noise_std": float(rng.choice([0.005, 0.05, 1.0])), **sensor}]
    )
    frequency, swing = rng.uniform(0.5, 6, n), rng.uniform(0.01, 0.5, n) * (seed % 4 != 1)
    start = rng.uniform(-1, 1, n)

    def controller(t, state):
        wanted = start + swing * (1 - np.cos(frequency * t))
        speed = swing * frequency * np.sin(frequency * t)
        return robot.gravity_torque(state.theta) + 300 * (wanted - state.theta) + 60 * (speed - state.dtheta)

    noise = {2: {"theta": Sensor(noise=1e-3), "dtheta": Sensor(noise=0.1)}}
    noise |= {3: {"theta": Sensor(), "dtheta": Sensor(), "acceleration": Sensor()}}
    log = simulate(
        robot, controller, 0.6, 500.0, q=start, sensors=noise.get(seed % 4), integrator="adaptive", seed=seed
    ).log
    assert inspect(log, robot) == ()


def test_numbers_drawn_at_random_have_no_wraps():
    """No smooth motion, no certainty: nothing is put right."""
    rng = np.random.default_rng(0)
    table = TABLE.assign(**{c: rng.standard_normal(len(TABLE)) for c in THETA})
    assert not [f for f in inspect(taken(table), ROBOT) if f.verdict == "mended"]


def test_warnings_are_of_our_own_category():
    assert issubclass(RecordingWarning, linkside.LinksideWarning)
    assert issubclass(RecordingWarning, UserWarning)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RecordingWarning)
        Log.from_table(WARNED["rate"][0], ROBOT)


def test_missing_readings_are_not_a_mistake():
    rng = np.random.default_rng(1)
    table = pd.DataFrame({c: TABLE[c].mask(rng.random(len(TABLE)) < (c != "t") * 0.3) for c in TABLE})
    table.loc[0] = TABLE.loc[0]
    assert Log.from_table(table, ROBOT).findings == ()
