"""The picture of a filter's consistency, drawn without a display."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure
from scipy import stats

from linkside.arrays import FloatArray
from linkside.figures import COLOURS

from .measures import Measures, Ratio

STRETCHES = 100
"""Points of a line over time."""

BLUE, GREEN = COLOURS[0], COLOURS[2]


def draw(report: Measures) -> Figure:
    """Draw it, see `Consistency.figure`."""
    last = "sizes" if report.nees is None else "nees"
    figure = Figure(figsize=(12, 7.2), layout="constrained")
    axes = figure.subplot_mosaic([["nis", "histogram"], ["lags", last]], width_ratios=(1.5, 1))
    figure.suptitle(report.to_text().splitlines()[0])
    _over_time(axes["nis"], report.t, report.nis, report.innovations, "innovations (NIS)", report.level)
    _histogram(axes["histogram"], report)
    _lags(axes["lags"], report)
    if report.nees is None:
        _sizes(axes["sizes"], report)
    else:
        assert report.position is not None
        _over_time(axes["nees"], report.t, report.nees, report.position, "error of q (NEES)", report.level)
    return figure


def _over_time(axes: Any, t: FloatArray, squares: FloatArray, ratio: Ratio, what: str, level: float) -> None:
    """Every sample faintly, their mean over stretches, and the band that such a mean should be in."""
    known = np.flatnonzero(np.isfinite(squares))
    parts = np.array_split(known, min(STRETCHES, len(known)))
    means = np.array([squares[part].mean() for part in parts])
    middles = np.array([t[part].mean() for part in parts])
    freedom = ratio.degrees * max(1.0, ratio.independent * len(known) / len(parts))
    band = stats.chi2.ppf([0.5 - level / 2, 0.5 + level / 2], freedom) / freedom
    axes.plot(t[known], np.maximum(squares[known], 1e-3), ".", color="0.8", markersize=2, rasterized=True)
    axes.axhspan(max(band[0], 1e-3), band[1], color=GREEN, alpha=0.25, label=f"{100 * level:g} % band of the line")
    axes.plot(middles, np.maximum(means, 1e-3), color=BLUE, linewidth=2, label=f"mean of {len(parts[0])} samples")
    low, high = np.quantile(means, (0, 1))
    axes.set(yscale="log", ylim=(max(2e-3, min(0.05, low / 2)), max(20, 2 * high)), xlabel="time [s]")
    axes.set(ylabel="per degree of freedom", title=f"{what}: {ratio.mean:.3g}, {ratio.verdict}")
    _tidy(axes)


def _histogram(axes: Any, report: Measures) -> None:
    grid = np.linspace(-4.5, 4.5, 91)
    for index, name in enumerate(report.channels):
        values = report.normalised[:, index]
        values = np.clip(values[np.isfinite(values)], grid[0], grid[-1])
        if len(values):
            axes.hist(values, grid, density=True, histtype="step", color=_colour(report, index), label=name, alpha=0.8)
    axes.fill_between(grid, stats.norm.pdf(grid), color=GREEN, alpha=0.3, label="N(0, 1)")
    axes.set(xlabel="normalised innovation", ylabel="density", title="distribution of innovations", ylim=(0, 1.6))
    _tidy(axes, _few(report))


def _lags(axes: Any, report: Measures) -> None:
    lags = 1 + np.arange(len(report.autocorrelation))
    for index, name in enumerate(report.channels):
        axes.plot(lags, report.autocorrelation[:, index], ".-", color=_colour(report, index), label=name, alpha=0.8)
    bound = np.max(report.bound, initial=0, where=np.isfinite(report.bound))
    axes.axhspan(-bound, bound, color=GREEN, alpha=0.3)
    axes.axhline(0, color=GREEN)
    axes.set(xlabel="lag [samples]", ylabel="autocorrelation", title="innovations: white if within the band")
    _tidy(axes, _few(report))


def _sizes(axes: Any, report: Measures) -> None:
    """Root mean square of each channel's normalised innovations."""
    colours = [_colour(report, index) for index in range(len(report.channels))]
    axes.barh(report.channels, report.sizes, color=colours)
    axes.axvline(1, color=GREEN)
    axes.invert_yaxis()
    axes.set(xlabel="RMS of normalised innovations", title="size by channel: should be 1")
    _tidy(axes, legend=False)


def _colour(report: Measures, index: int) -> Any:
    return colormaps["viridis"](0.9 * index / max(1, len(report.channels) - 1))


def _few(report: Measures) -> bool:
    return 0 < len(report.channels) <= 8


def _tidy(axes: Any, legend: bool = True) -> None:
    axes.grid(True, color="0.92")
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    if legend:
        axes.legend(frameon=False, fontsize="small")
