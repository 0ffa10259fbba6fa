"""Logs in MATLAB's .mat and in HDF5 are those of the same columns in Parquet."""

import shutil
import sys
from contextlib import suppress
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.io import savemat

from linkside import Log, LogError, Robot, cli
from linkside.files.arrays_in_files import ArrayTable

FOLDER = Path(__file__).parents[1] / "data/arm2_square"
WHOLE = pd.read_parquet(FOLDER / "log.parquet")
JOINTS = ("axis2", "axis3")
ACCELERATION = [f"tool_acc_{axis}" for axis in "xyz"]


def arrays():
    """The recording as someone with MATLAB keeps it: time, and a matrix a signal; and what is no signal."""
    signals = {signal: WHOLE[[f"{signal}_{joint}" for joint in JOINTS]].to_numpy() for signal in ("theta", "tau")}
    return {"time": WHOLE.t.to_numpy(), "acc": WHOLE[ACCELERATION].to_numpy(), **signals}


def robot(tmp_path, between):
    names = {"t": "time"} | {f"{s}_{joint}": f"{s}[{k}]" for s in ("theta", "tau") for k, joint in enumerate(JOINTS)}
    names |= {column: f"acc[{k}]" for k, column in enumerate(ACCELERATION)}
    columns = "".join(f"  {ours}: 'log{between}{theirs}'\n" for ours, theirs in names.items())
    shutil.copy(FOLDER / "robot.urdf", tmp_path)
    (tmp_path / "robot.yaml").write_text((FOLDER / "robot.yaml").read_text() + "columns:\n" + columns)
    return tmp_path / "robot.yaml"


def write_mat(path):
    savemat(
        path, {"log": arrays(), "comment": "a run", "gain": 3.0, "parts": [{"x": np.arange(3.0)}, {"x": np.arange(2)}]}
    )


def write_hdf5(path):
    with h5py.File(path, "w") as file:
        for name, array in arrays().items():
            file.create_dataset(f"log/{name}", data=array, compression="gzip")
        file["comment"] = "a run"


def write_matlab73(path):
    """As MATLAB 7.3 does: 512 bytes ahead, arrays turned, references among the rest."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, array in arrays().items():
            file[f"log/{name}"] = np.atleast_2d(array.T)
        file["#refs#/a"] = np.arange(5.0)
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file".ljust(512))


@pytest.mark.parametrize(
    ("name", "write", "between"),
    [("log.mat", write_mat, "."), ("log.h5", write_hdf5, "/"), ("old.mat", write_matlab73, "/")],
)
def test_a_log_is_that_of_parquet(name, write, between, tmp_path):
    write(tmp_path / name)
    loaded = Robot.load(robot(tmp_path, between))
    log, reference = (
        Log.read(tmp_path / name, loaded),
        Log.read(FOLDER / "log.parquet", Robot.load(FOLDER / "robot.yaml")),
    )
    for signal in ("t", "theta", "tau", "acceleration"):
        np.testing.assert_array_equal(getattr(log, signal), getattr(reference, signal))
    pieces = list(Log.stream(tmp_path / name, loaded, 700))
    np.testing.assert_array_equal(np.concatenate([piece.theta for piece in pieces]), log.theta)
    out = tmp_path / "estimate.parquet"
    done = CliRunner().invoke(
        cli.main, ["estimate", str(tmp_path / "robot.yaml"), str(tmp_path / name), "--out", str(out)]
    )
    assert done.exit_code == 0, done.stderr
    assert len(pd.read_parquet(out)) == len(WHOLE)


def test_columns_are_named_by_where_they_are(tmp_path):
    write_mat(tmp_path / "log.mat")
    names = ArrayTable(tmp_path / "log.mat").names
    assert names == ["log.time", "log.acc[0]", "log.acc[1]", "log.acc[2]", "log.theta[0]", "log.theta[1]", "log.tau[0]",
                     "log.tau[1]", "parts[0].x", "parts[1].x"]  # fmt: skip
    with h5py.File(tmp_path / "table.h5", "w") as file:
        file["run"] = np.array([(0.0, 1, b"x"), (0.1, 2, b"y")], [("t", float), ("theta", "i4"), ("note", "S1")])
    table = ArrayTable(tmp_path / "table.h5")
    assert table.names == ["run.t", "run.theta"]
    assert table.read(["run.theta"]).to_pydict() == {"run.theta": [1.0, 2.0]}


def test_what_cannot_be_read_is_one_line(tmp_path, monkeypatch):
    write_mat(tmp_path / "log.mat")
    with pytest.raises(LogError, match=r"column 'parts\[1\]\.x' has 2 rows where the others have 3"):
        ArrayTable(tmp_path / "log.mat").read(["parts[0].x", "parts[1].x"])
    with pytest.raises(LogError, match=r"log\.mat: column 't' is missing"):
        Log.read(tmp_path / "log.mat", Robot.load(FOLDER / "robot.yaml"))
    (tmp_path / "text.mat").write_text("no matrix")
    with pytest.raises(LogError, match=r"text\.mat: cannot be read"):
        ArrayTable(tmp_path / "text.mat")
    write_hdf5(tmp_path / "log.h5")
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(LogError, match=r"h5py is needed to read this: pip install 'linkside\[hdf5\]'"):
        ArrayTable(tmp_path / "log.h5")


@settings(max_examples=60)
@given(place=st.floats(0, 1), noise=st.binary(max_size=8), cut=st.booleans(), kind=st.sampled_from(["mat", "h5"]))
def test_broken_files_are_read_or_refused(tmp_path_factory, place, noise, cut, kind):
    path = tmp_path_factory.getbasetemp() / f"broken.{kind}"
    table = {"t": np.arange(50.0), "x": np.arange(100.0).reshape(50, 2)}
    if kind == "mat":
        savemat(path, table)
    else:
        with h5py.File(path, "w") as file:
            for name, array in table.items():
                file[name] = array
    whole = path.read_bytes()
    at = int(place * len(whole))
    path.write_bytes(whole[:at] + noise + (b"" if cut else whole[at + len(noise) :]))
    with suppress(LogError):
        broken = ArrayTable(path)
        broken.read(broken.names[:1])
