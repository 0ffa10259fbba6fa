"""How much faster two workers are than one, and what a cluster costs: `python benches/python/fleet_scaling.py`.

On an idle machine with two cores or more, some minutes. 200 logs of 20 s at 2 kHz are estimated by one worker and by
two, in turn, on threads and on Dask; the overhead is the wall-clock time of one worker less the time that logs took on
it, as a share. `--logs 8 --repeats 1` tries it out. The exit status is 1 if two workers are less than 1.8 times as fast
as one, or the overhead is 5 % or more.
"""

import argparse
import os
import shutil
import statistics
import sys
import tempfile
import time
from pathlib import Path

SECONDS = 20.0
RATIO, OVERHEAD = 1.8, 0.05


def main() -> int:
    """Measure, and print a line for each place."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--logs", type=int, default=200)
    parser.add_argument("--method", default="ekf")
    parser.add_argument("--repeats", type=int, default=3)
    asked = parser.parse_args()
    os.environ |= dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "RAYON_NUM_THREADS"), "1")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        make_logs(folder, asked.logs)
        results = [measure(folder, on, asked.method, asked.repeats) for on in (None, "dask")]
    print(f"{asked.logs} logs of {SECONDS:g} s, {asked.method}, medians of {asked.repeats}")
    for on, one, two, overhead in results:
        print(
            f"{on or 'threads':8} one worker {one:7.1f} s, two {two:7.1f} s: {one / two:.2f} times as fast; "
            f"overhead {overhead:.1%} of one worker's time"
        )
    return 0 if all(one / two >= RATIO and overhead < OVERHEAD for _, one, two, overhead in results) else 1


def make_logs(folder: Path, count: int) -> None:
    """One log of 20 s, from the demonstration's repeated, under many names."""
    import numpy as np
    import pyarrow as pa
    import pyarrow.parquet as pq

    from linkside import demo

    for file in ("robot.yaml", "robot.urdf"):
        shutil.copy(demo.FOLDER / file, folder)
    whole = pq.read_table(demo.LOG)
    period = float(np.median(np.diff(whole["t"])))
    there_and_back = pa.concat_tables([whole, whole.take(np.arange(len(whole))[::-1])])
    rows = round(SECONDS / period)
    table = pa.concat_tables([there_and_back] * -(-rows // len(there_and_back))).slice(0, rows)
    at = table.column_names.index("t")
    (folder / "logs").mkdir()
    pq.write_table(table.set_column(at, "t", pa.array(period * np.arange(rows))), folder / "logs" / "log0000.parquet")
    for i in range(1, count):
        shutil.copy(folder / "logs" / "log0000.parquet", folder / "logs" / f"log{i:04}.parquet")


def measure(folder: Path, on: str | None, method: str, repeats: int) -> tuple[str | None, float, float, float]:
    """Median wall-clock times of one worker and of two [s], and the median overhead, one after the other in turn."""
    times: dict[int, list[float]] = {1: [], 2: []}
    overheads = []
    for _ in range(repeats):
        for workers in times:
            took, worked = run(folder, on, workers, method)
            times[workers].append(took)
            if workers == 1:
                overheads.append(took / worked - 1)
    return on, statistics.median(times[1]), statistics.median(times[2]), statistics.median(overheads)


def run(folder: Path, on: str | None, workers: int, method: str) -> tuple[float, float]:
    """Wall-clock time from the first log's begin to the last one's end, and the sum of the logs' own times [s].

    The start of a cluster, some seconds, is not in it: it does not grow with the number of logs.
    """
    from linkside import fleet

    out = folder / "out"
    outcomes = fleet.estimate(
        folder / "robot.yaml", folder / "logs/*.parquet", out, method, on=on, workers=workers, check=False
    )
    ended = time.time()
    if bad := [outcome.error for outcome in outcomes if outcome.error is not None]:
        raise SystemExit(f"{len(bad)} logs failed: {bad[0]}")
    shutil.rmtree(out)
    took = max(min(ended, max(o.begun + o.elapsed for o in outcomes)) - min(o.begun for o in outcomes), 1e-9)
    return took, sum(outcome.elapsed for outcome in outcomes)


if __name__ == "__main__":
    sys.exit(main())
