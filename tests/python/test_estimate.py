"""Estimates: round trips, files whole or not at all and the same from any pieces, errors against a truth."""

import errno
import itertools
import os
import stat
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from linkside import demo
from linkside.errors import EstimatorError, LogError, OutputError
from linkside.files.writing import check_writable
from linkside.recording import Estimate, EstimateWriter, Status
from linkside.recording import writer as module

DATA = Path(__file__).parents[1] / "data"
TRUTHS = [DATA / "arm2_square" / "truth.parquet", demo.TRUTH]
ARRAYS = (
    *("t", "q", "dq", "ddq", "theta", "dtheta"),
    *("tool_position", "q_std", "tool_std", "covariance", "status"),
)
OPTIONAL = ("ddq", "tool_position", "q_std", "tool_std")


def motion(rows=30, joints=2, seed=0, leave_out=()):
    random = np.random.default_rng(seed)
    shapes = dict.fromkeys(("q", "dq", "ddq", "theta", "dtheta", "q_std"), (rows, joints))
    shapes |= {"tool_position": (rows, 3), "tool_std": (rows, 3)}
    arrays = {name: random.standard_normal(shape) for name, shape in shapes.items() if name not in leave_out}
    status = random.integers(0, 8, rows).astype(np.uint8)
    names = tuple(f"j{i}" for i in range(joints))
    return Estimate(t=0.0005 * np.arange(rows), status=status, names=names, **arrays)


def same(left, right):
    """Bit for bit, NaN included."""
    assert left.names == right.names
    for name in ARRAYS:
        a, b = getattr(left, name), getattr(right, name)
        assert (a is None) == (b is None), name
        if a is not None:
            assert (a.dtype, a.shape) == (b.dtype, b.shape), name
            assert a.tobytes() == b.tobytes(), name
    return True


def refusal(error, call, *words):
    """The one-line message of an error, which holds all the words."""
    with pytest.raises(error) as caught:
        call()
    message = str(caught.value)
    assert "\n" not in message
    for word in words:
        assert word in message, message
    return message


def write_pieces(path, estimate, cuts):
    edges = [0, *sorted(cuts), len(estimate)]
    with EstimateWriter(path) as writer:
        for a, b in itertools.pairwise(edges):
            writer.write(estimate[a:b])


def test_columns_are_the_contract_in_order_and_views():
    estimate = motion()
    columns = estimate.columns()
    assert list(columns) == [
        *("t", "q_j0", "q_j1", "dq_j0", "dq_j1", "ddq_j0", "ddq_j1"),
        *("theta_j0", "theta_j1", "dtheta_j0", "dtheta_j1", "tool_x", "tool_y", "tool_z"),
        *("q_std_j0", "q_std_j1", "tool_std_x", "tool_std_y", "tool_std_z", "status"),
    ]
    assert all(column.shape == (30,) for column in columns.values())
    assert np.shares_memory(columns["q_j1"], estimate.q)
    np.testing.assert_array_equal(columns["tool_z"], estimate.tool_position[:, 2])
    assert columns["status"].dtype == np.uint8


def test_columns_that_a_method_has_not_are_left_out():
    columns = motion(leave_out=OPTIONAL).columns()
    assert not [name for name in columns if name.startswith(("ddq", "tool", "q_std"))]


@pytest.mark.parametrize("rows", [0, 1, 5])
def test_tables_of_every_kind(rows):
    estimate = motion(rows)
    columns = estimate.columns()
    for table in (estimate.to_arrow(), estimate.to_pandas(), estimate.to_polars()):
        for name, column in columns.items():
            np.testing.assert_array_equal(np.asarray(table[name]), column)
    assert estimate.to_arrow().column_names == list(columns)
    assert isinstance(estimate.to_pandas(), pd.DataFrame)
    assert isinstance(estimate.to_polars(), pl.DataFrame)


