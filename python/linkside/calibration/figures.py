"""Figures of a calibration."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from linkside.arrays import FloatArray
from linkside.errors import EstimatorError, NumericalError
from linkside.figures import COLOURS, legend_beside, line_style
from linkside.files.yaml_source import suggest

from .parameters import NOISE

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .result import Result


FAR = 5.0
"""Estimates further from robot.yaml than this many tolerances are marked at the edge."""

SPAN = 3.0
"""Half the width of a profile in standard errors."""


def _figure(width: float, height: float) -> Figure:
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def estimates(calibration: Result) -> Figure:
    """Draw each estimate with two standard errors, as its distance from robot.yaml in tolerances."""
    names = [e.parameter.name for e in calibration.estimates]
    figure = _figure(9, 1.2 + 0.28 * len(names))
    axes = figure.subplots()
    rows = np.arange(len(names))[::-1]
    z, std = calibration.z, calibration.uncertainty.std
    far = np.abs(z) > FAR
    axes.axvspan(-1, 1, color="0.92", label="tolerance")
    axes.errorbar(
        z[~far], rows[~far], xerr=2 * std[~far], color=COLOURS[0], fmt="o", ms=4, capsize=3, label="± 2 std. errors"
    )
    axes.set_xlim(*np.clip(axes.get_xlim(), -1.3 * FAR, 1.3 * FAR))
    if far.any():  # they would squeeze the others to nothing
        low, high = axes.get_xlim()
        edge = np.where(z[far] > 0, high, low)
        axes.scatter(edge, rows[far], marker="D", label=f"beyond {FAR:g}", color=COLOURS[1], clip_on=False, zorder=3)
        for place, row, value in zip(edge, rows[far], z[far], strict=True):
            side, away = ("right", -8) if value > 0 else ("left", 8)
            axes.annotate(
                f"{value:.3g}", (place, row), xytext=(away, 0), textcoords="offset points", ha=side, va="center"
            )
    axes.set_yticks(rows, names)
    axes.set_ylim(-0.6, len(names) - 0.4)
    axes.set_xlabel("estimate less value in robot.yaml, in tolerances")
    legend_beside(axes)
    return figure


def correlation(calibration: Result) -> Figure:
    """Draw the estimates' correlations, those of noise left out: they say how readings scatter, not what a robot is."""
    kept = [i for i, e in enumerate(calibration.estimates) if e.parameter.kind not in NOISE]
    kept = kept or list(range(len(calibration.estimates)))
    names = [calibration.estimates[i].parameter.name for i in kept]
    size = 3 + 0.3 * len(names)
    figure = _figure(size + 1, size)
    axes = figure.subplots()
    image = axes.imshow(calibration.correlation[np.ix_(kept, kept)], vmin=-1, vmax=1, cmap="RdBu_r")
    axes.set_xticks(range(len(names)), names, rotation=90)
    axes.set_yticks(range(len(names)), names)
    figure.colorbar(image, label="correlation")
    return figure


def whiteness(calibration: Result) -> Figure:
    """Draw the autocorrelation of innovations before and after."""
    figure = _figure(11, 3.8)
    left, right = figure.subplots(1, 2, sharey=True)
    for axes, fit, title in ((left, calibration.before, "before"), (right, calibration.after, "after")):
        for index, (name, column) in enumerate(zip(calibration.problem.channels, fit.autocorrelation.T, strict=True)):
            axes.plot(np.arange(1, len(column) + 1), column, lw=1.2, label=name, **line_style(index))
        axes.axhline(0, color="0.5", lw=0.5)
        axes.set_title(title)
        axes.set_xlabel("lag [samples]")
    left.set_ylabel("autocorrelation of innovations")
    legend_beside(right)
    return figure


def profile(calibration: Result, first: str, second: str, points: int = 15) -> Figure:
    """Draw the log-posterior over a pair of parameters, exact at each point, the others moved along its ridge.

    Contours enclose 39 and 86 %, one and two standard errors of each parameter, as the likelihood has them.

    Raises
    ------
    EstimatorError
        A name that was not estimated, or twice the same.
    """
    names = [e.parameter.name for e in calibration.estimates]
    for name in (first, second):
        if name not in names:
            raise EstimatorError(f"profile: {name!r} was not estimated; {suggest(name, names)}")
    if first == second:
        raise EstimatorError(f"profile: {first!r} twice; name two parameters")
    pair = [names.index(first), names.index(second)]
    grids = [calibration.z[i] + SPAN * calibration.uncertainty.std[i] * np.linspace(-1, 1, points) for i in pair]
    drop = _drop(calibration, pair, grids)
    figure = _figure(5, 4.2)
    axes = figure.subplots()
    values = [[calibration.estimates[i].parameter.value(z) for z in grid] for i, grid in zip(pair, grids, strict=True)]
    image = axes.contourf(values[0], values[1], np.minimum(drop.T, 20.0), levels=20, cmap="Blues_r")
    axes.contour(values[0], values[1], drop.T, levels=[0.5, 2.0], colors="k", linewidths=1)
    axes.plot(*(calibration.estimates[i].value for i in pair), "k+")
    for label, i in ((axes.set_xlabel, pair[0]), (axes.set_ylabel, pair[1])):
        unit = calibration.estimates[i].parameter.unit
        label(f"{names[i]} [{unit}]" if unit else names[i])
    figure.colorbar(image, label="log-posterior below its maximum")
    return figure


def _drop(calibration: Result, pair: list[int], grids: list[FloatArray]) -> FloatArray:
    """The log-posterior's fall from its maximum on the grid; inf outside bounds and where the filter breaks down."""
    covariance = calibration.correlation * np.outer(calibration.uncertainty.std, calibration.uncertainty.std)
    ridge = covariance[:, pair] @ np.linalg.inv(covariance[np.ix_(pair, pair)])
    problem, best = calibration.problem, calibration.z

    def posterior(z: FloatArray) -> float:
        inside = all(p.low <= p.value(x) <= p.high for p, x in zip(problem.free, z, strict=True))
        try:
            return problem.log_likelihood(z) - 0.5 * float(z @ z) if inside else -np.inf
        except NumericalError:
            return -np.inf

    low = np.array([p.z(p.low) for p in problem.free])
    high = np.array([p.z(p.high) for p in problem.free])
    rest = np.setdiff1d(np.arange(len(best)), pair)
    drop = np.empty((len(grids[0]), len(grids[1])))
    top = posterior(best)
    for i, a in enumerate(grids[0]):
        for j, b in enumerate(grids[1]):
            z = best + ridge @ (np.array([a, b]) - best[pair])
            z[rest] = np.clip(z[rest], low[rest] + 1e-9, high[rest] - 1e-9)
            drop[i, j] = top - posterior(z)
    return drop
