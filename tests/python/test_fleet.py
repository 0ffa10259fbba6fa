"""Fleets of logs: the same bits on threads and clusters, from files and object stores, and nothing done twice."""

import hashlib
import shutil

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from linkside import EstimatorError, ExtendedKalmanFilter, Log, LogError, OutputError, Robot, fleet
from linkside.fleet import cluster, places

from .fleets import contents, object_store, small_logs

LOGS = 6


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Logs, and their estimates by one thread."""
    folder = small_logs(tmp_path_factory.mktemp("fleet"), LOGS)
    outcomes = fleet.estimate(folder / "robot.yaml", folder / "logs/*.parquet", folder / "serial", "ekf", workers=1)
    assert [outcome.verdict for outcome in outcomes] == ["believable"] * LOGS
    return folder


@pytest.fixture
def folder(made, tmp_path):
    """A copy of those that a test may break."""
    return shutil.copytree(made, tmp_path, dirs_exist_ok=True)


def estimate(folder, logs="logs/*.parquet", out="out", method="ekf", **options):
    logs = [logs] if isinstance(logs, str) else logs
    return fleet.estimate(
        folder / "robot.yaml",
        [log if places.is_url(log) else str(folder / log) for log in logs],
        out if places.is_url(out) else folder / out,
        method,
        **options,
    )


def rows(place):
    """A manifest's rows by the name of the output."""
    table = pq.read_table(place)
    return {row["output"].rsplit("/", 1)[-1]: row for row in table.to_pylist()}, table


def test_threads_give_the_same_bits(folder):
    estimate(folder, workers=3)
    assert contents(folder / "out") == contents(folder / "serial")


def test_a_manifest_has_a_row_for_each_log(folder):
    pa.csv.write_csv(pa.table({"t": [0.0, 1.0]}), folder / "logs/broken.csv")
    estimate(folder, ["logs/*.parquet", "logs/broken.csv"], manifest=folder / "all.parquet")
    found, table = rows(folder / "all.parquet")
    assert len(found) == len(table) == LOGS + 1
    broken = found.pop("broken.estimate.parquet")
    assert broken["verdict"] == "not estimated"
    assert "broken.csv" in broken["error"]
    for name, row in found.items():
        written = pq.read_table(folder / "out" / name)
        assert (row["verdict"], row["rows"], row["good"]) == ("believable", len(written), 1.0)
        assert row["digest"] == hashlib.blake2b((folder / "out" / name).read_bytes(), digest_size=16).hexdigest()
        assert row["elapsed"] > 0
        assert row["worker"]
    robot = Robot.load(folder / "robot.yaml")
    alone = ExtendedKalmanFilter(robot).run(Log.read(folder / "logs/log000.parquet", robot))
    per_reading = alone.nis.sum() / alone.used.sum()
    assert found["log000.estimate.parquet"]["nis_per_reading"] == pytest.approx(per_reading)


def test_only_what_is_missing_or_changed_is_done_again(folder):
    run = {"manifest": folder / "all.parquet", "skip_existing": True}
    assert not any(outcome.kept for outcome in estimate(folder, **run))
    before, _ = rows(folder / "all.parquet")
    (folder / "out/log001.estimate.parquet").unlink()
    shutil.copy(folder / "logs/log000.parquet", folder / "logs/log002.parquet")
    (folder / "out/log003.estimate.parquet").write_bytes(b"PAR1 cut short")
    again = estimate(folder, **run)
    redone = {f"log00{i}.estimate.parquet" for i in (1, 2, 3)}
    assert {outcome.job.output.rsplit("/", 1)[-1] for outcome in again if not outcome.kept} == redone
    after, table = rows(folder / "all.parquet")
    assert len(table) == LOGS
    assert {name for name in after if after[name] != before[name]} == redone
    assert (after["log002.estimate.parquet"]["digest"], after["log001.estimate.parquet"]["digest"]) == (
        before["log000.estimate.parquet"]["digest"],
        before["log001.estimate.parquet"]["digest"],
    )


def test_a_cluster_gives_the_same_bits_by_an_object_store_that_is_slow_and_busy(folder, monkeypatch):
    for package in ("distributed", "obstore", "moto", "flask"):
        pytest.importorskip(package)
    with object_store(monkeypatch, every=5, delay=0.02) as store:
        for path in (folder / "logs").iterdir():
            store.put(f"fleet/logs/{path.name}", path.read_bytes())
        run = {
            "logs": "s3://fleet/logs/*.parquet",
            "out": "s3://fleet/out",
            "manifest": "s3://fleet/all.parquet",
            "skip_existing": True,
        }
        outcomes = estimate(folder, on="dask", workers=2, **run)
        assert [outcome.error for outcome in outcomes] == [None] * LOGS
        assert len({outcome.worker for outcome in outcomes}) == 2
        written = [place.rsplit("/", 1)[-1] for place in places.logs_of(["s3://fleet/out/*"])]
        assert {name: store.get(f"fleet/out/{name}") for name in written} == contents(folder / "serial")
        assert all(outcome.kept for outcome in estimate(folder, **run))
        (folder / "all.parquet").write_bytes(store.get("fleet/all.parquet"))
        assert store.refused > 5
    found, table = rows(folder / "all.parquet")
    assert len(found) == len(table) == LOGS


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({"logs": "logs/*.csv"}, LogError, "logs/*.csv: no such file"),
        ({"method": "ekff"}, EstimatorError, "method is 'ekff', expected one of"),
        ({"particles": 7}, EstimatorError, "particles is not for method 'ekf'"),
        ({"out": "out.parquet"}, OutputError, "one file for 6 logs"),
        ({"out": "logs/{stem}.parquet"}, OutputError, "would be written over what is read"),
        ({"manifest": "robot.yaml"}, LogError, "a manifest is a .parquet file"),
        ({"manifest": "logs/log000.parquet"}, LogError, "not a manifest"),
        ({"on": "tcp://127.0.0.1:9"}, EstimatorError, "no scheduler of Dask at tcp://127.0.0.1:9"),
        ({"out": "{stem}.csv", "skip_existing": True}, OutputError, "only Parquet estimates"),
        ({"workers": 0}, EstimatorError, "workers"),
    ],
)
def test_mistakes_are_named_before_any_log_is_read(folder, monkeypatch, options, error, words):
    before = contents(folder / "logs")
    monkeypatch.chdir(folder)
    monkeypatch.setattr(cluster, "PATIENCE", 0.5)
    with pytest.raises(error) as caught:
        estimate(folder, **options)
    assert words in str(caught.value)
    assert contents(folder / "logs") == before
    assert not (folder / "out").exists()
