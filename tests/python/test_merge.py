"""Sensors of several clocks and rates: merged as pandas does, resampled as NumPy does, told from missing ones."""

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st

from linkside import (
    AccelerationObserver,
    Estimate,
    EstimatorError,
    ExtendedKalmanFilter,
    Log,
    LogError,
    RauchTungStriebelSmoother,
    RecordingWarning,
    Robot,
    Status,
    cli,
)
from linkside.calibration import calibrate
from linkside.kalman.stretches import smooth_pieces

FOLDER = Path(__file__).parents[1] / "data/arm2_square"
ROBOT = Robot.load(FOLDER / "robot.yaml")
WHOLE = pd.read_parquet(FOLDER / "log.parquet")
SENSOR = [column for column in WHOLE if column.startswith("tool_acc")]
MOTORS = [column for column in WHOLE if column not in SENSOR]
JOINTS, IMU = WHOLE[MOTORS].iloc[::2], WHOLE[["t", *SENSOR]].iloc[1::3]
MEASURED = [column for column in WHOLE if column != "t" and "ref" not in column]
pytestmark = pytest.mark.filterwarnings("ignore:.*robot.yaml says 2000 Hz:linkside.RecordingWarning")


def linkside(*arguments):
    return CliRunner().invoke(cli.main, list(map(str, arguments)))


def bridged(estimate):
    return (estimate.status & Status.BRIDGED) != 0


@pytest.fixture
def files(tmp_path):
    JOINTS.to_parquet(tmp_path / "joints.parquet")
    IMU.to_csv(tmp_path / "imu.csv", index=False)
    return tmp_path / "joints.parquet", tmp_path / "imu.csv"


stamps = st.lists(st.integers(0, 200), min_size=2, max_size=40, unique=True).map(sorted)


@settings(max_examples=60, deadline=None)
@given(joints=stamps, imu=stamps, early=st.floats(-4e-6, 4e-6))
def test_a_merged_table_is_that_of_pandas(joints, imu, early):
    """Stamps a hundredth of a period apart at most are the same."""
    if joints[0] >= imu[-1] or imu[0] >= joints[-1]:
        return
    a = pd.DataFrame({"t": 0.001 * np.array(joints)} | {c: np.arange(len(joints)) + 0.5 for c in MOTORS[1:5]})
    b = pd.DataFrame({"t": 0.001 * np.array(imu)} | {c: -1.0 * np.arange(len(imu)) for c in SENSOR})
    merged = Log.merge([a, b.assign(t=b.t + early)], ROBOT, check=False)
    key = {"left_on": a.t.div(0.001).round(), "right_on": b.t.div(0.001).round(), "how": "outer"}
    wanted = pd.merge(a, b, **key).sort_values("key_0")
    wanted = wanted[wanted.key_0 >= joints[0]]
    np.testing.assert_allclose(merged.t, 0.001 * wanted.key_0, rtol=0, atol=abs(early) + 1e-12)
    np.testing.assert_array_equal(merged.theta[:, 0], wanted[MOTORS[1]])
    np.testing.assert_array_equal(merged.acceleration, wanted[SENSOR])


def test_estimates_of_a_merged_recording_are_those_of_the_whole_with_its_readings_taken_out():
    sparse = WHOLE.copy()
    sparse.loc[~sparse.index.isin(JOINTS.index), MOTORS[1:7]] = np.nan
    sparse.loc[~sparse.index.isin(IMU.index), SENSOR] = np.nan
    sparse = sparse[sparse[MEASURED].notna().any(axis=1)]
    ours = Log.merge([IMU, JOINTS], ROBOT)
    theirs = Log.from_table(sparse, ROBOT, allow_gaps=True)
    for signal in ("t", "theta", "dtheta", "tau", "acceleration"):
        np.testing.assert_array_equal(getattr(ours, signal), getattr(theirs, signal))
    np.testing.assert_allclose(ours.ddqref, theirs.ddqref, rtol=0, atol=2.0)  # where it steps, a line has it in between
    estimate = ExtendedKalmanFilter(ROBOT).run(ours)
    reference = ExtendedKalmanFilter(ROBOT).run(theirs)
    assert np.abs(estimate.q - reference.q).max() < 2e-5
    truth = FOLDER / "truth.parquet"
    assert estimate.error_against(truth).tool_rms < 0.02  # [mm]; of the whole recording 0.004
    assert RauchTungStriebelSmoother(ROBOT).run(ours).error_against(truth).tool_rms < 0.008


def test_a_slow_sensor_waits_and_a_missing_one_is_bridged():
    merged = Log.merge([JOINTS, IMU], ROBOT)
    assert not bridged(ExtendedKalmanFilter(ROBOT).run(merged)).any()
    lost = IMU[(IMU.t < 0.5) | (IMU.t > 0.6)]
    cut = Log.merge([JOINTS, lost], ROBOT)
    for method in (ExtendedKalmanFilter, RauchTungStriebelSmoother):
        flagged = cut.t[bridged(method(ROBOT).run(cut))]
        due = lost.t[lost.t < 0.5].iloc[-1] + np.median(np.diff(IMU.t))
        assert flagged[0] == pytest.approx(due, abs=1e-3)
        assert flagged[-1] == pytest.approx(lost.t[lost.t > 0.6].iloc[0], abs=1.1e-3)
        assert len(flagged) == np.count_nonzero((cut.t >= flagged[0]) & (cut.t <= flagged[-1]))


