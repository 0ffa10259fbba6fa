"""Logs: the same from every kind of table and file, whole or in pieces; every bad one refused in one line."""

import decimal
import gzip
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import linkside
from linkside import ExtendedKalmanFilter, demo
from linkside.errors import EstimatorError, LogError
from linkside.recording.log import Log
from linkside.recording.opening import log_rows

DATA = Path(__file__).parents[1] / "data"
SIGNALS = ("t", "theta", "dtheta", "tau", "ddq", "qref", "dqref", "ddqref", "acceleration", "rate")


@dataclass
class Robot:
    names: tuple[str, ...] = ("a", "b")
    elastic: np.ndarray = field(default_factory=lambda: np.array([True, False]))
    acceleration_channels: tuple[str, ...] = ("acc_x", "acc_y", "acc_z")
    gyroscope_channels: tuple[str, ...] = ("gyro_wz",)
    gear_ratio: np.ndarray = field(default_factory=lambda: np.array([100.0, 50.0]))
    columns: SimpleNamespace = field(default_factory=lambda: SimpleNamespace(motor_side=False, names={}))
    column_units: dict = field(default_factory=dict)

    @property
    def torque_constant(self) -> tuple[None, ...]:
        return (None,) * len(self.names)

    @property
    def passive(self) -> np.ndarray:
        return np.zeros(len(self.names), bool)

    @property
    def wrench_channels(self) -> tuple[str, ...]:
        return ()

    @property
    def position_channels(self) -> tuple[str, ...]:
        return ()

    @property
    def gearing(self) -> np.ndarray:
        return np.eye(len(self.names))

    @property
    def encoder_readings(self) -> dict:
        return {}

    @property
    def acceleration_errors(self) -> tuple[np.ndarray, np.ndarray]:
        return np.zeros(len(self.acceleration_channels)), np.ones(len(self.acceleration_channels))


ARM2 = Robot(
    names=("axis2", "axis3"),
    acceleration_channels=("tool_acc_x", "tool_acc_y", "tool_acc_z"),
    gyroscope_channels=(),
)
KR15 = Robot(
    names=tuple(f"a{i}" for i in range(1, 7)),
    elastic=np.arange(6) < 3,
    acceleration_channels=("acc_link4_x", "acc_link4_y", "acc_link4_z"),
    gyroscope_channels=(),
    gear_ratio=np.full(6, 100.0),
)
RECORDINGS = [(DATA / "arm2_square" / "log.parquet", ARM2), (demo.LOG, KR15)]


def recording(rows=20, seed=0):
    """A dict of columns for `Robot()`, with every signal."""
    random = np.random.default_rng(seed)
    names = [f"{s}_{j}" for s in ("theta", "dtheta", "tau", "ddq", "qref", "dqref", "ddqref") for j in "ab"]
    columns = {name: random.standard_normal(rows) for name in [*names, "acc_x", "acc_y", "acc_z", "gyro_wz"]}
    return {"t": 0.0005 * np.arange(rows)} | columns


def same(left, right):
    """Bit for bit, NaN included."""
    for name in SIGNALS:
        a, b = getattr(left, name), getattr(right, name)
        assert (a is None) == (b is None), name
        assert a is None or (a.shape == b.shape and a.tobytes() == b.tobytes()), name
    assert left.period == right.period
    return True


def joined(pieces):
    pieces = list(pieces)
    arrays = {s: [getattr(p, s) for p in pieces] for s in SIGNALS}
    arrays = {s: None if a[0] is None else np.concatenate(a) for s, a in arrays.items()}
    return SimpleNamespace(**arrays, period=pieces[0].period)


def save(path, columns):
    table = columns if isinstance(columns, pa.Table) else pa.table(columns)
    if path.suffix == ".parquet":
        pq.write_table(table, path, row_group_size=7)
    else:
        pa.csv.write_csv(table, path)
    return path


def refusal(call, *words):
    """The one-line message of a LogError, which holds all the words."""
    with pytest.raises(LogError) as caught:
        call()
    message = str(caught.value)
    assert "\n" not in message
    for word in words:
        assert word in message, message
    return message


