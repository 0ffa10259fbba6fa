"""A Kalman filter over hours: its covariance stays symmetric and positive, and memory does not grow."""

import resource
from pathlib import Path

import numpy as np
import pytest

from linkside import ExtendedKalmanFilter, Log, Noise, Robot

FOLDER = Path(__file__).parents[1] / "data/arm2_square"


def endure(hours):
    """Go round the square for so long: the least eigenvalue of the correlations, and by how much memory grew."""
    robot = Robot.load(FOLDER / "robot.yaml")
    log = Log.read(FOLDER / "log.parquet", robot)
    ekf = ExtendedKalmanFilter(robot, Noise(jerk=15.0))
    kinds = ekf.kinds(log)
    arrays, core = ekf.arrays(log, kinds), ekf.core(kinds, ekf.noise, log.period)
    least, before = np.inf, None
    for _ in range(round(hours * 3600 / log.t[-1])):
        result = core.run(arrays, False, False)
        covariance = core.covariance
        assert np.array_equal(covariance, covariance.T)
        scale = 1 / np.sqrt(np.diag(covariance))
        least = min(least, np.linalg.eigvalsh(covariance * scale * scale[:, None])[0])
        assert result["q_std"].min() > 0
        if before is None:
            before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return least, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before


@pytest.mark.parametrize("hours", [0.1, pytest.param(10, marks=pytest.mark.slow)])
def test_covariance_stays_positive_and_memory_bounded(hours):
    least, grown = endure(hours)
    assert least > 1e-9
    assert grown < 20_000  # kB
