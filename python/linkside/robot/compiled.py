"""Estimators for controllers: one file with the robot and all settings, which needs no Python to be run."""

from __future__ import annotations

from abc import ABC, abstractmethod
from importlib.metadata import version
from os import PathLike
from typing import Any

from linkside import _core
from linkside.arguments import time_step
from linkside.errors import EstimatorError
from linkside.files.writing import check_writable, write_bytes

from .robot import Robot

SUFFIX = ".lsr"


class Compiles(ABC):
    """An estimator that a controller can run."""

    robot: Robot

    def compile(self, path: str | PathLike[str], *, period: float | None = None) -> dict[str, int]:
        """Write robot and settings into one file, for the C, C++ and Rust interfaces: they give the bits of `step`.

        Parameters
        ----------
        path
            A file that ends in ``.lsr``; written whole or not at all.
        period
            Sampling period of the controller [s]; by default that of `step`, or ``rate_hz`` of robot.yaml.

        Returns
        -------
        dict
            The signals that a sample has, and how many entries each.

        Raises
        ------
        EstimatorError
            A setting that only a recording can tell, as where a filter starts by default: ``start="rest"``, or a state.
        OutputError
            The file cannot be written.
        """
        check_writable(path, (SUFFIX,))
        robot = self.robot
        content, signals = _core.compiled(
            {
                "writer": f"linkside {version('linkside')}",
                "joints": robot.names,
                "accelerations": robot.acceleration_channels,
                "rates": robot.gyroscope_channels,
                "robot": robot.described(),
                "estimator": self._controller(period),
            }
        )
        write_bytes(path, content)
        return signals

    @abstractmethod
    def _controller(self, period: float | None) -> dict[str, dict[str, Any]]:
        """The core's name of the method, and its settings in plain numbers."""


def period_of(robot: Robot, period: float | None, why: str) -> float:
    """Give the sampling period, if it was not given that of robot.yaml; it must be known."""
    if period is not None:
        return time_step(period)
    if robot.config.rate_hz is None:
        raise EstimatorError(f"compile needs the sampling period, {why}: give period=…, or rate_hz in robot.yaml")
    return 1 / robot.config.rate_hz