@pytest.mark.parametrize(("path", "robot"), RECORDINGS)
def test_reads_a_recording(path, robot):
    log, table = Log.read(path, robot), pq.read_table(path)
    assert len(log) == log_rows(path) == table.num_rows
    assert log.period == pytest.approx(0.0005, rel=1e-9)
    assert log.source == str(path)
    for signal in ("theta", "dtheta", "tau", "qref", "dqref", "ddqref"):
        wanted = np.column_stack([table[f"{signal}_{joint}"].to_numpy() for joint in robot.names])
        np.testing.assert_array_equal(getattr(log, signal), wanted)
    wanted = np.column_stack([table[c].to_numpy() for c in robot.acceleration_channels])
    np.testing.assert_array_equal(log.acceleration, wanted)
    assert log.rate is None
    assert log.ddq is None


def test_arrays_are_contiguous_float64_and_read_only():
    log = Log.from_table(recording(), Robot())
    for signal in SIGNALS:
        array = getattr(log, signal)
        assert array.dtype == np.float64
        assert array.flags.c_contiguous
        assert not array.flags.writeable


def test_repr_is_one_line_with_source_size_and_signals():
    text = repr(Log.from_table(recording(), Robot(), source="monday"))
    assert text == (
        "Log(monday: 20 rows every 0.0005 s, 2 joints, t theta dtheta tau ddq qref dqref ddqref acceleration rate)"
    )


def test_time_and_single_channels_are_borrowed_not_copied():
    columns = recording()
    log = Log.from_table(columns, Robot())
    assert np.shares_memory(log.t, columns["t"])
    assert np.shares_memory(log.rate, columns["gyro_wz"])
    assert columns["t"].flags.writeable


