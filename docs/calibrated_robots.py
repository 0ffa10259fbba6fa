"""Calibration of robots drawn from their tolerances: what it makes of the tool's error, from each robot's log alone.

A robot.yaml is made up and a robot drawn from its tolerances, as in `drawn_robots.py`; what that robot's sensors read
calibrates the robot.yaml. Prints, for each robot, the tool error of EKF and smoother after calibration over that
before; 1 where the outcome is not accepted, for then robot.yaml stays as it is. At the end, how many of the true values
of each kind are within 1.96 standard errors.
"""

import argparse
import runpy
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from ruamel.yaml import YAML
from scipy.spatial.transform import Rotation

from linkside import ExtendedKalmanFilter, RauchTungStriebelSmoother, Robot
from linkside.calibration import calibrate
from linkside.calibration.result import Estimated, Result
from linkside.errors import LinksideError

DRAWN = runpy.run_path(str(Path(__file__).with_name("drawn_robots.py")))
METHODS = (ExtendedKalmanFilter, RauchTungStriebelSmoother)


def main() -> None:
    """Print a line for each robot, then a summary."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", type=int, default=100)
    parser.add_argument("--first", type=int, default=0, help="number of the first, which is its seed")
    options = parser.parse_args()
    ratios, off = [], defaultdict(list)
    for specimen in specimens(options.robots, options.first):
        ratio, said, scores = judged(specimen)
        ratios.append(ratio)
        for kind, score in scores:
            off[kind].append(abs(score))
        print(f"{specimen.name}: {ratio.round(3)} {said}", flush=True)
    found = np.array(ratios)
    worse = int((found.max(axis=1) > 1.02).sum())
    print(f"median {np.median(found, axis=0).round(3)}, largest {found.max(axis=0).round(3)}, {worse} above 1.02")
    for kind, scores in off.items():
        print(f"{kind}: {np.mean(np.array(scores) < 1.96):.0%} of {len(scores)} within 1.96 standard errors")


def specimens(count: int, first: int = 0) -> Iterator[Any]:
    """So many drawn robots that have accelerometers."""
    seeds = (seed for seed in range(first, 1 << 20) if seed & 2)
    return (DRAWN["drawn"](next(seeds)) for _ in range(count))


def judged(specimen: Any) -> tuple[np.ndarray, str, list[tuple[str, float]]]:
    """Ratio of tool errors after and before, of each of `METHODS`, what came of it in a few words, and `scores`."""
    with TemporaryDirectory() as name:
        return _judged(specimen, Path(name))


def _judged(specimen: Any, folder: Path) -> tuple[np.ndarray, str, list[tuple[str, float]]]:
    kept(specimen, folder)
    nominal = Robot.load(folder / "robot.yaml")
    try:
        found = calibrate(nominal, specimen.log)
    except LinksideError as error:
        return np.ones(len(METHODS)), f"refused: {error}", []
    found.write(folder / "robot.yaml", folder / "calibrated.yaml")
    before, after = (tool_errors(robot, specimen) for robot in (nominal, Robot.load(folder / "calibrated.yaml")))
    springs = sum(e.parameter.kind == "stiffness" for e in found.estimates)
    said = f"{springs} springs, {1e3 * before[1]:.3f} to {1e3 * after[1]:.3f} mm"
    if not found.accepted:
        return np.ones(len(METHODS)), f"not accepted: {found.objections[0]}; by force {said}", scores(found, specimen)
    return after / before, said, scores(found, specimen)


def scores(found: Result, specimen: Any) -> list[tuple[str, float]]:
    """Kinds of estimates, and how far these are from the truth in standard errors; positive ones by their logarithms.

    All masses are by that of the heaviest link, whose own is held. Where a damping is zero it has no score.
    """
    masses = {drive.name: drive.mass_scale for drive in specimen.true.drives}
    freed = {e.parameter.name for e in found.estimates} | set(found.refused)
    unit = next((scale for name, scale in masses.items() if f"mass_scale_{name}" not in freed), 1.0)
    truth = {f"mass_scale_{name}": scale / unit for name, scale in masses.items()}
    for kind in ("stiffness", "damping"):
        truth |= {f"{kind}_{d.name}": getattr(d, kind) / unit for d in specimen.true.drives if getattr(d, kind)}
    for sensor, true in zip(specimen.robot.accelerometers, specimen.true.accelerometers, strict=True):
        own, other = (Rotation.from_euler("xyz", s.rpy) for s in (sensor, true))
        moved = own.inv().apply(np.subtract(true.xyz, sensor.xyz)).tolist()
        turned = (own.inv() * other).as_rotvec().tolist()
        truth |= {f"translation_{sensor.name}_{axis}": x for axis, x in zip("xyz", moved, strict=True)}
        truth |= {f"rotation_{sensor.name}_{axis}": x for axis, x in zip("xyz", turned, strict=True)}
    told = [e for e in found.estimates if e.parameter.name in truth and not e.at_bound]
    return [(e.parameter.kind, _score(e, truth[e.parameter.name])) for e in told]


def _score(e: Estimated, true: float) -> float:
    return float(np.log(e.value / true) * e.value / e.std) if e.parameter.relative else (e.value - true) / e.std


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
