"""Calibration of robots drawn from their tolerances: what it makes of the tool's error, from each robot's log alone.

A robot.yaml is made up and a robot drawn from its tolerances, as in `drawn_robots.py`; what that robot's sensors read
calibrates the robot.yaml. Prints, for each robot, the tool error of EKF and smoother after calibration over that
before; 1 where the outcome is not accepted, for then robot.yaml stays as it is.
"""

import argparse
import runpy
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from ruamel.yaml import YAML

from linkside import ExtendedKalmanFilter, RauchTungStriebelSmoother, Robot
from linkside.calibration import calibrate
from linkside.errors import LinksideError

DRAWN = runpy.run_path(str(Path(__file__).with_name("drawn_robots.py")))
METHODS = (ExtendedKalmanFilter, RauchTungStriebelSmoother)


def main() -> None:
    """Print a line for each robot, then a summary."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", type=int, default=100)
    parser.add_argument("--first", type=int, default=0, help="number of the first, which is its seed")
    options = parser.parse_args()
    ratios = []
    for specimen in specimens(options.robots, options.first):
        ratio, said = judged(specimen)
        ratios.append(ratio)
        print(f"{specimen.name}: {ratio.round(3)} {said}", flush=True)
    found = np.array(ratios)
    worse = int((found.max(axis=1) > 1.02).sum())
    print(f"median {np.median(found, axis=0).round(3)}, largest {found.max(axis=0).round(3)}, {worse} above 1.02")


def specimens(count: int, first: int = 0) -> Iterator[Any]:
    """So many drawn robots that have accelerometers."""
    seeds = (seed for seed in range(first, 1 << 20) if seed & 2)
    return (DRAWN["drawn"](next(seeds)) for _ in range(count))


def judged(specimen: Any) -> tuple[np.ndarray, str]:
    """Ratio of tool errors after and before, of each of `METHODS`, and what came of it in a few words."""
    with TemporaryDirectory() as name:
        return _judged(specimen, Path(name))


def _judged(specimen: Any, folder: Path) -> tuple[np.ndarray, str]:
    kept(specimen, folder)
    nominal = Robot.load(folder / "robot.yaml")
    try:
        found = calibrate(nominal, specimen.log)
    except LinksideError as error:
        return np.ones(len(METHODS)), f"refused: {error}"
    found.write(folder / "robot.yaml", folder / "calibrated.yaml")
    before, after = (tool_errors(robot, specimen) for robot in (nominal, Robot.load(folder / "calibrated.yaml")))
    springs = sum(e.parameter.kind == "stiffness" for e in found.estimates)
    said = f"{springs} springs, {1e3 * before[1]:.3f} to {1e3 * after[1]:.3f} mm"
    if not found.accepted:
        return np.ones(len(METHODS)), f"not accepted: {found.objections[0]}; by force {said}"
    return after / before, said


def kept(specimen: Any, folder: Path) -> None:
    """Write the specimen's robot.yaml, with a tool on its last link, and its URDF."""
    urdf = specimen.urdf
    if urdf.startswith("<"):
        (folder / "robot.urdf").write_text(urdf)
        urdf = "robot.urdf"
    settings = specimen.robot.config.model_dump(mode="json", exclude_unset=True)
    link = specimen.robot.accelerometers[-1].link
    with open(folder / "robot.yaml", "w") as file:
        YAML().dump({"urdf": urdf, **settings, "tool": {"link": link, "xyz": [0.0, 0.0, 0.2]}}, file)


def tool_errors(robot: Robot, specimen: Any) -> np.ndarray:
    """Of each of `METHODS`, without its mean, RMS [m]."""
    out = []
    for method in METHODS:
        error = robot.tool_position(method(robot).run(specimen.log).q) - robot.tool_position(specimen.q)
        out.append(np.sqrt(np.mean(np.sum((error - error.mean(axis=0)) ** 2, axis=1))))
    return np.array(out)


if __name__ == "__main__":
    main()