@pytest.mark.parametrize("robot_path", RECORDINGS)
@pytest.mark.parametrize("rows", [1, 7, 1000, 1999, 100_000])
def test_stream_equals_whole_on_recordings(robot_path, rows, tmp_path):
    path, robot = robot_path
    path = save(tmp_path / "log.parquet", pq.read_table(path).slice(0, 300)) if rows == 1 else path
    whole, stream = Log.read(path, robot), Log.stream(path, robot, rows=rows)
    assert stream.count == len(whole)
    assert same(joined(stream), whole)
    assert [len(piece) for piece in stream][:-1] == [rows] * ((len(whole) - 1) // rows)


@settings(deadline=None, max_examples=40)
@given(
    length=st.integers(2, 60),
    rows=st.integers(1, 70),
    suffix=st.sampled_from([".parquet", ".csv"]),
    holes=st.lists(st.tuples(st.integers(0, 17), st.integers(1, 59))),
    motor_side=st.booleans(),
)
def test_stream_equals_whole_equals_table(tmp_path_factory, length, rows, suffix, holes, motor_side):
    columns = recording(length)
    names = list(columns)[1:]
    for channel, row in holes:
        if row < length:
            columns[names[channel]][row] = np.nan
    robot = Robot(columns=SimpleNamespace(motor_side=motor_side, names={}))
    path = save(tmp_path_factory.mktemp("log") / f"log{suffix}", columns)
    whole = Log.read(path, robot)
    assert same(whole, Log.from_table(columns, robot))
    assert same(joined(Log.stream(path, robot, rows=rows)), whole)


def tables():
    columns = recording()
    columns["tau_b"][3] = np.nan
    arrow = pa.table(columns)
    return {
        "dict of arrays": columns,
        "dict of lists": {k: list(v) for k, v in columns.items()},
        "dict of series": {k: pd.Series(v) for k, v in columns.items()},
        "pandas": pd.DataFrame(columns),
        "pandas nullable": pd.DataFrame(columns).convert_dtypes(),
        "polars": pl.DataFrame(columns),
        "polars nulls": pl.DataFrame(columns).fill_nan(None),
        "arrow": arrow,
        "arrow chunks": pa.concat_tables([arrow.slice(0, 9), arrow.slice(9)]),
        "record batch": arrow.combine_chunks().to_batches()[0],
        "strided": {k: np.repeat(v, 2)[::2] for k, v in columns.items()},
        "big endian": {k: v.astype(">f8") for k, v in columns.items()},
    }


@pytest.mark.parametrize("kind", list(tables()))
def test_every_kind_of_table_is_the_same_log(kind):
    made = tables()
    assert same(Log.from_table(made[kind], Robot()), Log.from_table(made["dict of arrays"], Robot()))


def test_compressed_csv(tmp_path):
    plain = save(tmp_path / "log.csv", recording())
    packed = tmp_path / "log.csv.gz"
    packed.write_bytes(gzip.compress(plain.read_bytes()))
    assert same(Log.read(packed, Robot()), Log.read(plain, Robot()))
    assert log_rows(packed) is None
    cut = tmp_path / "cut.csv.gz"
    cut.write_bytes(packed.read_bytes()[:-40])
    refusal(lambda: Log.read(cut, Robot()), str(cut))


@pytest.mark.parametrize(
    "convert",
    [
        lambda v: v.astype(np.float32),
        lambda v: v.astype(np.int32),
        lambda v: v.astype(np.uint8),
        lambda v: pa.array(v).dictionary_encode(),
        lambda v: pa.array([decimal.Decimal(int(x)) for x in v]),
    ],
)
def test_other_numbers_become_float64(convert):
    columns = recording()
    columns["theta_a"] = np.arange(20.0)
    converted = pa.table(columns | {"theta_a": convert(columns["theta_a"])})
    assert same(Log.from_table(converted, Robot()), Log.from_table(columns, Robot()))


def test_nulls_and_masked_samples_are_missing():
    columns = recording()
    mask = np.arange(20) == 4
    wanted = Log.from_table(columns | {"tau_a": np.where(mask, np.nan, columns["tau_a"])}, Robot())
    masked = np.ma.MaskedArray(columns["tau_a"], mask)
    assert same(Log.from_table(columns | {"tau_a": masked}, Robot()), wanted)
    nulls = pa.table(columns | {"tau_a": pa.array(columns["tau_a"], mask=mask)})
    assert same(Log.from_table(nulls, Robot()), wanted)


def test_only_needed_columns_are_looked_at(tmp_path):
    extra = {"comment": ["x"] * 20, "when": pa.array([0] * 20, pa.timestamp("s")), "list": [[1, 2]] * 20}
    path = save(tmp_path / "log.parquet", recording() | extra)
    assert same(Log.read(path, Robot()), Log.from_table(recording(), Robot()))
    frame = pd.DataFrame(recording() | {"mixed": [1, "x"] * 10})
    assert same(Log.from_table(frame, Robot()), Log.from_table(recording(), Robot()))


def test_motor_shaft_is_reflected_to_the_link():
    columns, ratio = recording(), np.array([100.0, 50.0])
    shaft = Log.from_table(columns, Robot(columns=SimpleNamespace(motor_side=True, names={})))
    link = Log.from_table(columns, Robot())
    np.testing.assert_array_equal(shaft.theta, link.theta / ratio)
    np.testing.assert_array_equal(shaft.dtheta, link.dtheta / ratio)
    np.testing.assert_array_equal(shaft.tau, link.tau * ratio)
    np.testing.assert_array_equal(shaft.qref, link.qref)
    np.testing.assert_array_equal(shaft.ddq, link.ddq)


def test_motor_shaft_of_one_joint_leaves_the_callers_array_alone():
    columns = {"t": np.arange(3.0), "theta_a": np.ones(3)}
    motor = SimpleNamespace(motor_side=True, names={})
    robot = Robot(("a",), np.array([True]), (), (), np.array([2.0]), motor)
    assert Log.from_table(columns, robot).theta.tolist() == [[0.5]] * 3
    assert columns["theta_a"].tolist() == [1.0] * 3


def test_columns_under_other_names():
    columns = recording()
    names = {"t": "time", "tau_a": "Torque A [Nm]", "acc_y": "imu.y"}
    renamed = {names.get(name, name): values for name, values in columns.items()}
    robot = Robot(columns=SimpleNamespace(motor_side=False, names=names))
    assert same(Log.from_table(renamed, robot), Log.from_table(columns, Robot()))
    del renamed["Torque A [Nm]"]
    refusal(lambda: Log.from_table(renamed, robot).require("tau"), "'Torque A [Nm]' is missing")


def test_slices_are_views_that_keep_the_period():
    log = Log.from_table(recording() | {"t": np.cumsum(np.r_[0, np.linspace(1, 1.2, 19)])}, Robot())
    part = log[5:9]
    assert len(part) == 4
    assert part.period == log.period
    assert np.shares_memory(part.theta, log.theta)
    assert part.acceleration.flags.c_contiguous
    np.testing.assert_array_equal(part.tau, log.tau[5:9])
    every = log[::2]
    assert every.period == 2 * log.period
    assert every.theta.flags.c_contiguous
    np.testing.assert_array_equal(every.theta, log.theta[::2])
    assert len(log[7:7]) == 0
    part.require("tau")
    for rows in (3, slice(None, None, -1)):
        with pytest.raises(EstimatorError, match="cut by rows"):
            log[rows]


def test_absent_signals_are_none_and_absent_joints_nan():
    columns = {k: v for k, v in recording().items() if not k.startswith(("acc", "gyro", "ddq"))}
    del columns["tau_b"]
    log = Log.from_table(columns, Robot())
    assert log.acceleration is log.rate is log.ddq is log.ddqref is None
    assert np.isnan(log.tau[:, 1]).all()
    np.testing.assert_array_equal(log.tau[:, 0], columns["tau_a"])


def test_require_names_the_first_missing_column_and_a_likely_one():
    columns = recording()
    columns["tau_A"] = columns.pop("tau_a")
    del columns["tau_b"], columns["acc_z"], columns["dtheta_b"]
    log = Log.from_table(columns, Robot(), source="log.parquet")
    log.require()
    log.require("theta", "rate")
    message = refusal(lambda: log.require("theta", "tau", purpose="the observer"))
    assert message == ("log.parquet: column 'tau_a' is missing (needed for the observer); did you mean 'tau_A'?")
    refusal(lambda: log.require("acceleration"), "'acc_z' is missing (needed for this estimator)")
    refusal(lambda: log.require("dtheta"), "'dtheta_b' is missing")


def test_require_torque_of_elastic_joints_only():
    columns = recording()
    del columns["tau_b"], columns["ddq_b"]
    Log.from_table(columns, Robot()).require("tau", "ddq")


def test_require_of_sensors_the_robot_has_not_and_of_unknown_signals():
    log = Log.from_table(recording(), Robot(acceleration_channels=(), gyroscope_channels=()))
    refusal(lambda: log.require("acceleration"), "no accelerometer")
    refusal(lambda: log.require("rate"), "no gyroscope")
    with pytest.raises(EstimatorError, match="'force' is no signal"):
        log.require("force")


def changed(column, row, value):
    columns = recording()
    columns[column] = columns[column].copy()
    columns[column][row] = value
    return columns


BAD_SAMPLES = [
    (changed("t", 17, np.nan), ["'t' is nan at row 17"]),
    (changed("t", 17, np.inf), ["'t' is inf at row 17"]),
    (changed("t", 17, 0.001), ["'t' runs backwards by 0.007 s at row 17 (t = 0.001)"]),
    (changed("t", 17, 0.008), ["'t' repeats at row 17 (t = 0.008)"]),
    (
        changed("t", 19, 0.0105),
        ["'t' has a gap of 0.0015 s where the period is 0.0005 s at row 19 (t = 0.0105)"],
    ),
    (changed("tau_b", 17, -np.inf), ["'tau_b' is infinite at row 17 (t = 0.0085)"]),
    (changed("gyro_wz", 0, np.inf), ["'gyro_wz' is infinite at row 0 (t = 0)"]),
    (changed("acc_y", slice(None), np.nan), ["'acc_y' is NaN throughout"]),
    (changed("theta_a", slice(None), np.nan), ["'theta_a' is NaN throughout"]),
]


@pytest.mark.parametrize(("columns", "words"), BAD_SAMPLES)
@pytest.mark.parametrize("suffix", [".parquet", ".csv"])
def test_bad_samples_are_named_whole_and_streamed(columns, words, suffix, tmp_path):
    path = save(tmp_path / f"log{suffix}", columns)
    message = refusal(lambda: Log.read(path, Robot()), f"{path}: column ", *words)
    for rows in (1, 5, 17, 100):
        assert refusal(lambda rows=rows: list(Log.stream(path, Robot(), rows=rows))) == message
    assert refusal(lambda: Log.from_table(columns, Robot(), source=str(path))) == message


def test_gaps_can_be_allowed(tmp_path):
    columns = recording()
    columns["t"] = columns["t"] + 0.1 * (np.arange(20) > 9)
    path = save(tmp_path / "log.parquet", columns)
    refusal(lambda: Log.read(path, Robot()), "gap of 0.1005 s", "row 10")
    whole = Log.read(path, Robot(), allow_gaps=True)
    assert len(whole) == 20
    assert same(whole, Log.from_table(columns, Robot(), allow_gaps=True))
    assert same(joined(Log.stream(path, Robot(), rows=5, allow_gaps=True)), whole)
    columns["t"] = columns["t"][::-1]
    refusal(lambda: Log.from_table(columns, Robot(), allow_gaps=True), "runs backwards")


def test_jitter_is_no_gap():
    random = np.random.default_rng(1)
    columns = recording(500)
    columns["t"] = columns["t"] + 0.0001 * random.uniform(-1, 1, 500)
    assert len(Log.from_table(columns, Robot())) == 500


def test_pieces_before_a_bad_row_come_out(tmp_path):
    path = save(tmp_path / "log.parquet", changed("tau_b", 17, np.inf))
    stream = iter(Log.stream(path, Robot(), rows=5))
    assert [len(next(stream)) for _ in range(3)] == [5, 5, 5]
    refusal(lambda: next(stream), "row 17")


@pytest.mark.parametrize(
    ("replaced", "words"),
    [
        ({"tau_a": ["x"] * 20}, ["'tau_a' is string: numbers are expected"]),
        ({"tau_a": [True] * 20}, ["'tau_a' is bool"]),
        ({"t": np.arange(20).astype("M8[ms]")}, ["'t' is timestamp[ms]", "seconds as a float are expected"]),
        ({"t": np.arange(20).astype("m8[ms]")}, ["'t' is duration[ms]", "seconds as a float"]),
        ({"tau_a": np.ones((20, 2))}, ["'tau_a' has shape (20, 2)"]),
        ({"tau_a": 3.0}, ["'tau_a' has shape ()"]),
        ({"tau_a": [[1], [1, 2]] * 10}, ["'tau_a' is ragged"]),
        ({"tau_a": np.ones(19)}, ["'tau_a' has 19 rows where the others have 20"]),
        ({"tau_a": np.ones(20) * 1j}, ["table: cannot be read"]),
        ({"tau_a": [1, "x", None, {}] * 5}, ["table: cannot be read"]),
        ({"tau_a": [None] * 20}, ["'tau_a' is NaN throughout"]),
    ],
)
def test_columns_that_hold_no_numbers(replaced, words):
    refusal(lambda: Log.from_table(recording() | replaced, Robot()), *words)


@pytest.mark.parametrize("kind", [pa.list_(pa.float64()), pa.list_(pa.float64(), 2)])
def test_nested_columns(kind, tmp_path):
    path = save(tmp_path / "log.parquet", recording() | {"tau_a": pa.array([[1.0, 2.0]] * 20, kind)})
    refusal(lambda: Log.read(path, Robot()), "'tau_a' is", "one number a row is expected")
    refusal(lambda: list(Log.stream(path, Robot())), "'tau_a' is", "one number a row is expected")


@pytest.mark.parametrize("frame", [pd.DataFrame, pl.DataFrame, pa.table])
def test_frames_that_hold_no_numbers(frame):
    text = frame(recording() | {"theta_b": ["x"] * 20})
    refusal(lambda: Log.from_table(text, Robot()), "'theta_b' is", "numbers are expected")
    dates = frame(recording() | {"t": np.arange(20).astype("M8[ms]")})
    refusal(lambda: Log.from_table(dates, Robot()), "seconds as a float are expected")


def test_missing_columns_are_named_at_once():
    columns = recording()
    columns["thetab"] = columns.pop("theta_b")
    refusal(lambda: Log.from_table(columns, Robot()), "'theta_b' is missing; did you mean 'thetab'?")
    del columns["t"]
    refusal(lambda: Log.from_table(columns, Robot()), "column 't' is missing")


def test_duplicate_columns(tmp_path):
    columns = recording()
    arrays, names = [*columns.values(), columns["tau_a"]], [*columns, "tau_a"]
    twice = pa.table([pa.array(a) for a in arrays], names=names)
    words = "column 'tau_a' is there 2 times"
    refusal(lambda: Log.from_table(twice, Robot()), words)
    refusal(lambda: Log.from_table(pd.DataFrame(np.transpose(arrays), columns=names), Robot()), words)
    for suffix in (".parquet", ".csv"):
        path = save(tmp_path / f"log{suffix}", twice)
        refusal(lambda path=path: Log.read(path, Robot()), words)
        refusal(lambda path=path: Log.stream(path, Robot()), words)
    unused = pa.table([pa.array(a) for a in [*columns.values(), [0] * 20, [0] * 20]], [*columns, "u", "u"])
    assert len(Log.from_table(unused, Robot())) == 20


@pytest.mark.parametrize(("rows", "words"), [(0, "has no rows"), (1, "has a single row")])
@pytest.mark.parametrize("suffix", [".parquet", ".csv"])
def test_too_short(rows, words, suffix, tmp_path):
    columns = {name: values[:rows] for name, values in recording().items()}
    path = save(tmp_path / f"log{suffix}", columns)
    refusal(lambda: Log.read(path, Robot()), words)
    refusal(lambda: Log.stream(path, Robot()), words)
    refusal(lambda: Log.from_table(columns, Robot()), words)


def test_files_that_are_not_there_or_not_ours(tmp_path):
    (tmp_path / "folder.parquet").mkdir()
    (tmp_path / "log.xlsx").write_bytes(b"x")
    for call in (lambda p: Log.read(p, Robot()), lambda p: Log.stream(p, Robot()), log_rows):
        refusal(lambda call=call: call(tmp_path / "none.parquet"), "none.parquet: no such file")
        refusal(lambda call=call: call(tmp_path / "folder.parquet"), "this is a directory")
        refusal(lambda call=call: call(tmp_path / "log.xlsx"), "ends in .parquet, .csv, .csv.gz, .mat")
        refusal(lambda call=call: call(tmp_path / f"{'x' * 300}.csv"), "File name too long")


def test_what_is_not_a_table():
    for thing in (3, None, "log.parquet", np.ones((3, 3)), [1, 2]):
        refusal(lambda thing=thing: Log.from_table(thing, Robot()), f"not {type(thing).__name__}")


def test_stream_of_no_rows():
    with pytest.raises(EstimatorError, match="at least one row"):
        Log.stream(RECORDINGS[0][0], ARM2, rows=0)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "cannot be read"),
        ("t,theta_a,theta_b\n0,1,2\n1,abc,3\n", "column 'theta_a' is 'abc' at row 1: a number is expected"),
        ("t,theta_a,theta_b\n0,1,2\n2024-01-01,1,3\n", "'t' is '2024-01-01' at row 1: seconds as a float"),
        ("t,theta_a,theta_b\n0,1,2\n1,2\n2,3,4\n", "row 1 has 2 columns where the header has 3"),
        ("t,theta_a,theta_b\n0,1,2\n1,2,3,4\n2,3,4\n", "row 1 has 4 columns where the header has 3"),
        ("t;theta_a;theta_b\n0;1;2\n1;2\n", "row 1 has 2 columns where the header has 3"),
        ("t;theta_a;theta_b\n0,0;1,5;2\n0,1;2,5;1.2.3\n", "column 'theta_b' is '1.2.3' at row 1"),
        ("t theta_a theta_b\n0 1 2\n1 2 3\n", "columns separated by blanks: a comma, a semicolon or a tab"),
        ("# only\n# comments\n", "no header: a line with the names"),
    ],
)
def test_broken_csv(text, words, tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(text)
    refusal(lambda: Log.read(path, Robot()), f"{path}: ", words)
    refusal(lambda: list(Log.stream(path, Robot(), rows=1)), f"{path}: ", words)


def test_broken_cell_far_into_a_csv_file(tmp_path):
    path = tmp_path / "log.csv"
    lines = [f"{0.0005 * row:.4f},1,2" for row in range(150_000)]
    lines[140_000] = "70.0000,1,1.2.3"
    path.write_text("\n".join(["t,theta_a,theta_b", *lines]))
    words = "column 'theta_b' is '1.2.3' at row 140000: a number is expected"
    refusal(lambda: Log.read(path, Robot()), words)
    stream = iter(Log.stream(path, Robot(), rows=1000))
    assert len(next(stream)) == 1000
    refusal(lambda: list(stream), words)


def test_csv_missing_samples_and_spaces(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("t,theta_a,theta_b,tau_a\n0, 1,2,\n1,NaN,3,nan\n2,3e-1 ,-4,NA\n3,.5,1.,2\n")
    log = Log.read(path, Robot())
    np.testing.assert_array_equal(log.theta, [[1, 2], [np.nan, 3], [0.3, -4], [0.5, 1]])
    np.testing.assert_array_equal(log.tau[:, 0], [np.nan, np.nan, np.nan, 2])


@settings(deadline=None, max_examples=60)
@given(cut=st.floats(0, 1, exclude_max=True), index=st.sampled_from([0, 1]))
def test_truncated_parquet(tmp_path_factory, cut, index):
    path, robot = RECORDINGS[index]
    whole = path.read_bytes()
    broken = tmp_path_factory.mktemp("cut") / "log.parquet"
    broken.write_bytes(whole[: int(cut * len(whole))])
    refusal(lambda: Log.read(broken, robot), str(broken))
    refusal(lambda: Log.stream(broken, robot), str(broken))
    refusal(lambda: log_rows(broken), str(broken))


@settings(deadline=None, max_examples=60)
@given(content=st.binary(max_size=300), suffix=st.sampled_from([".parquet", ".csv", ".csv.gz"]))
def test_random_bytes(tmp_path_factory, content, suffix):
    path = tmp_path_factory.mktemp("noise") / f"log{suffix}"
    path.write_bytes(content)
    refusal(lambda: Log.read(path, Robot()), str(path))


@settings(deadline=None, max_examples=60)
@given(cut=st.integers(0, 3000))
def test_truncated_csv_is_a_shorter_log_or_refused(tmp_path_factory, cut):
    path = save(tmp_path_factory.mktemp("cut") / "log.csv", recording())
    path.write_bytes(path.read_bytes()[:cut])
    try:
        assert 2 <= len(Log.read(path, Robot())) <= 20
    except LogError as error:
        assert str(error).startswith(f"{path}: ")  # noqa: PT017


def test_signals_that_were_replaced_by_columns_in_another_order_of_memory_are_taken():
    robot = linkside.Robot.load(demo.ROBOT)
    log = Log.read(demo.LOG, robot)[:50]
    turned = replace(log, theta=np.asfortranarray(log.theta), tau=log.tau.repeat(2, axis=1)[:, ::2])
    np.testing.assert_array_equal(ExtendedKalmanFilter(robot).run(turned).q, ExtendedKalmanFilter(robot).run(log).q)
