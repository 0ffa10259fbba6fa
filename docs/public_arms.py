"""Public arms that are as their robot.yaml says, and the same with one faulty channel: what filters say of them.

Arms of the package example-robot-data with springs, dampers, motors and two accelerometers or none go from one posture
to another and back, at several rates. Without a fault every flag is false; with one the right channel is to be named.
Prints what docs/trust.md has of these; `--arms` and `--rates` say how long it may take.
"""

import argparse
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import Any

import numpy as np
from detection import spoiled
from drawn_robots import Array, dressed, public_arm, public_files

from linkside import ElasticJointFilter, ExtendedKalmanFilter, Log, Robot
from linkside.control.controllers import JointPD
from linkside.recording.estimate import Status
from linkside.simulation import Sensor, simulate

METHODS = {"ekf": ExtendedKalmanFilter, "elastic": partial(ElasticJointFilter, motor_torque="held")}
BAD = Status.CONTRADICTED | Status.FAULTY
MOTIONS = {"slow": (1.5, 0.6), "fast": (0.4, 1.0), "rough": (0.15, 0.2)}
"""Seconds there, and as many back; and how far, in standard deviations that joints differ by [rad]."""
LIMIT = 0.05
"""In which a fault is to be named [s]."""


@dataclass(frozen=True)
class Specimen:
    """A robot, what its sensors read, and where its links were (rows, n)."""

    name: str
    robot: Robot
    log: Log
    q: Array


@dataclass(frozen=True)
class Verdict:
    """Shares of rows that are flagged, off by three `q_std`, off and good; and findings with a channel, without one."""

    flagged: float
    off: float
    silent: float
    named: int
    unnamed: int


