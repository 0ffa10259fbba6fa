"""The tuning file of an observer: its poles, and parameters of its drives."""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from linkside.errors import ConfigError
from linkside.files.yaml_source import Source, write_yaml
from linkside.robot import Robot

from .acceleration import AccelerationObserver
from .poles import PolePattern, damped

Values = dict[str, Annotated[float, Field(gt=0, allow_inf_nan=False)]]

DRIVE = ("stiffness", "damping", "motor_inertia")
START = 250.0
"""Poles where none are given [rad/s]."""


class ObserverTuning(BaseModel):
    """An observer's poles and parameters of its drives, by joint; those not named are as in robot.yaml.

    Attributes
    ----------
    poles
        Frequency of a well-damped pattern of poles [rad/s].
    stiffness, damping, motor_inertia
        In place of robot.yaml's [N m/rad, N m s/rad, kg m²].
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    poles: Values = {}
    stiffness: Values = {}
    damping: Values = {}
    motor_inertia: Values = {}

    @classmethod
    def read(cls, path: str | PathLike[str]) -> ObserverTuning:
        """Read a tuning file, as `write` makes it; `ConfigError` names file, line and key."""
        return Source.read(path).validate(cls)

    def write(self, path: str | Path) -> None:
        """Write a tuning file, for ``linkside estimate --with observer --tuning``."""
        write_yaml(path, self.model_dump(exclude_defaults=True))

    def robot(self, robot: Robot) -> Robot:
        """Give the robot with these drives; `ConfigError` names a joint that it does not have."""
        for key in ("poles", *DRIVE):
            if unknown := set(getattr(self, key)) - set(robot.names):
                raise ConfigError(f"{key}: no joint '{sorted(unknown)[0]}'; there are {', '.join(robot.names)}")
        changes = {
            name: {key: getattr(self, key)[name] for key in DRIVE if name in getattr(self, key)} for name in robot.names
        }
        joints = tuple(joint.model_copy(update=changes[joint.name]) for joint in robot.drives)
        return Robot(robot.config.model_copy(update={"joints": joints}), robot.tree)

    def observer(self, robot: Robot, poles: PolePattern | None = None, **settings: Any) -> AccelerationObserver:
        """Make the observer.

        Parameters
        ----------
        poles
            Of joints that the tuning does not name; `START` in a well-damped pattern by default.
        **settings
            Further ones of `AccelerationObserver`.
        """
        adjusted = self.robot(robot)
        others = poles or damped(START)
        own = {name: damped(frequency) for name, frequency in self.poles.items()}
        return AccelerationObserver(adjusted, {name: own.get(name, others) for name in robot.names}, **settings)
