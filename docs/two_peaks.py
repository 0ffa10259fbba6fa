"""Draws two_peaks.svg: a belief with two peaks, which a particle filter holds and a Kalman filter cannot."""

from __future__ import annotations

import runpy
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from drawing import save, style

from linkside import ExtendedKalmanFilter, Noise, ParticleFilter
from linkside.figures.style import COLOURS, finish

HERE = Path(__file__).parent
EXAMPLE = runpy.run_path(str(HERE.parent / "examples/constraints.py"))
START, PEAKS = np.pi - 0.8, [[0.8], [np.pi - 0.8]]
EVERY = 8
"""Rows of the recording for one of the figure."""


@style()
def draw_all() -> None:
    """The pendulum of `examples/constraints.py`, switched on at the further of two postures that read the same."""
    robot, log, _ = EXAMPLE["recording"](START, 0.3, reads=0.0, gravity=EXAMPLE["GRAVITY"])
    known = {"motor_bias": 3.0, "acceleration_bias": 0.02, "transmission": EXAMPLE["ENCODER_STD"], "jerk": 20.0}
    kalman = ExtendedKalmanFilter(robot, Noise(position=3.0, **known)).run(log)
    settings = {"kernel": None, "initial": PEAKS, "seed": 0, "quantiles": (0.05, 0.95)}
    cloud = ParticleFilter(robot, Noise(position=0.02, **known), particles=4000, **settings).run(log)
    t, rows = log.t[::EVERY], slice(None, None, EVERY)
    figure, axes = plt.subplots(figsize=(8, 3.2), layout="constrained")
    low, high = cloud.quantiles[rows, :, 0].T
    axes.fill_between(t, low, high, color=COLOURS[0], alpha=0.25, linewidth=0, label="particles, 5 to 95 %")
    axes.plot(t, np.stack([low, high], axis=1), color=COLOURS[0], linewidth=1)
    axes.plot(t, kalman.q[rows, 0], color=COLOURS[1], label="EKF")
    truth = START + 0.15 * (1 - np.cos(2 * np.pi * np.clip(t - 0.02, 0.0, 1.0)))
    axes.plot(t, truth, "k--", linewidth=1, label="truth")
    axes.set(title="pendulum that reads g sin q: it hangs at 0.8 or at π − 0.8", xlabel="time [s]", ylabel="q [rad]")
    finish(axes)
    save(figure, HERE / "two_peaks.svg")


if __name__ == "__main__":
    draw_all()
