"""What accelerometers see of a robot's links, in words and tables."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from rich.console import RenderableType

from linkside.arrays import FloatArray
from linkside.robot.workspace import prismatic
from linkside.text import Titled

from .elements import element_words
from .result import LIMIT, NEVER, CheckResult


def check_tables(report: CheckResult) -> Iterator[RenderableType]:
    """Say in words and tables what the sensors see."""
    yield from check_words(report)
    if not (report.joints and report.robot.accelerometers):
        return
    yield _joint_table(report)
    if report.observable:
        yield _spread_table(report)
        yield _posture_table(report)


def check_words(report: CheckResult) -> Iterator[str]:
    """Say in a few sentences what the sensors see."""
    robot, joints = report.robot, report.joints
    axes = len(robot.acceleration_channels)
    yield f"{robot.tree.name}: {_named(joints, 'elastic joint', 'elastic joints')}; " + (
        f"{_named([f'{s.name} {s.axes}' for s in robot.accelerometers], 'accelerometer', 'accelerometers')}."
    )
    yield from element_words(robot)
    if not joints:
        yield "No joint is elastic: links follow their motors, and no accelerometer is needed."
    elif not axes:
        yield "The robot has no accelerometer: no link acceleration is observed in any posture."
    elif axes < len(joints):
        yield f"Too few axes: {axes} cannot distinguish {len(joints)} link accelerations in any posture."
    elif not report.observable:
        yield "There are enough axes, but in no posture do they distinguish all link accelerations."
    else:
        yield from _seen(report)


def _seen(report: CheckResult) -> Iterator[str]:
    lost = float(np.mean(report.observability.worst > LIMIT))
    yield (
        f"Every link acceleration is observed. In {_percent(lost)} of the workspace "
        f"the standard deviation of some link acceleration exceeds {LIMIT:g} rad/s²."
    )
    if report.singular:
        yield f"In singular postures no sensor observes {'; or '.join(p.words for p in report.singular)}."
    else:
        yield f"No singular posture was found; the worst combination is {report.postures[0].words}."
    if report.path is not None:
        row = int(np.argmax(report.path.worst))
        where = f"{_deviation(report.path.worst[row])} rad/s² at t = {report.path.t[row]:.6g} s"
        lost = float(np.mean(report.path.worst > LIMIT))
        yield f"Along {report.path.source} the worst is {where}; {_percent(lost)} of it is worse than {LIMIT:g} rad/s²."


def _joint_table(report: CheckResult) -> Titled:
    heads = ["joint", "best", "median", "worst", f"worse than {LIMIT:g}"]
    path = report.path
    heads += ["log: best", "log: median", "log: worst"] if path is not None else []
    table = Titled("link acceleration, standard deviation over the workspace [rad/s²]", [*heads, "in words"])
    for index, name in enumerate(report.joints):
        values = report.observability.joints[:, index]
        lost = float(np.mean(values > LIMIT))
        cells = [*_three(values), _percent(lost)]
        cells += _three(path.joints[:, index]) if path is not None else []
        table.add_row(name, *cells, _grade(lost))
    return table


def _three(values: FloatArray) -> list[str]:
    return [_deviation(float(value)) for value in (values.min(), np.median(values), values.max())]


def _grade(lost: float) -> str:
    if lost == 1:
        return "never observed"
    return "observed in every posture drawn" if lost == 0 else "lost near singular postures"


def _spread_table(report: CheckResult) -> Titled:
    heads = ("", "best", "median", "90 %", "99 %", "worst drawn")
    table = Titled("worst combination of link accelerations, share of the workspace at least as good", heads)
    order = (0.0, 0.5, 0.9, 0.99, 1.0)
    for name, values in (("1/σ [rad/s²]", report.observability.worst), ("condition", report.observability.condition)):
        ranked = np.quantile(values, order, method="lower")
        table.add_row(name, *(_deviation(float(value)) for value in ranked))
    return table


def _posture_table(report: CheckResult) -> Titled:
    robot, slides = report.robot, prismatic(report.robot)
    heads = [f"{name} [{'m' if slide else '°'}]" for name, slide in zip(robot.names, slides, strict=True)]
    table = Titled("worst postures", ["lost", *heads, "1/σ [rad/s²]"])
    for posture in report.postures:
        places = [f"{q:.4f}" if slide else f"{np.degrees(q):.2f}" for q, slide in zip(posture.q, slides, strict=True)]
        cells = [place if joint in report.influential else "any" for joint, place in enumerate(places)]
        table.add_row(posture.words, *cells, "not observed" if posture.singular else _deviation(posture.worst))
    return table


def _deviation(value: float) -> str:
    if value > NEVER:
        return "∞" if np.isinf(value) else f"> {NEVER:.0f}"
    return f"{value:.3g}" if value < 1000 else f"{value:.0f}"


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %" if share < 0.1 else f"{100 * share:.0f} %"


def _named(names: Sequence[str], one: str, many: str) -> str:
    return f"{len(names)} {one if len(names) == 1 else many}" + (f" ({', '.join(names)})" if names else "")
