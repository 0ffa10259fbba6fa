"""One accelerometer axis with outliers: what normal noise, Student's and a mixture make of them.

2 % of an axis' readings are off by 50 standard deviations. A Kalman filter believes them unless it has a gate.

    python examples/outliers.py [recording]
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

import linkside

RECORDING = Path(__file__).parents[1] / "tests/data/arm2_square"
SHARE, SIZE, NOISE_STD = 0.02, 50, 0.05


def main() -> None:
    """Spoil the recording, estimate, compare."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("recording", type=Path, nargs="?", default=RECORDING, help="its folder")
    folder = parser.parse_args().recording
    robot = linkside.Robot.load(folder / "robot.yaml")
    log = linkside.Log.read(folder / "log.parquet", robot)
    kalman = linkside.ExtendedKalmanFilter(robot)
    gated = linkside.ExtendedKalmanFilter(robot, gate=5.0)
    normal = linkside.ParticleFilter(robot, particles=500, kernel=1.0)
    student = linkside.ParticleFilter(robot, particles=500, kernel=1.0, outliers={"acceleration": 4.0})
    mixture = linkside.Mixture(share=SHARE, scale=SIZE)
    mixed = linkside.ParticleFilter(robot, particles=500, kernel=1.0, outliers={"acceleration": mixture})
    methods = {"EKF": kalman, "EKF, gate of 5": gated, "particles": normal}
    methods |= {"particles, Student's noise": student, "particles, a mixture": mixed}
    spoiled = with_outliers(log)
    print(f"{'tool, offset out, RMS [mm]':28}{'clean':>8}{'spoiled':>9}")
    for name, method in methods.items():
        errors = (method.run(one).error_against(folder / "truth.parquet").tool_rms_centred for one in (log, spoiled))
        print(f"{name:28}" + "".join(f"{error:8.3f} " for error in errors))


def with_outliers(log: linkside.Log) -> linkside.Log:
    """Give the same log with outliers in the first accelerometer axis."""
    rng = np.random.default_rng(5)
    acceleration = log.acceleration.copy()
    hit = rng.random(len(log)) < SHARE
    acceleration[hit, 0] += SIZE * NOISE_STD * rng.choice([-1, 1], hit.sum())
    return replace(log, acceleration=acceleration)


if __name__ == "__main__":
    main()
