"""An interrupted calibration goes on where it was."""

from __future__ import annotations

import json
from pathlib import Path

from linkside.errors import ConfigError

from .search import Step


def keep(path: str | Path, step: Step) -> None:
    """Write the best point so far, in one move so that no half of it is ever there."""
    target = Path(path)
    part = target.with_name(target.name + ".part")
    part.write_text(json.dumps({"log_likelihood": step.log_likelihood, "z": step.z}, indent=1), encoding="utf-8")
    part.replace(target)


def kept(path: str | Path) -> dict[str, float]:
    """Read the best point of an interrupted run, by name in tolerances.

    Raises
    ------
    ConfigError
        The file is not there, or is none of ours.
    """
    try:
        found = json.loads(Path(path).read_text(encoding="utf-8"))["z"]
        return {str(name): float(z) for name, z in found.items()}
    except OSError:
        raise ConfigError(f"{path}: no interrupted calibration to go on with") from None
    except (ValueError, KeyError, TypeError, AttributeError):
        raise ConfigError(f"{path}: expected the state of a calibration, as an interrupted run leaves it") from None
