"""Smoothing piece by piece and with a fixed lag equals smoothing at once, takes bounded memory, leaves nothing."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from linkside import (
    Estimate,
    EstimatorError,
    ExtendedKalmanFilter,
    Log,
    LogError,
    Noise,
    NumericalError,
    OutputError,
    RauchTungStriebelSmoother,
    Robot,
)
from linkside.kalman import FixedLagSmoother, smooth_file, smooth_pieces
from linkside.kalman import stretches as module

from .robots import DATA
from .test_long_log import write_log

FOLDER = DATA / "arm2_square"
ROBOT = Robot.load(FOLDER / "robot.yaml")
LOG = Log.read(FOLDER / "log.parquet", ROBOT)
NOISE = Noise(jerk=15.0)
FIELDS = ("q", "dq", "ddq", "theta", "dtheta", "q_std", "tool_position", "tool_std")


def smoother(**settings):
    return RauchTungStriebelSmoother(ROBOT, NOISE, **settings)


def assert_same(found, expected, fields=FIELDS):
    for name in fields:
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=0, atol=1e-9, err_msg=name)
    np.testing.assert_array_equal(found.status, expected.status)


def holey(rows, seed):
    """The recording's beginning with readings missing here and there, and no motor velocity."""
    rng = np.random.default_rng(seed)
    columns = {"t": LOG.t[:rows]}
    for names, values in (
        ([f"theta_{n}" for n in ROBOT.names], LOG.theta),
        (ROBOT.acceleration_channels, LOG.acceleration),
        ([f"ddqref_{n}" for n in ROBOT.names], LOG.ddqref),
    ):
        cut = np.where(rng.random(values[:rows].shape) < 0.1, np.nan, values[:rows])
        cut[0] = values[0]
        columns |= dict(zip(names, cut.T, strict=True))
    return Log.from_table(columns, ROBOT)


def pieces(log, rows):
    return [log[first : first + rows] for first in range(0, len(log), rows)]


@given(st.integers(1, 400), st.integers(1, 400), st.integers(0, 2**32 - 1))
@settings(max_examples=12, deadline=None)
def test_pieces_of_any_length_equal_the_whole(tmp_path_factory, rows, stretch, seed):
    log = holey(400, seed)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "STRETCH", stretch)
        parts = list(smooth_pieces(smoother(), pieces(log, rows)))
    assert [len(part) for part in parts] == [len(piece) for piece in pieces(log, rows)]
    assert_same(Estimate.concatenate(parts), smoother().run(log))


@pytest.mark.parametrize("settings", [{"iterations": 3}, {"gate": 3.0}, {"biases": ()}, {"damping": False}])
def test_settings_are_those_of_the_smoother(settings):
    parts = list(smooth_pieces(smoother(**settings), pieces(LOG[:600], 250)))
    assert_same(Estimate.concatenate(parts), smoother(**settings).run(LOG[:600]))


@pytest.mark.parametrize("suffix", ["parquet", "csv"])
def test_from_file_to_file(tmp_path, suffix):
    log, out = FOLDER / "log.parquet", tmp_path / f"out.{suffix}"
    assert smooth_file(smoother(), log, ROBOT, out, rows=1000) == len(LOG)
    found, expected = Estimate.read(out), smoother().run(LOG)
    assert expected.left_out == ("dtheta",)
    assert_same(found, expected, [name for name in FIELDS if name != "dtheta"])
    assert np.isnan(found.dtheta).all()
    assert [path.name for path in tmp_path.iterdir()] == [out.name]


def test_jerk_is_read_off_the_first_piece():
    free = RauchTungStriebelSmoother(ROBOT)
    parts = list(smooth_pieces(free, pieces(LOG, 2000)))
    fixed = RauchTungStriebelSmoother(ROBOT, Noise().for_log(LOG[:2000], ROBOT))
    assert_same(Estimate.concatenate(parts), fixed.run(LOG))


def test_no_piece_no_estimate():
    assert list(smooth_pieces(smoother(), [])) == []


def failing(log, tmp_path):
    with pytest.raises((LogError, NumericalError)) as error:
        smooth_file(smoother(), log, ROBOT, tmp_path / "out.parquet", rows=500, check=False)
    assert sorted(path.name for path in tmp_path.iterdir()) == [log.name]
    return str(error.value)