@settings(deadline=None, max_examples=40)
@given(
    rows=st.integers(1, 40),
    joints=st.integers(1, 7),
    seed=st.integers(0, 100),
    leave_out=st.sets(st.sampled_from(OPTIONAL)),
    suffix=st.sampled_from([".parquet", ".csv"]),
    values=st.lists(st.floats(allow_infinity=False), max_size=20),
)
def test_round_trip(tmp_path_factory, rows, joints, seed, leave_out, suffix, values):
    estimate = motion(rows, joints, seed, leave_out)
    estimate.dq.flat[: len(values)] = np.array(values)[: estimate.dq.size]
    estimate.dq[np.isnan(estimate.dq)] = np.nan  # any NaN is a NaN: its payload is not kept
    path = tmp_path_factory.mktemp("out") / f"estimate{suffix}"
    estimate.write(path)
    assert same(Estimate.read(path), estimate)
    assert [p.name for p in path.parent.iterdir()] == [path.name]


@settings(deadline=None, max_examples=30)
@given(
    rows=st.integers(1, 60),
    cuts=st.lists(st.integers(0, 60), max_size=8),
    suffix=st.sampled_from([".parquet", ".csv"]),
    group=st.sampled_from([1, 7, 16, 1000]),
)
def test_pieces_make_the_same_file_bit_for_bit(tmp_path_factory, rows, cuts, suffix, group):
    folder, estimate = tmp_path_factory.mktemp("out"), motion(rows)
    whole, pieces = folder / f"whole{suffix}", folder / f"pieces{suffix}"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "GROUP", group)
        estimate.write(whole)
        write_pieces(pieces, estimate, [min(cut, rows) for cut in cuts])
    assert whole.read_bytes() == pieces.read_bytes()
    assert same(Estimate.read(pieces), estimate)
    if suffix == ".parquet":
        assert pq.ParquetFile(pieces).metadata.num_row_groups == -(-rows // group)


@settings(deadline=None, max_examples=30)
@given(rows=st.integers(0, 40), cuts=st.lists(st.integers(0, 40), max_size=6))
def test_slices_concatenate_to_the_whole(rows, cuts):
    estimate = replace(motion(rows), covariance=np.arange(rows * 16.0).reshape(rows, 4, 4))
    edges = [0, *sorted(min(cut, rows) for cut in cuts), rows]
    parts = [estimate[a:b] for a, b in itertools.pairwise(edges)]
    assert sum(map(len, parts)) == rows
    assert same(Estimate.concatenate(iter(parts)), estimate)


def test_concatenate_refuses_what_does_not_fit():
    for other in (motion(joints=3), motion(leave_out=["ddq"]), replace(motion(), names=("j1", "j0"))):
        refusal(EstimatorError, lambda other=other: Estimate.concatenate([motion(), other]), "part 1")
    refusal(EstimatorError, lambda: Estimate.concatenate([]), "no estimate")
    refusal(EstimatorError, lambda: motion()[3], "cut by rows")


@pytest.mark.parametrize("name", [n for n in ARRAYS if n not in ("t", "covariance")])
def test_wrong_shapes_are_refused(name):
    whole = motion()
    for wrong in (getattr(whole, name)[:-1], getattr(whole, name)[..., None]):
        refusal(EstimatorError, lambda wrong=wrong: replace(whole, **{name: wrong}), name, "shape")
    refusal(EstimatorError, lambda: replace(whole, covariance=np.zeros((30, 4))), "covariance")


def test_status_words():
    estimate = motion(6)
    status = np.array([0, 1, 2, 3, 7, 0], np.uint8)
    estimate = replace(estimate, status=status)
    counted = {word: count for word, count in estimate.status_summary().items() if count}
    assert counted == {"good": 2, "damped": 3, "bridged": 3, "unseen": 1}
    assert Status(3) == Status.DAMPED | Status.BRIDGED
    assert Status.GOOD == 0
    assert repr(estimate) == (
        "Estimate(6 rows, 2 joints, q dq theta dtheta ddq tool_position q_std tool_std; "
        "status: 2 good, 3 damped, 3 bridged, 1 unseen)"
    )


# Reading


@pytest.mark.parametrize("path", TRUTHS)
def test_reads_a_truth(path):
    truth, table = Estimate.read(path), pq.read_table(path)
    assert len(truth) == table.num_rows
    for name, column in truth.columns().items():
        if name != "status":
            np.testing.assert_array_equal(column, table[name].to_numpy())
    assert truth.status_summary()["good"] == len(truth)
    assert truth.q_std is None


def test_reads_a_measured_truth_without_motor_velocities(tmp_path):
    table = motion(leave_out=OPTIONAL).to_arrow().select(["t", "q_j0", "q_j1", "dq_j0", "dq_j1"])
    pq.write_table(table, tmp_path / "truth.parquet")
    truth = Estimate.read(tmp_path / "truth.parquet")
    assert np.isnan(truth.theta).all()
    error = motion().error_against(tmp_path / "truth.parquet")
    assert set(error.rms) == {"q_j0", "q_j1", "dq_j0", "dq_j1"}


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"t": [0.0, 1.0]}, "no column 'q_<joint>'"),
        ({"q_a": [0.0, 1.0]}, "column 't' is missing"),
        ({"t": [0.0, 0.0], "q_a": [0.0, 1.0]}, "'t' does not increase"),
        ({"t": [0.0, np.nan], "q_a": [0.0, 1.0]}, "'t' does not increase"),
        ({"t": [np.nan], "q_a": [0.0]}, "'t' does not increase"),
        ({"t": [0.0, 1.0], "q_a": ["x", "y"]}, "'q_a' is"),
        ({"t": [0.0, 1.0], "q_a": [0.0, 1.0], "status": [0, -1]}, "'status' has a value"),
        ({"t": [0.0, 1.0], "q_a": [0.0, 1.0], "status": [0.0, np.nan]}, "'status' has a value"),
        ({"t": [0.0, 1.0], "q_a": [0.0, 1.0], "status": [0.0, 0.5]}, "'status' has a value"),
    ],
)
@pytest.mark.parametrize("suffix", [".parquet", ".csv"])
def test_files_that_are_no_estimates(table, words, suffix, tmp_path):
    path = tmp_path / f"estimate{suffix}"
    write = pq.write_table if suffix == ".parquet" else pa.csv.write_csv
    write(pa.table(table), path)
    refusal(LogError, lambda: Estimate.read(path), f"{path}: ", words)