def test_status_is_the_same_in_pieces(tmp_path):
    cut = Log.merge([JOINTS, IMU[(IMU.t < 0.5) | (IMU.t > 0.6)]], ROBOT)
    cut.write(tmp_path / "log.parquet")
    for rows in (97, 401):
        pieces = list(Log.stream(tmp_path / "log.parquet", ROBOT, rows))
        slices = [cut[first : first + rows] for first in range(0, len(cut), rows)]
        for parts in (pieces, slices):
            found = Estimate.concatenate(ExtendedKalmanFilter(ROBOT, start="rest").run_pieces(parts))
            smooth = Estimate.concatenate(smooth_pieces(RauchTungStriebelSmoother(ROBOT), parts))
            np.testing.assert_array_equal(bridged(found), bridged(ExtendedKalmanFilter(ROBOT).run(cut)))
            np.testing.assert_array_equal(bridged(smooth), bridged(found))


def test_a_channel_without_a_column_is_never_due_and_one_that_begins_late_is():
    truth = pd.read_parquet(FOLDER / "truth.parquet")
    table = WHOLE.iloc[:600].assign(q_axis2=truth.q_axis2)
    table.loc[:99, SENSOR] = np.nan
    estimate = ExtendedKalmanFilter(ROBOT).run(Log.from_table(table, ROBOT))
    assert "q_axis3" in estimate.channels
    assert np.flatnonzero(bridged(estimate)).tolist() == list(range(100))


def test_thinned_logs_keep_their_sensors_pace():
    merged = Log.merge([WHOLE[MOTORS], WHOLE[["t", *SENSOR]].iloc[::4]], ROBOT)
    assert not bridged(ExtendedKalmanFilter(ROBOT).run(merged[::2])).any()


@settings(max_examples=40, deadline=None)
@given(rate=st.floats(150, 4000), seed=st.integers(0, 99))
def test_resampled_channels_are_numpys(rate, seed):
    random = np.random.default_rng(seed)
    t = np.cumsum(random.uniform(5e-4, 2e-3, 200))
    table = {"t": t} | {name: random.standard_normal(200) for name in MOTORS[1:3]}
    table[MOTORS[1]][random.random(200) < 0.3] = np.nan
    table[MOTORS[1]][0] = 1.0
    log = Log.from_table(table, ROBOT, allow_gaps=True, check=False).resample(rate)
    assert np.abs(np.diff(log.t) - 1 / rate).max() < 1e-9
    assert log.period == 1 / rate
    there = ~np.isnan(table[MOTORS[1]])
    known = log.t <= t[there][-1]
    wanted = np.interp(log.t[known], t[there], table[MOTORS[1]][there])
    np.testing.assert_allclose(log.theta[known, 0], wanted, rtol=0, atol=1e-12)
    assert np.isnan(log.theta[~known, 0]).all()


def test_nothing_is_drawn_across_a_gap_and_the_observer_says_so():
    holed = JOINTS[(JOINTS.t < 0.5) | (JOINTS.t > 0.7)]
    log = Log.merge([holed, IMU], ROBOT, rate=1000)
    missing = np.isnan(log.theta).any(axis=1)
    assert log.t[missing][0] == pytest.approx(0.5, abs=2e-3)
    assert log.t[missing][-1] == pytest.approx(0.7, abs=2e-3)
    with pytest.raises(LogError, match="theta_axis2' is missing for more than"):
        AccelerationObserver(ROBOT).run(log)


def test_observer_and_calibration_say_why_not_and_take_an_even_rate():
    merged = Log.merge([JOINTS, IMU], ROBOT)
    for refuse in (AccelerationObserver(ROBOT).run, lambda log: calibrate(ROBOT, [log])):
        with pytest.raises(LogError, match=r"needs an even rate.*--rate 1000 .*Log.resample\(1000\)"):
            refuse(merged)
    even = merged.resample(2000)
    assert AccelerationObserver(ROBOT).run(even).error_against(FOLDER / "truth.parquet").tool_rms_centred < 0.065


