"""Fleets whose workers and scheduler are killed: every output is there and whole, and nothing is twice."""

import random
import signal
import subprocess
import sys
import time

import psutil
import pyarrow.parquet as pq
import pytest

from linkside import fleet

from .fleets import contents, small_logs

pytest.importorskip("distributed")
pytestmark = pytest.mark.slow

LOGS = 60
CLI = (sys.executable, "-m", "linkside")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = small_logs(tmp_path_factory.mktemp("fleet"), LOGS, rows=800)
    fleet.estimate(folder / "robot.yaml", folder / "logs/*.parquet", folder / "serial", "smoother")
    return folder


def command(out, on):
    logs = ("estimate", "robot.yaml", "logs/*.parquet", "--with", "smoother", "--out", out, "--quiet")
    return (*CLI, *logs, "--on", on, "-j", "2", "--manifest", f"{out}.parquet", "--skip-existing")


def check(folder, out):
    """All outputs, the same bits as by one process, and nothing else; a row of the manifest for each."""
    assert contents(folder / out) == contents(folder / "serial")
    outputs = pq.read_table(folder / f"{out}.parquet")["output"].to_pylist()
    assert len(outputs) == len(set(outputs)) == LOGS


def written(folder, out):
    """How many outputs are there."""
    return sum(path.name.endswith(".parquet") for path in (folder / out).glob("[!.]*"))


def workers(process):
    """Processes that estimate."""
    family = psutil.Process(process.pid).children(recursive=True)
    return [one for one in family if any("spawn_main" in word for word in one.cmdline())]


def test_workers_killed_at_random_moments(folder):
    """A run that loses workers goes on by itself."""
    draw = random.Random(1)
    killed = 0
    run = 0
    while killed < 20:
        run += 1
        process = subprocess.Popen(command(f"killed{run}", "dask"), cwd=folder)
        while process.poll() is None and killed < 20:
            done = written(folder, f"killed{run}")
            while process.poll() is None and written(folder, f"killed{run}") <= done:
                time.sleep(0.02)  # however slow the machine is, workers get something done between two kills
            time.sleep(draw.uniform(0.0, 0.3))
            if process.poll() is None and (alive := workers(process)):
                draw.choice(alive).kill()
                killed += 1
        assert process.wait(300) in (0, 1)  # 1 if a log had no luck four times
        if process.returncode:
            assert subprocess.run(command(f"killed{run}", "dask"), cwd=folder, timeout=300).returncode == 0
        check(folder, f"killed{run}")


def test_scheduler_killed_once(folder):
    """A run without its scheduler ends with an error, and the next one does the rest."""
    address = "tcp://127.0.0.1:18786"
    scheduler = (sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", address, "--no-dashboard")
    worker = (sys.executable, "-m", "distributed.cli.dask_worker", address, "--nthreads", "1", "--no-dashboard")
    quiet = {"cwd": folder, "stderr": subprocess.DEVNULL, "stdout": subprocess.DEVNULL}
    running = [subprocess.Popen(one, **quiet) for one in (scheduler, worker, worker)]
    try:
        first = subprocess.Popen(command("orphans", address), cwd=folder, stderr=subprocess.PIPE, text=True)
        while written(folder, "orphans") < 5:
            assert first.poll() is None, first.stderr.read()
            time.sleep(0.1)
        running[0].kill()
        _, said = first.communicate(timeout=120)
        assert first.returncode == 2
        assert f"the scheduler {address} was lost" in said
        assert written(folder, "orphans") < LOGS
        running.append(subprocess.Popen(scheduler, **quiet))
        running += [subprocess.Popen(worker, **quiet) for _ in range(2)]
        subprocess.run(command("orphans", address), cwd=folder, check=True, timeout=300)
    finally:
        for process in running:
            process.send_signal(signal.SIGTERM)
        for process in running:
            process.wait(60)
    check(folder, "orphans")