def write(path, **changes):
    table = pq.read_table(FOLDER / "log.parquet")
    for name, (row, value) in changes.items():
        column = table[name].to_numpy().copy()
        column[row] = value
        table = table.set_column(table.column_names.index(name), name, [column])
    pq.write_table(table, path)
    return path


def test_a_log_that_turns_out_broken_leaves_nothing_behind(tmp_path):
    words = failing(write(tmp_path / "log.parquet", t=(1700, 0.1)), tmp_path)
    assert "row 1700" in words


def test_an_estimate_that_breaks_down_names_its_rows(tmp_path):
    words = failing(write(tmp_path / "log.parquet", theta_axis2=(1200, 1e200)), tmp_path)
    assert words.startswith("rows 1000 to 1499: ")


def test_a_stream_that_is_left_leaves_nothing_behind(tmp_path):
    parts = smooth_pieces(smoother(), pieces(LOG[:900], 300), tmp_path)
    next(parts)
    assert len(list(tmp_path.iterdir())) == 1
    parts.close()
    assert list(tmp_path.iterdir()) == []


def test_a_disk_that_is_full_is_an_output_error(tmp_path, monkeypatch):
    def refuse(path, arrays):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(module, "_save", refuse)
    with pytest.raises(OutputError, match="No space left"):
        smooth_file(smoother(), FOLDER / "log.parquet", ROBOT, tmp_path / "out.parquet")
    assert list(tmp_path.iterdir()) == []


def test_an_output_that_cannot_be_is_refused_first(tmp_path):
    with pytest.raises(OutputError, match="no directory"):
        smooth_file(smoother(), FOLDER / "log.parquet", ROBOT, tmp_path / "nowhere/out.parquet")


SMOOTH = """
import sys
from linkside import Noise, RauchTungStriebelSmoother, Robot
from linkside.kalman import smooth_file

robot = Robot.load(sys.argv[1])
smooth_file(RauchTungStriebelSmoother(robot, Noise(jerk=15.0)), sys.argv[2], robot, sys.argv[3], 4000)
lines = open("/proc/self/status").read().splitlines()
print(next(line.split()[1] for line in lines if line.startswith("VmHWM")))
"""


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="peak memory is read from /proc")
def test_memory_does_not_grow_with_the_recording(tmp_path):
    """The rows between the two are 25 MB of log, and 0.5 GB of history."""
    peaks = []
    for seconds in (5, 20):
        log, out = tmp_path / f"{seconds}.parquet", tmp_path / f"{seconds}_out.parquet"
        write_log(log, seconds)
        robot = DATA / "kr15_six_axes/robot.yaml"
        done = subprocess.run(
            [sys.executable, "-c", SMOOTH, robot, log, out], check=True, capture_output=True, text=True
        )
        peaks.append(int(done.stdout) * 1024 / 1e6)
    print(f"peaks {peaks} MB")
    assert peaks[1] < peaks[0] + 60
    assert peaks[1] < 700


def stream(lagged, log):
    for row in range(len(log)):
        signals = {name: getattr(log, name) for name in ("theta", "acceleration", "dtheta", "ddqref")}
        there = {name: values[row] for name, values in signals.items() if values is not None}
        dt = log.t[row] - log.t[row - 1] if row else log.period
        yield lagged.step(dt=dt, **there)


def fixed_lag(lag, **settings):
    return FixedLagSmoother(ROBOT, NOISE, lag=lag, tolerances=False, **settings)


@given(st.integers(1, 40), st.integers(41, 90), st.integers(0, 2**32 - 1))
@settings(max_examples=15, deadline=None)
def test_a_fixed_lag_equals_the_smoother_up_to_now(lag, now, seed):
    log = holey(now, seed)
    estimates = list(stream(fixed_lag(lag), log))
    assert estimates[:lag] == [None] * lag
    whole = smoother(tolerances=False).run(log, covariance=True)
    row = now - 1 - lag
    late = estimates[-1]
    for name in ("q", "dq", "theta", "q_std", "tool_position", "tool_std", "state", "covariance"):
        np.testing.assert_allclose(getattr(late, name), getattr(whole, name)[row], rtol=0, atol=1e-9, err_msg=name)
    assert late.t == pytest.approx(log.t[row] - log.t[0])