def test_what_cannot_be_merged_is_refused():
    late = IMU.assign(t=IMU.t + 100)
    cases = [
        ([JOINTS, late], {}, "table 1: its time, .* has nothing in common with that of table 0.*--shift"),
        ([JOINTS, JOINTS], {}, "'theta_axis2' is in table 0 too"),
        ([JOINTS, IMU[["t"]]], {}, "no column is one of the robot's"),
        ([JOINTS, IMU.drop(columns="t")], {}, "table 1: column 't' is missing"),
        ([JOINTS, IMU.iloc[::-1]], {}, "table 1: column 't' does not increase at row 1"),
        ([IMU], {}, "'theta_axis2' is missing"),
        ([JOINTS.drop(columns="theta_axis3"), WHOLE[["t", "theta_axis3"]].iloc[1::2]], {}, "never read together"),
    ]
    for tables, options, words in cases:
        with pytest.raises(LogError, match=words):
            Log.merge(tables, ROBOT, **options)
    for bad in (0.0, -1.0, np.nan, "fast"):
        with pytest.raises(EstimatorError, match="rate is"):
            Log.merge([JOINTS, IMU], ROBOT, rate=bad)
    with pytest.raises(EstimatorError, match="1 shifts are there for 2 tables"):
        Log.merge([JOINTS, IMU], ROBOT, shifts=[0.0])


def test_clocks_may_be_apart_and_in_other_units():
    ahead = IMU.assign(t=(1e9 * IMU.t).round().astype("int64") + 5_000_000_000)
    with pytest.warns(RecordingWarning, match="nanoseconds"):
        merged = Log.merge([JOINTS, ahead], ROBOT, shifts=[0.0, 5.0])
    np.testing.assert_allclose(merged.t, Log.merge([JOINTS, IMU], ROBOT).t, rtol=0, atol=1e-8)


def test_from_files_to_an_estimate(files, tmp_path):
    joints, imu = files
    out, estimate = tmp_path / "log.parquet", tmp_path / "estimate.parquet"
    merged = linkside("merge", FOLDER / "robot.yaml", joints, imu, "--out", out)
    assert merged.exit_code == 0, merged.stderr
    assert re.search(r"theta_axis2 +1000 Hz", merged.stdout)
    assert re.search(r"tool_acc_x +666\.667 Hz", merged.stdout)
    done = linkside("estimate", FOLDER / "robot.yaml", out, "--with", "ekf", "--out", estimate)
    assert done.exit_code == 0, done.stderr
    assert "all good" in done.stdout
    run = ExtendedKalmanFilter(ROBOT).run(Log.merge([joints, imu], ROBOT))
    np.testing.assert_allclose(Estimate.read(estimate).q, run.q, rtol=0, atol=1e-12)
    refused = linkside("estimate", FOLDER / "robot.yaml", out, "--out", estimate)
    assert refused.exit_code == 2
    assert "--rate 1000" in refused.stderr
    even = linkside("estimate", FOLDER / "robot.yaml", out, "--rate", "2000", "--out", estimate)
    assert even.exit_code == 0, even.stderr
    found = Estimate.read(estimate)
    assert np.abs(np.diff(found.t) - 5e-4).max() < 1e-9
    assert found.error_against(FOLDER / "truth.parquet").tool_rms_centred < 0.065
    shifted = linkside("merge", FOLDER / "robot.yaml", joints, imu, "--shift", f"{imu}=0.1", "--out", out)
    assert shifted.exit_code == 0
    assert Log.read(out, ROBOT).t[0] == 0.0
    wrong = linkside("merge", FOLDER / "robot.yaml", joints, imu, "--shift", "other.csv=0.1", "--out", out)
    assert wrong.exit_code == 2
    assert "none of the files" in wrong.stderr


def test_a_kalman_filter_takes_a_gap_and_says_so(tmp_path):
    table = WHOLE[(WHOLE.t < 0.5) | (WHOLE.t > 0.52)]
    table.to_parquet(tmp_path / "log.parquet")
    arguments = ("estimate", FOLDER / "robot.yaml", tmp_path / "log.parquet", "--out", tmp_path / "estimate.parquet")
    kalman = linkside(*arguments, "--with", "ekf")
    assert kalman.exit_code == 0
    assert "1 gaps, the longest of 0.021 s" in kalman.stderr
    observer = linkside(*arguments)
    assert observer.exit_code == 2
    assert "has a gap of 0.021 s" in observer.stderr


@pytest.mark.parametrize("suffix", ["parquet", "csv"])
def test_a_log_is_written_and_read_again(tmp_path, suffix):
    text = (FOLDER / "robot.yaml").read_text().replace("noise_std: 0.05", "noise_std: 0.05\n  bias: [0.1, 0, -0.1]")
    (tmp_path / "robot.urdf").write_text((FOLDER / "robot.urdf").read_text())
    (tmp_path / "robot.yaml").write_text(text + "columns: {motor_side: true, t: time}\n")
    robot = Robot.load(tmp_path / "robot.yaml")
    table = WHOLE.rename(columns={"t": "time"}).assign(other=1.0)
    table.loc[3:6, SENSOR] = np.nan
    log = Log.from_table(table, robot, check=False)
    log.write(tmp_path / f"log.{suffix}")
    again = Log.read(tmp_path / f"log.{suffix}", robot, check=False)
    for signal in ("t", "theta", "dtheta", "tau", "acceleration", "qref", "ddqref"):
        np.testing.assert_allclose(getattr(again, signal), getattr(log, signal), rtol=1e-14, atol=1e-14)
    assert again.q is None
