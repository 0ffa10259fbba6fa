"""The table of docs/record.md: error of the tool where a recording has fewer rows a second."""

from collections.abc import Iterator
from pathlib import Path

import pyarrow.parquet as pq

from linkside import (
    AccelerationObserver,
    ElasticJointFilter,
    Estimate,
    EstimatorError,
    ExtendedKalmanFilter,
    Log,
    LogError,
    RauchTungStriebelSmoother,
    Robot,
)

DATA = Path(__file__).parents[1] / "tests/data"
RECORDINGS = ("arm2_square", "kr15_six_axes", "arm2_square_mismatch")
METHODS = (AccelerationObserver, ExtendedKalmanFilter, RauchTungStriebelSmoother, ElasticJointFilter)
EVERY = (1, 2, 4, 10, 20, 40)


def errors(name: str, every: int) -> Iterator[str]:
    """The rate [Hz], and each method's error of the tool [mm], from every so-manyth row of a recording."""
    robot, truth = Robot.load(DATA / name / "robot.yaml"), Estimate.read(DATA / name / "truth.parquet")
    table = pq.read_table(DATA / name / "log.parquet")
    log = Log.from_table(table.take(list(range(0, len(table), every))), robot, check=False)  # robot.yaml says 2000 Hz
    yield f"{1 / log.period:.0f}"
    for method in METHODS:
        try:
            yield f"{method(robot).run(log).error_against(truth).tool_rms_centred_mm:.3f}"
        except (EstimatorError, LogError):
            yield "refused"


def main() -> None:
    """Print the table."""
    for name in RECORDINGS:
        for every in EVERY:
            print(f"| {name} | " + " | ".join(errors(name, every)) + " |", flush=True)


if __name__ == "__main__":
    main()