def test_what_tolerances_add_is_held_forwards():
    """The smoother's falls off backwards, the filter's and that of a lag forwards; the estimate is the same."""
    lag, log = 20, LOG[:600]
    rows = [e for e in stream(FixedLagSmoother(ROBOT, NOISE, lag=lag), log) if e is not None]
    plain = [e for e in stream(fixed_lag(lag), log) if e is not None]
    whole, filtered = smoother().run(log), ExtendedKalmanFilter(ROBOT, NOISE).run(log)
    assert all(np.array_equal(a.q, b.q) and (a.q_std >= b.q_std).all() for a, b in zip(rows, plain, strict=True))
    q_std = np.array([e.q_std for e in rows])[200:]
    assert np.all(np.median(q_std / whole.q_std[200:-lag], axis=0) > 0.9)
    assert np.all(np.median(q_std / filtered.q_std[200:-lag], axis=0) < 1.05)


@given(st.integers(1, 40), st.integers(35, 300), st.integers(2, 70))
@settings(max_examples=10, deadline=None)
def test_a_lag_is_accurate_after_a_dropout(lag, gap, after):
    """P⁻ is then many powers of ten above what later readings leave of it."""
    now = 40 + gap + after
    log = LOG[:now]
    theta, acceleration = log.theta.copy(), log.acceleration.copy()
    theta[40 : 40 + gap], acceleration[40 : 40 + gap] = np.nan, np.nan
    columns = {"t": log.t} | dict(zip([f"theta_{n}" for n in ROBOT.names], theta.T, strict=True))
    log = Log.from_table(columns | dict(zip(ROBOT.acceleration_channels, acceleration.T, strict=True)), ROBOT)
    late = list(stream(fixed_lag(lag), log))[-1]
    whole = smoother(tolerances=False).run(log)
    np.testing.assert_allclose(late.q_std, whole.q_std[now - 1 - lag], rtol=1e-6)
    assert np.all(np.abs(late.q - whole.q[now - 1 - lag]) < 1e-4 * late.q_std)


def test_the_end_of_a_stream_is_smoothed_too():
    lagged = fixed_lag(30)
    for _ in range(2):  # afterwards it starts anew
        parts = [e for e in stream(lagged, LOG[:100]) if e is not None]
        assert len(parts) == 70
        last = lagged.flush()
        assert_same(last, smoother(tolerances=False).run(LOG[:100])[70:])
        np.testing.assert_allclose(last.t, LOG.t[70:100] - LOG.t[0], atol=1e-12)
    assert lagged.flush() is None


def test_a_stream_shorter_than_the_lag():
    lagged = fixed_lag(30)
    assert list(stream(lagged, LOG[:12])) == [None] * 12
    assert_same(lagged.flush(), smoother(tolerances=False).run(LOG[:12]))


def test_a_lag_smooths():
    """With more to look ahead at, the estimate comes closer to the smoother's."""
    whole = smoother().run(LOG[:400])

    def distance(lag):
        rows = [e.q for e in stream(fixed_lag(lag), LOG[:400]) if e is not None]
        return np.sqrt(np.mean((np.array(rows) - whole.q[: len(rows)])[100:300] ** 2))

    assert distance(80) < 0.6 * distance(1)


def test_a_lag_that_does_not_fit_into_memory_is_refused():
    lagged = fixed_lag(2**50)
    with pytest.raises(MemoryError):
        lagged.step(dt=LOG.period, theta=LOG.theta[0], acceleration=LOG.acceleration[0])


@pytest.mark.parametrize("lag", [0, -1, 2.5, None])
def test_a_lag_that_is_none_is_refused(lag):
    with pytest.raises(EstimatorError, match="lag is"):
        FixedLagSmoother(ROBOT, NOISE, lag=lag)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"theta": [0.1]}, "theta has shape"),
        ({"theta": [0.1, np.nan]}, "axis3 is missing"),
        ({"acceleration": [0.0, 0.0]}, "acceleration has shape"),
        ({"ddqref": [1.0]}, "ddqref has 1 entries"),
        ({"dtheta": [1.0]}, "dtheta has shape"),
        ({"further": [1.0]}, "further has 1 entries"),
        ({"dt": 0.0}, "dt is 0.0"),
        ({"dt": np.nan}, "dt is nan"),
    ],
)
def test_samples_that_cannot_be_used_are_refused(changes, words):
    sample = {"dt": 5e-4, "theta": LOG.theta[0], "acceleration": LOG.acceleration[0]}
    with pytest.raises(EstimatorError, match=words):
        FixedLagSmoother(ROBOT, NOISE, lag=5).step(**(sample | changes))