def test_duplicate_columns_and_missing_files(tmp_path):
    table = motion().to_arrow()
    twice = pa.table([*table.columns, table["dq_j0"]], names=[*table.column_names, "dq_j0"])
    pq.write_table(twice, tmp_path / "twice.parquet")
    refusal(LogError, lambda: Estimate.read(tmp_path / "twice.parquet"), "'dq_j0' is there 2 times")
    refusal(LogError, lambda: Estimate.read(tmp_path / "none.parquet"), "no such file")


@settings(deadline=None, max_examples=40)
@given(cut=st.floats(0, 1, exclude_max=True))
def test_truncated_files(tmp_path_factory, cut):
    path = tmp_path_factory.mktemp("cut") / "estimate.parquet"
    whole = TRUTHS[1].read_bytes()
    path.write_bytes(whole[: int(cut * len(whole))])
    refusal(LogError, lambda: Estimate.read(path), str(path))


# Writing: whole or not at all


def refused_paths(folder):
    (folder / "folder.csv").mkdir(exist_ok=True)
    return [
        (folder / "none" / "estimate.parquet", "no directory"),
        (folder / "folder.csv", "not a file"),
        (folder / "estimate.xlsx", "ends in .parquet or .csv"),
        (folder / "estimate", "ends in .parquet or .csv"),
        (folder / f"{'x' * 300}.csv", "cannot be written: File name too long"),
        ("a\0b.csv", "cannot be written: "),
    ]


def test_paths_that_cannot_be_written_are_refused_before_any_work(tmp_path):
    for path, words in refused_paths(tmp_path):
        for call in (check_writable, EstimateWriter, motion().write):
            refusal(OutputError, lambda path=path, call=call: call(path), f"{path}: ".replace("\0", "\\x00"), words)
    assert [p.name for p in tmp_path.iterdir()] == ["folder.csv"]


