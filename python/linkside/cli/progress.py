"""What the terminal shows: a bar while work goes on, tables and a summary when it is done."""

from __future__ import annotations

import io
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from rich.console import Console, ConsoleOptions, JustifyMethod, RenderableType, RenderResult
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from linkside.kalman.filtering import KalmanEstimate
from linkside.observability.analysis import LIMIT, NEVER, CheckReport, prismatic
from linkside.recording.estimate import Estimate, EstimateError
from linkside.robot import Robot

if TYPE_CHECKING:
    import numpy.typing as npt

Item = TypeVar("Item")

DELAY = 2.0
"""Work that takes less than this needs no bar [s]."""

STATUS_WORDS = {
    "damped": "damped near a singular posture",
    "bridged": "bridged over missing samples",
    "unseen": "with an acceleration that no sensor sees",
    "gated": "with an outlier left out",
    "predicted": "predicted without a reading",
    "unwrapped": "with an encoder's wrap taken out",
}


@contextmanager
def bar(total: int | None) -> Iterator[Callable[[str, int], None]]:
    """Show a bar on standard error, if that is a terminal and work takes long; yields ``advance(what, rows)``."""
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    progress = Progress(*columns, console=console, transient=True, disable=not console.is_terminal)
    task = progress.add_task("", total=total)
    begun = time.monotonic()

    def advance(what: str, rows: int) -> None:
        progress.update(task, description=what, advance=rows)
        if time.monotonic() - begun > DELAY:
            progress.start()

    try:
        yield advance
    finally:
        progress.stop()


@dataclass
class Tally:
    """Counts what has been estimated, and the time it took without reading the log.

    Attributes
    ----------
    rows : int
        Rows so far.
    motion : float
        Time that the log spans [s].
    seconds : float
        Time that the method took [s].
    status : Counter of str
        Rows by status.
    nis, used : float
        Normalised innovation squared and readings used, where the method is a Kalman filter.
    """

    rows: int = 0
    motion: float = 0.0
    seconds: float = 0.0
    status: Counter[str] = field(default_factory=Counter)
    nis: float = 0.0
    used: int = 0
    _first: float | None = None

    def add(self, estimate: Estimate) -> None:
        """Count one piece."""
        if len(estimate):
            self._first = float(estimate.t[0]) if self._first is None else self._first
            self.motion = float(estimate.t[-1]) - self._first
        self.rows += len(estimate)
        self.status.update(estimate.status_summary())
        if isinstance(estimate, KalmanEstimate) and estimate.nis is not None and estimate.used is not None:
            self.nis += float(estimate.nis.sum())
            self.used += int(estimate.used.sum())

    def timed(self, items: Iterable[Item], sign: int = 1) -> Iterator[Item]:
        """Add the time that each item takes to come, or with ``sign=-1`` take it off."""
        iterator = iter(items)
        while True:
            begun = time.perf_counter()
            try:
                item = next(iterator)
            except StopIteration:
                return
            finally:
                self.seconds += sign * (time.perf_counter() - begun)
            yield item

    def __str__(self) -> str:
        """One line: rows, motion, speed and status."""
        speed = 1e6 * self.seconds / max(self.rows, 1)
        nis = f"; NIS {self.nis / self.used:.2f} per reading (1 if the noise is right)" if self.used else ""
        return f"{self.rows} rows, {self.motion:.6g} s of motion, {speed:.3g} µs per sample; {self._status()}{nis}"

    def _status(self) -> str:
        if self.status["good"] == self.rows:
            return "all good"
        odd = (f"{count} {STATUS_WORDS.get(word, word)}" for word, count in self.status.items() if count)
        return ", ".join(odd)


def as_text(parts: Iterable[RenderableType], width: int) -> str:
    """Render without colours."""
    out = io.StringIO()
    show(parts, Console(file=out, width=width))
    return out.getvalue()


def show(parts: Iterable[RenderableType], console: Console | None = None) -> None:
    """Print on standard output, or elsewhere; a pipe has no width, so tables are as wide as they need to be."""
    if console is None:
        console = Console(width=None if sys.stdout.isatty() else 160)
    for part in parts:
        console.print(part, markup=False, highlight=False)


def error_tables(error: EstimateError, robot: Robot, title: str) -> Iterator[RenderableType]:
    """Errors of an estimate: of the tool in mm, and of each joint."""
    if error.tool_rms is not None:
        yield tool_table({"estimate": error}, title)
    if any(signal.partition("_")[0] in ("q", "dq", "theta", "dtheta") for signal in error.rms):
        yield _joint_errors(error, robot)


def tool_table(errors: dict[str, EstimateError], title: str) -> _Titled:
    """Distance of the tool from the truth, a row for each estimate."""
    heads = ("RMS", "largest", "RMS, offset out", "largest, offset out")
    table = _Titled(f"tool error against {title} [mm]", ("", *heads))
    for name, error in errors.items():
        values = (error.tool_rms, error.tool_max, error.tool_rms_centred, error.tool_max_centred)
        table.add_row(name, *("–" if value is None else f"{value:.4f}" for value in values))
    return table


def _joint_errors(error: EstimateError, robot: Robot) -> _Titled:
    signals = ("q", "dq", "theta", "dtheta")
    table = _Titled("error by joint, RMS", ("joint", *signals))
    for name, slides in zip(robot.names, prismatic(robot), strict=True):
        unit = "m" if slides else "rad"
        cells = []
        for signal in signals:
            value = error.rms.get(f"{signal}_{name}")
            cells.append("–" if value is None else f"{1e6 * value:.4g} µ{unit}{'/s' * signal.startswith('d')}")
        table.add_row(name, *cells)
    return table


