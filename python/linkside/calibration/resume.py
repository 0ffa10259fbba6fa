"""Resume an interrupted calibration."""

from __future__ import annotations

import json
import math
from pathlib import Path

from linkside.errors import ConfigError

from ..files.regular import instead
from ..files.writing import write_text
from .search import Step


def keep(path: str | Path, step: Step) -> None:
    """Write the best point so far, in one move so that no half of it is ever there."""
    write_text(path, json.dumps({"log_likelihood": step.log_likelihood, "z": step.z}, indent=1))


def kept(path: str | Path) -> dict[str, float]:
    """Read the best point of an interrupted run, by name in tolerances.

    Raises
    ------
    ConfigError
        The file is not there, or is none of ours.
    """
    try:
        if instead(path):
            raise OSError
        found = json.loads(Path(path).read_text(encoding="utf-8"))["z"]
        start = {str(name): float(z) for name, z in found.items()}
    except OSError:
        raise ConfigError(f"{path}: no interrupted calibration to go on with") from None
    except (ValueError, KeyError, TypeError, AttributeError):
        raise ConfigError(f"{path}: expected the state of a calibration, as an interrupted run leaves it") from None
    for name, z in start.items():
        if not math.isfinite(z):
            raise ConfigError(f"{path}: '{name}' is {z}, expected a finite number")
    return start
