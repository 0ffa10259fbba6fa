"""Modules under the names that they had before they were sorted into packages.

``from linkside.trajectories import spline`` gives what ``from linkside.control.trajectories import spline`` gives.
"""

import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import spec_from_loader
from types import ModuleType

MOVED = {
    "check": "observability.analysis",
    "closed_loop": "control.closed_loop",
    "config": "robot.config",
    "consistency_figure": "consistency.figure",
    "controllers": "control.controllers",
    "cutting_planes": "velocity.cutting_planes",
    "elastic": "kalman.elastic_joint",
    "estimate": "recording.estimate",
    "feedback": "control.feedback",
    "filtering": "kalman.filtering",
    "fixed_lag": "kalman.fixed_lag",
    "gain_design": "velocity.gain_design",
    "gain_map": "velocity.gain_map",
    "log": "recording.log",
    "methods": "cli.methods",
    "noise": "kalman.noise",
    "nonlinear_gain": "velocity.shaped_gain",
    "observer_tuning": "observers.tuning_file",
    "placement": "observability.placement",
    "plots": "figures.style",
    "poles": "observers.poles",
    "progress": "cli.terminal",
    "residual": "velocity.residual",
    "sensing": "kalman.late_sensors",
    "sensors": "observability.sensors",
    "source": "files.yaml_source",
    "stretches": "kalman.stretches",
    "tables": "files.tables",
    "trajectories": "control.trajectories",
    "tree": "robot.compile",
    "tune": "tuning.noise_likelihood",
    "tune_observer": "tuning.observer_front",
    "urdf": "robot.urdf",
}
"""Where each module is now, by its name of before."""


class Moved(MetaPathFinder, Loader):
    """Finds a module under its old name."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Know the modules of `MOVED`."""
        package, _, name = fullname.partition(".")
        return spec_from_loader(fullname, self) if package == "linkside" and name in MOVED else None

    def exec_module(self, module: ModuleType) -> None:
        """Put the module of today in place of the one that is being made."""
        name = module.__name__
        sys.modules[name] = import_module(f"linkside.{MOVED[name.partition('.')[2]]}")