def test_write_protected_files_and_folders_are_refused(tmp_path, monkeypatch):
    path = tmp_path / "estimate.csv"
    path.write_text("precious")
    monkeypatch.setattr(os, "access", lambda *_: False)  # for root nothing is write-protected
    refusal(OutputError, lambda: check_writable(path), "must not be written")
    monkeypatch.undo()

    def denied(*_args, **_kwargs):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))

    monkeypatch.setattr(Path, "open", denied)
    refusal(OutputError, lambda: check_writable(path), "cannot be written: Permission denied")
    monkeypatch.undo()
    assert path.read_text() == "precious"


def test_checking_changes_nothing(tmp_path):
    path = tmp_path / "estimate.csv"
    check_writable(path)
    assert list(tmp_path.iterdir()) == []
    path.write_text("old")
    check_writable(str(path))
    assert path.read_text() == "old"


@pytest.mark.parametrize("failure", [ValueError("broken log"), KeyboardInterrupt(), SystemExit(1)])
@pytest.mark.parametrize("suffix", [".parquet", ".csv"])
@pytest.mark.parametrize("old", [None, "old"])
@pytest.mark.parametrize("pieces", [0, 1, 3])
def test_a_failure_leaves_what_was_there(failure, suffix, old, pieces, tmp_path):
    path = tmp_path / f"estimate{suffix}"
    if old:
        path.write_text(old)

    def fail():
        with EstimateWriter(path) as writer:
            for _ in range(pieces):
                writer.write(motion())
            raise failure

    with pytest.raises(type(failure)):
        fail()
    assert [p.read_text() for p in tmp_path.iterdir()] == ([old] if old else [])


