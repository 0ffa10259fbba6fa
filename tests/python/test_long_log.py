"""Recordings of any length in bounded memory: streamed in, estimated piece by piece, streamed out."""

import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from linkside import Log, Robot

FOLDER = Path(__file__).parents[1] / "data/kr15_six_axes"
RATE = 2000  # Hz
MB = 1e6

pytestmark = pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="peak memory is read from /proc")

# The peak is that of the program itself: `resource.getrusage` of a child begins with what its parent had in use.
ESTIMATE = """
import sys
from linkside import AccelerationObserver, EstimateWriter, Log, Robot

robot, log, out = Robot.load(sys.argv[1]), sys.argv[2], sys.argv[3]
with EstimateWriter(out) as writer:
    for estimate in AccelerationObserver(robot).run_pieces(Log.stream(log, robot)):
        writer.write(estimate)
lines = open("/proc/self/status").read().splitlines()
print(next(line.split()[1] for line in lines if line.startswith("VmHWM")))
"""


def there_and_back():
    """The recorded motion and then the same backwards: accelerations stay, friction turns round."""
    robot = Robot.load(FOLDER / "robot.yaml")
    log = Log.read(FOLDER / "log.parquet", robot)
    friction = [drive.motor_friction for drive in robot.drives]
    drag = log.dtheta * [f.viscous for f in friction] + np.sign(log.dtheta) * [f.coulomb for f in friction]
    motion = {"theta": log.theta, "tau": log.tau, "acceleration": log.acceleration}
    back = {**motion, "tau": log.tau - 2 * drag}
    names = [f"{signal}_{joint}" for signal in ("theta", "tau") for joint in robot.names]
    values = np.hstack([np.vstack([motion[signal], back[signal][::-1]]) for signal in motion])
    return dict(zip([*names, *robot.acceleration_channels], values.T, strict=True))


def write_log(path, seconds):
    """Repeat the motion, a row group each time; gives the rows of one motion, there and back, and of all."""
    columns = there_and_back()
    rows = len(columns["theta_a1"])
    count = round(seconds * RATE / rows)
    schema = pa.schema([(name, pa.float64()) for name in ("t", *columns)])
    with pq.ParquetWriter(path, schema) as writer:
        for turn in range(count):
            t = (turn * rows + np.arange(rows)) / RATE
            writer.write_table(pa.table({"t": t, **columns}))
    return rows, count * rows


def estimate(tmp_path, seconds):
    """Estimate a log of this length in a process of its own; gives its peak memory [MB]."""
    log, out = tmp_path / f"{seconds}.parquet", tmp_path / f"{seconds}_estimate.parquet"
    one, rows = write_log(log, seconds)
    start = time.perf_counter()
    arguments = [sys.executable, "-c", ESTIMATE, FOLDER / "robot.yaml", log, out]
    done = subprocess.run(arguments, check=True, capture_output=True, text=True)
    peak = int(done.stdout) * 1024 / MB
    print(f"{rows} rows: {peak:.0f} MB, {time.perf_counter() - start:.1f} s")
    assert_steady(out, one, rows)
    return peak


def assert_steady(path, one, rows):
    """The last motion is estimated as the second was, and no row is worth a remark."""
    table = pq.read_table(path, columns=["t", "q_a1", "q_a6", "status"])
    assert table.num_rows == rows
    assert not table["status"].to_numpy().any()
    np.testing.assert_allclose(table["t"].to_numpy(), np.arange(rows) / RATE, rtol=0, atol=1e-9)
    for name in ("q_a1", "q_a6"):
        q = table[name].to_numpy()
        np.testing.assert_allclose(q[-one:], q[one : 2 * one], rtol=0, atol=1e-9)


def test_memory_does_not_grow_with_the_recording(tmp_path):
    """Both are longer than the pieces read and the groups written; the rows between them are 125 MB in all."""
    short, long = (estimate(tmp_path, seconds) for seconds in (90, 240))
    assert long < short + 50
    assert long < 1000


@pytest.mark.slow
def test_an_hour_of_six_joints_fits_into_a_gigabyte(tmp_path):
    assert estimate(tmp_path, 3600) < 1000
