"""Calibration and comparison of several logs on threads and clusters: the same bits as one after the other."""

import logging
import os
import signal
import warnings
from importlib.util import find_spec

import numpy as np
import pytest
from click.testing import CliRunner

from linkside import EstimatorError, Log, LogError, Robot, cli, fleet
from linkside.calibration import calibrate_together
from linkside.errors import RecordingWarning
from linkside.files.writing import write_text
from linkside.fleet import mapped

from .fleets import object_store, small_logs

LOGS = 2


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = small_logs(tmp_path_factory.mktemp("mapped"), LOGS, rows=500)
    fleet.estimate(folder / "robot.yaml", folder / "logs/*.parquet", folder / "estimates", workers=1)
    return folder


@pytest.fixture(autouse=True)
def _inside(folder, monkeypatch):
    monkeypatch.chdir(folder)


@pytest.fixture(scope="module")
def scheduler(folder):
    """Address of a cluster of two workers in the folder, which gives a log up when it has ended two of them."""
    if not find_spec("distributed"):
        yield None
        return
    import dask
    import distributed

    settings = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": "127.0.0.1:0"}
    with pytest.MonkeyPatch.context() as patch, dask.config.set({"distributed.scheduler.allowed-failures": 1}):
        patch.chdir(folder)
        with distributed.LocalCluster(**settings, silence_logs=logging.CRITICAL) as cluster:
            yield cluster.scheduler_address


def places(scheduler):
    """Where work can be done, as options."""
    yield ("-j", "2")
    if scheduler is not None:
        yield ("--on", scheduler)


def invoke(*arguments):
    return CliRunner().invoke(cli.main, [*map(str, arguments)])


def outputs_of(folder, scheduler, out, *arguments):
    """What a command writes, one log after the other and everywhere else; nothing else may be left."""
    before = set(os.listdir(folder))
    for place in (("-j", "1"), *places(scheduler)):
        result = invoke(*arguments, "--out", folder / out, *place)
        assert (folder / out).exists(), result.output
        yield (folder / out).read_bytes()
        (folder / out).unlink()
        assert set(os.listdir(folder)) == before


def test_a_robot_is_calibrated_to_the_same_file(folder, scheduler):
    options = ("--free", "stiffness_a1", "--force", "--no-check")
    serial, *others = outputs_of(folder, scheduler, "out.yaml", "calibrate", "robot.yaml", "logs/*.parquet", *options)
    assert b"calibrated:" in serial
    assert others
    assert all(other == serial for other in others)


@pytest.mark.parametrize("options", [("--align", "start"), ("--align", "start", "--repeats", "--robot", "robot.yaml")])
def test_estimates_are_compared_to_the_same_file(folder, scheduler, options):
    reference = "estimates/log000.estimate.parquet"
    serial, *others = outputs_of(folder, scheduler, "out.json", "compare", reference, "estimates/*.parquet", *options)
    assert b"log001" in serial
    assert others
    assert all(other == serial for other in others)


def test_logs_of_a_store_are_calibrated_and_compared(folder, monkeypatch):
    for package in ("obstore", "moto", "flask"):
        pytest.importorskip(package)
    options = ("--align", "start", "-j", "2")
    here = invoke("compare", "logs/log000.parquet", "estimates/*.parquet", *options, "--out", "here.csv")
    assert here.exit_code == 0, here.output
    with object_store(monkeypatch, every=5, delay=0.02) as store:
        for path in (*(folder / "logs").iterdir(), *(folder / "estimates").iterdir()):
            store.put(f"fleet/{path.parent.name}/{path.name}", path.read_bytes())
        there = ("s3://fleet/logs/log000.parquet", "s3://fleet/estimates/*.parquet")
        result = invoke("compare", *there, *options, "--out", "s3://fleet/there.csv")
        assert result.exit_code == 0, result.output
        assert store.get("fleet/there.csv") == (folder / "here.csv").read_bytes()
        free = ("--free", "stiffness_a1", "--force", "--no-check")
        for logs, out in (("s3://fleet/logs/*.parquet", "there.yaml"), ("logs/*.parquet", "here.yaml")):
            result = invoke("calibrate", "robot.yaml", logs, *free, "--out", out)
            assert (folder / out).exists(), result.output
    assert (folder / "there.yaml").read_bytes() == (folder / "here.yaml").read_bytes()


def halved(x):
    """Half of an array, with a warning; not of one that is not finite."""
    if not np.isfinite(x).all():
        raise LogError("x is not finite")
    warnings.warn("halved", RecordingWarning, stacklevel=1)
    assert x.flags.aligned
    assert x.flags.writeable
    return x / 2


def last(_):
    """End the process."""
    os.kill(os.getpid(), signal.SIGTERM if os.name == "nt" else signal.SIGKILL)


def test_results_errors_and_warnings_come_back_from_a_cluster(scheduler):
    pytest.importorskip("distributed")
    tasks = [np.arange(float(i + 1)) for i in range(5)]
    with mapped(scheduler) as run:
        with pytest.warns(RecordingWarning, match="halved"):
            found = list(run(halved, tasks))
        assert all((a == b / 2).all() for a, b in zip(found, tasks, strict=True))
        with pytest.raises(LogError, match="x is not finite"):
            list(run(halved, [np.array([np.nan])]))
        with pytest.raises(EstimatorError, match="2 workers died of this log"):
            list(run(last, [0]))


def test_many_logs_are_calibrated_together_on_a_cluster(folder, scheduler):
    pytest.importorskip("distributed")
    robot = Robot.load(folder / "robot.yaml")
    logs = sorted((folder / "logs").iterdir())
    serial = calibrate_together(robot, logs, free=["stiffness"])
    with mapped(scheduler) as run:
        found = calibrate_together(robot, logs, free=["stiffness"], run=run)
    assert found.robot == serial.robot
    with mapped(workers=2) as run:
        found = calibrate_together(robot, [Log.read(log, robot) for log in logs], free=["stiffness"], run=run)
    assert found.robot == serial.robot


def test_the_workers_are_one_or_more():
    with pytest.raises(EstimatorError, match="workers"), mapped(workers=0):
        write_text("never.txt", "")