def test_the_file_appears_only_at_the_end_and_replaces_the_old(tmp_path):
    path = tmp_path / "estimate.parquet"
    path.write_text("old")
    with EstimateWriter(path) as writer:
        writer.write(motion())
        assert path.read_text() == "old"
    assert same(Estimate.read(path), motion())
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def test_permissions_are_those_of_any_new_file_and_links_are_followed(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    target, link = tmp_path / "elsewhere" / "real.csv", tmp_path / "link.csv"
    target.write_text("old")
    link.symlink_to(target)
    motion().write(link)
    assert link.is_symlink()
    assert same(Estimate.read(target), motion())
    (tmp_path / "plain").write_text("")
    assert stat.S_IMODE(target.stat().st_mode) == stat.S_IMODE((tmp_path / "plain").stat().st_mode)


@pytest.mark.parametrize("suffix", [".parquet", ".csv"])
def test_a_full_disk_is_one_line_and_leaves_nothing(suffix, tmp_path, monkeypatch):
    def full(_descriptor):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    path = tmp_path / f"estimate{suffix}"
    monkeypatch.setattr(os, "fsync", full)
    message = refusal(OutputError, lambda: motion().write(path))
    assert message == f"{path}: cannot be written: No space left on device"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("suffix", [".parquet", ".csv"])
def test_a_disk_that_fills_while_rows_are_written(suffix, tmp_path, monkeypatch):
    class Full:
        """A file on a disk that holds 300 bytes."""

        def __init__(self, file):
            self.file, self.left = file, 300

        def write(self, data):
            self.left -= len(data)
            if self.left < 0:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            return self.file.write(data)

        def __getattr__(self, name):
            return getattr(self.file, name)

    path, original = tmp_path / f"estimate{suffix}", module.open_part

    def opened(where):
        part, file = original(where)
        return part, Full(file)

    monkeypatch.setattr(module, "open_part", opened)
    refusal(OutputError, lambda: motion(5000).write(path), f"{path}: cannot be written", "No space left")
    assert list(tmp_path.iterdir()) == []


def test_writers_refuse_misuse(tmp_path):
    path = tmp_path / "estimate.parquet"
    refusal(OutputError, lambda: EstimateWriter(path).write(motion()), "inside the `with` block")

    def nothing():
        with EstimateWriter(path):
            pass

    def mixed():
        with EstimateWriter(path) as writer:
            writer.write(motion())
            writer.write(motion(joints=3))

    refusal(OutputError, nothing, "no estimate was written")
    refusal(EstimatorError, mixed, "other columns")
    assert list(tmp_path.iterdir()) == []


def test_an_empty_estimate_is_a_file_without_rows(tmp_path):
    motion(0).write(tmp_path / "estimate.parquet")
    assert same(Estimate.read(tmp_path / "estimate.parquet"), motion(0))


# Errors


@pytest.mark.parametrize("path", TRUTHS)
def test_a_truth_has_no_error_against_itself(path):
    error = Estimate.read(path).error_against(path)
    assert set(error.rms) == set(error.max)
    assert set(error.rms.values()) == set(error.max.values()) == {0.0}
    assert (error.tool_rms, error.tool_max, error.tool_rms_centred, error.tool_max_centred) == (0, 0, 0, 0)


@pytest.mark.parametrize("path", TRUTHS)
def test_known_errors_are_found(path):
    truth = Estimate.read(path)
    wave = np.where(np.arange(len(truth)) % 2, 1.0, -1.0)[:, None]
    offset = np.array([1.0, 2.0, -2.0])
    q, tool = truth.q + 1e-3 * wave, truth.tool_position + 1e-3 * (offset + 0.25 * wave * [1, 0, 0])
    error = replace(truth, q=q, tool_position=tool).error_against(truth)
    for joint in truth.names:
        assert error.rms[f"q_{joint}"] == pytest.approx(1e-3)
        assert error.max[f"q_{joint}"] == pytest.approx(1e-3)
        assert error.rms[f"dq_{joint}"] == 0
    assert error.tool_rms == pytest.approx(np.sqrt(9 + 0.0625))
    assert error.tool_max == pytest.approx(np.sqrt(1.25**2 + 8))
    assert error.tool_rms_centred == pytest.approx(0.25)
    assert error.tool_max_centred == pytest.approx(0.25)


def test_rows_are_matched_by_time():
    truth = motion(100)
    estimate = replace(truth[20:80:3], t=truth.t[20:80:3] + 1e-9)
    assert set(estimate.error_against(truth).rms.values()) == {0.0}
    shifted = replace(truth, t=truth.t + 0.0001)
    refusal(EstimatorError, lambda: shifted.error_against(truth), "times differ: row 0 (t = 0.0001)", "the truth")
    refusal(EstimatorError, lambda: truth.error_against(truth[:99]), "times differ: row 99")
    refusal(EstimatorError, lambda: truth.error_against(truth[1:]), "times differ: row 0 (t = 0)")
    refusal(EstimatorError, lambda: truth[:0].error_against(truth), "nothing to compare")
    refusal(EstimatorError, lambda: truth.error_against(truth[:0]), "nothing to compare")


def test_holes_of_the_truth_are_passed_over_and_those_of_the_estimate_are_not():
    whole = motion()
    q, tool = whole.q.copy(), whole.tool_position.copy()
    q[3:5, 0], tool[7, 1] = np.nan, np.nan
    holed = replace(whole, q=q, tool_position=tool)
    over = whole.error_against(holed)
    assert over.rms["q_j0"] == over.tool_rms == 0
    under = holed.error_against(whole)
    assert np.isnan([under.rms["q_j0"], under.max["q_j0"], under.tool_rms, under.tool_max_centred]).all()


def test_joints_are_matched_by_name():
    truth = motion()
    turned = replace(truth, names=("j1", "j0"), **{n: getattr(truth, n)[:, ::-1] for n in ("q", "dq", "ddq")})
    assert turned.error_against(truth).rms["q_j0"] == 0
    other = replace(motion(leave_out=OPTIONAL), names=("x", "y"))
    refusal(EstimatorError, lambda: other.error_against(truth), "no sample to compare")
    tool_only = replace(motion(), names=("x", "y")).error_against(truth)
    assert (tool_only.rms, tool_only.tool_rms) == ({}, 0)
    assert motion(leave_out=OPTIONAL).error_against(truth).tool_rms is None