def check_tables(report: CheckReport) -> Iterator[RenderableType]:
    """Say in words and tables what the sensors see."""
    yield from check_words(report)
    if not (report.joints and report.robot.accelerometers):
        return
    yield _joint_table(report)
    if report.observable:
        yield _spread_table(report)
        yield _posture_table(report)


def check_words(report: CheckReport) -> Iterator[str]:
    """Say in a few sentences what the sensors see."""
    robot, joints = report.robot, report.joints
    axes = len(robot.acceleration_channels)
    yield f"{robot.model.name}: {_named(joints, 'elastic joint', 'elastic joints')}; " + (
        f"{_named([f'{s.name} {s.axes}' for s in robot.accelerometers], 'accelerometer', 'accelerometers')}."
    )
    if not joints:
        yield "No joint is elastic: links follow their motors, and no accelerometer is needed."
    elif not axes:
        yield "The robot has no accelerometer: no link acceleration is seen, in any posture."
    elif axes < len(joints):
        yield f"Too few axes: {axes} cannot tell {len(joints)} link accelerations apart, in any posture."
    elif not report.observable:
        yield "The axes are enough in number, yet in no posture do they tell all link accelerations apart."
    else:
        yield from _seen(report)


def _seen(report: CheckReport) -> Iterator[str]:
    lost = float(np.mean(report.sight.worst > LIMIT))
    share = f"In {_percent(lost)} of the workspace some link acceleration is known worse than {LIMIT:g} rad/s² (1 σ)."
    yield f"Every link acceleration is seen. {share}"
    if report.singular:
        yield f"In singular postures no sensor sees {'; or '.join(p.words for p in report.singular)}."
    else:
        yield f"No singular posture was found; the worst combination is {report.postures[0].words}."
    if report.path is not None:
        row = int(np.argmax(report.path.worst))
        where = f"{_deviation(report.path.worst[row])} rad/s² at t = {report.path.t[row]:.6g} s"
        lost = float(np.mean(report.path.worst > LIMIT))
        yield f"Along {report.path.source} the worst is {where}; {_percent(lost)} of it is worse than {LIMIT:g} rad/s²."


def _joint_table(report: CheckReport) -> _Titled:
    heads = ["joint", "best", "median", "worst", f"worse than {LIMIT:g}"]
    path = report.path
    heads += ["log: best", "log: median", "log: worst"] if path is not None else []
    table = _Titled("link acceleration, standard deviation over the workspace [rad/s²]", [*heads, "in words"])
    for index, name in enumerate(report.joints):
        values = report.sight.joints[:, index]
        lost = float(np.mean(values > LIMIT))
        cells = [*_three(values), _percent(lost)]
        cells += _three(path.joints[:, index]) if path is not None else []
        table.add_row(name, *cells, _grade(lost))
    return table


def _three(values: npt.NDArray[np.float64]) -> list[str]:
    return [_deviation(float(value)) for value in (values.min(), np.median(values), values.max())]


def _grade(lost: float) -> str:
    if lost == 1:
        return "never seen"
    return "seen in every posture drawn" if lost == 0 else "lost near singular postures"


def _spread_table(report: CheckReport) -> _Titled:
    heads = ("", "best", "median", "90 %", "99 %", "worst drawn")
    table = _Titled("worst combination of link accelerations, share of the workspace at least as good", heads)
    order = (0.0, 0.5, 0.9, 0.99, 1.0)
    for name, values in (("1/σ [rad/s²]", report.sight.worst), ("condition", report.sight.condition)):
        ranked = np.quantile(values, order, method="lower")
        table.add_row(name, *(_deviation(float(value)) for value in ranked))
    return table


def _posture_table(report: CheckReport) -> _Titled:
    robot, slides = report.robot, prismatic(report.robot)
    heads = [f"{name} [{'m' if slide else '°'}]" for name, slide in zip(robot.names, slides, strict=True)]
    table = _Titled("worst postures", ["lost", *heads, "1/σ [rad/s²]"])
    for posture in report.postures:
        places = [f"{q:.4f}" if slide else f"{np.degrees(q):.2f}" for q, slide in zip(posture.q, slides, strict=True)]
        cells = [place if joint in report.influential else "any" for joint, place in enumerate(places)]
        table.add_row(posture.words, *cells, "not seen" if posture.singular else _deviation(posture.worst))
    return table


class _Titled:
    """A table under a line of its own: rich would fold a title that is wider than the table."""

    def __init__(self, title: str, heads: Iterable[str]) -> None:
        self._title, self._table = title, Table()
        for index, head in enumerate(heads):
            side: JustifyMethod = "right" if index and head != "in words" else "left"
            self._table.add_column(Text(head), justify=side, overflow="fold")

    def add_row(self, *cells: str) -> None:
        """Add a row; brackets are text, not markup."""
        self._table.add_row(*map(Text, cells))

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Render the title, then the table."""
        yield Text(f"\n{self._title}", style="bold")
        yield self._table


def _deviation(value: float) -> str:
    if value > NEVER:
        return "∞" if np.isinf(value) else f"> {NEVER:.0f}"
    return f"{value:.3g}" if value < 1000 else f"{value:.0f}"


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %" if share < 0.1 else f"{100 * share:.0f} %"


def _named(names: Sequence[str], one: str, many: str) -> str:
    return f"{len(names)} {one if len(names) == 1 else many}" + (f" ({', '.join(names)})" if names else "")
