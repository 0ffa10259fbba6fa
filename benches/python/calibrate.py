"""Calibration of two joints with ten free parameters, and of six joints with all that is told."""

import time
from collections.abc import Iterator
from pathlib import Path

from timing import Result

from linkside import Log, Robot
from linkside.calibration import calibrate

DATA = Path(__file__).parents[2] / "tests/data"
TEN = ["stiffness", "cubic_stiffness", "damping", "payload_mass", "bias"]
MOST = {"arm2_square_mismatch": 10.0, "kr15_six_axes": 120.0}
"""Seconds that a calibration may take."""


def bench() -> Iterator[Result]:
    """Processor time of all threads, once each: what a single core would take."""
    yield _once("arm2_square_mismatch", TEN)
    yield _once("kr15_six_axes", None)


def _once(name: str, free: list[str] | None) -> Result:
    robot = Robot.load(DATA / name / "robot.yaml")
    log = Log.read(DATA / name / "log.parquet", robot)
    start = time.process_time()
    result = calibrate(robot, log, free)
    seconds = time.process_time() - start
    what = f"calibration, {robot.n} joints, {len(result.estimates)} parameters, {result.evaluations} evaluations"
    samples = len(log)
    return Result(what, 1e6 * seconds / samples, most=1e6 * MOST[name] / samples)