def main() -> None:
    """Print a line for each recording, then the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("tables", nargs="*", default=["flags", "faults"])
    parser.add_argument("--arms", type=int, default=6)
    parser.add_argument("--rates", type=float, nargs="*", default=[100.0, 500.0, 1000.0])
    options = parser.parse_args()
    found: dict[str, list[Verdict]] = {name: [] for name in METHODS}
    said: dict[tuple[str, str], Counter[str]] = {}
    for specimen in specimens(options.arms, options.rates):
        clean = {name: method(specimen.robot).run(specimen.log) for name, method in METHODS.items()}
        if "flags" in options.tables:
            for name, estimate in clean.items():
                one = verdict(specimen, estimate)
                found[name].append(one)
                print(f"{specimen.name}, {name}: {line([one])}; {shown(estimate)}", flush=True)
        if "faults" in options.tables:
            for name, estimate in clean.items():
                for fault, outcome in faulty(specimen, METHODS[name], estimate):
                    said.setdefault((name, fault), Counter())[outcome] += 1
    for name, verdicts in found.items():
        if verdicts:
            print(f"{name}: {line(verdicts)}")
    for (name, fault), outcomes in said.items():
        print(f"{name}, {fault}: {dict(outcomes)}")


def line(verdicts: list[Verdict]) -> str:
    """Means of shares, sums of findings."""
    flagged, off, silent = (np.mean([getattr(v, what) for v in verdicts]) for what in ("flagged", "off", "silent"))
    named, unnamed = (sum(getattr(v, what) for v in verdicts) for what in ("named", "unnamed"))
    findings = f"findings {named} with a channel, {unnamed} without"
    return f"flagged {flagged:.2%}, off {off:.2%}, and good {silent:.2%}, {findings}"


def shown(estimate: Any) -> str:
    """The first findings, and the NIS a reading."""
    nis = np.nansum(estimate.nis) / estimate.used.sum()
    return f"NIS {nis:.2f} " + ", ".join(f"{f.channel} {f.kind} {f.since}-{f.until}" for f in estimate.findings[:3])


def verdict(specimen: Specimen, estimate: Any) -> Verdict:
    """Flags against what is so."""
    off = (np.abs(estimate.q - specimen.q) > 3 * estimate.q_std).any(axis=1)
    bad = estimate.status & BAD > 0
    named = sum(f.channel is not None for f in estimate.findings)
    return Verdict(bad.mean(), off.mean(), (off & ~bad).mean(), named, len(estimate.findings) - named)


def faulty(specimen: Specimen, method: Any, clean: Any) -> Iterator[tuple[str, str]]:
    """Each fault in a channel or two, from the middle of the motion on: what comes of it."""
    robot, log = specimen.robot, specimen.log
    row = int(0.45 * len(log))
    rng = np.random.default_rng(0)
    signals = ["theta"] + (["acceleration"] if log.acceleration is not None else [])
    for signal, fault in product(signals, ("bias", "stuck", "flipped", "gain", "dead")):
        channel = int(rng.integers(getattr(log, signal).shape[1]))
        estimate = method(robot).run(spoiled(log, signal, channel, fault, row))
        moved = np.nanmax(np.abs(estimate.q - clean.q)[row:] / clean.q_std[row:])
        bad, off = estimate.status & BAD > 0, (np.abs(estimate.q - specimen.q) > 3 * estimate.q_std).any(axis=1)
        off &= (np.abs(clean.q - specimen.q) < 3 * clean.q_std).all(axis=1)
        silent = (off & ~bad).mean()
        name = log.columns(signal)[channel]
        early = [f for f in estimate.findings if f.channel and f.since < row - 1]
        after = [f.channel for f in estimate.findings if f.channel and f.since >= row - 1]
        first = np.flatnonzero(estimate.status & Status.FAULTY)
        first = first[first >= row]
        late = len(first) == 0 or log.t[first[0]] - log.t[row] > LIMIT
        outcome = (
            "does not count"
            if moved < 3
            else "wrong before"
            if early
            else ("silent" if not bad[row:].any() else "without a name")
            if not after
            else "wrong name"
            if after[0] != name
            else "late"
            if late
            else "named"
        )
        if moved >= 3 and outcome != "named":
            what = f"moved {moved:.0f}, off and good {silent:.1%}, {outcome}; {shown(estimate)}"
            print(f"   {specimen.name}, {method}, {name} {fault}: {what}")
        yield f"{signal} {fault}", outcome
        if moved >= 3:
            yield f"{signal} {fault}", "off and good" if silent > 0.02 else "honest"


def specimens(arms: int, rates: list[float]) -> Iterator[Specimen]:
    """So many arms in each motion at each rate, with two accelerometers and without."""
    for seed, rate, (kind, (span, far)), seen in product(range(arms), rates, MOTIONS.items(), (True, False)):
        rng = np.random.default_rng(seed)
        file = public_files()[seed % len(public_files())]
        urdf, links, names = public_arm(file)
        robot = dressed(urdf, links, names, rng, sensors=seen, zero=0.0)
        sensors = "two accelerometers" if seen else "none"
        name = f"{file.split('/')[-1].removesuffix('.urdf')}, {kind}, {rate:.0f} Hz, {sensors}"
        run = moved(robot, rng, rate, span, far)
        yield Specimen(name, robot, run.log, run.truth["q"])


def moved(robot: Robot, rng: np.random.Generator, rate: float, span: float, far: float) -> Any:
    """From rest to a posture and back within `span` each, by polynomials of degree nine, and a rest."""
    start, way = rng.uniform(-0.5, 0.5, robot.n), far * rng.standard_normal(robot.n)
    times = np.arange(0.0, 0.8 + 2 * span, 0.005)
    u = [np.clip((times - begin) / span, 0, 1)[:, None] for begin in (0.3, 0.3 + span)]
    there, back = (x**5 * (126 - 420 * x + 540 * x**2 - 315 * x**3 + 70 * x**4) for x in u)
    torque = robot.gravity_torque(start)
    theta = start + torque / np.array([d.stiffness for d in robot.drives]) + (there - back) * way
    inertia = np.diag(robot.mass_matrix(start)) + np.array([d.motor_inertia for d in robot.drives])
    control = JointPD(kp=400 * inertia, kd=28 * inertia, times=times, theta=list(theta), tau=torque)
    substeps = max(1, round(4000 / rate))
    speed = {"dtheta": Sensor(noise=1e-3)}
    return simulate(robot, control, times[-1], rate, substeps=substeps, q=start, seed=1, sensors=speed)


if __name__ == "__main__":
    main()
