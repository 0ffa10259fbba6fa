"""The table of docs/kalman.md: error of the tool where an accelerometer's samples are struck. Half a minute."""

import dataclasses
from pathlib import Path

import numpy as np

from linkside import Estimate, ExtendedKalmanFilter, IteratedSmoother, Log, Noise, RauchTungStriebelSmoother, Robot

FOLDER = Path(__file__).parents[1] / "tests/data/arm2_square"
METHODS = {"EKF": ExtendedKalmanFilter, "smoother": RauchTungStriebelSmoother, "iterated smoother": IteratedSmoother}
SETTINGS = {
    '`"squares"`': {},
    "`gate=5`": {"gate": 5.0},
    '`"huber"`': {"loss": "huber"},
    '`"student-t"`': {"loss": "student-t"},
}
SHARES, SEEDS, SIZE = (0.0, 0.01, 0.05), 3, 50.0


def struck(log: Log, std: float, share: float, seed: int) -> Log:
    """Normal errors of 50 standard deviations on all axes of a share of the accelerometer's samples."""
    rng = np.random.default_rng(seed)
    rows = rng.random(len(log)) < share
    acceleration = log.acceleration.copy()
    acceleration[rows] += SIZE * std * rng.standard_normal(acceleration[rows].shape)
    return dataclasses.replace(log, acceleration=acceleration)


def main() -> None:
    """Print the table."""
    robot = Robot.load(FOLDER / "robot.yaml")
    log, truth = Log.read(FOLDER / "log.parquet", robot), Estimate.read(FOLDER / "truth.parquet")
    noise = Noise().for_log(log, robot)
    std = robot.accelerometers[0].noise_std
    print("| | " + " | ".join(f"{name}, {100 * share:g} %" for name in METHODS for share in SHARES) + " |")
    for words, settings in SETTINGS.items():
        cells = []
        for method in METHODS.values():
            for share in SHARES:
                logs = [struck(log, std, share, seed) for seed in range(SEEDS if share else 1)]
                estimates = method(robot, noise, link_disturbance=False, **settings).run(logs)
                cells.append(max(estimate.error_against(truth).tool_rms_centred_mm for estimate in estimates))
        print(f"| {words} | " + " | ".join(f"{cell:.4f}" for cell in cells) + " |", flush=True)


if __name__ == "__main__":
    main()
