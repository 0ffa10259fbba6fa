"""The picture of a filter's consistency, drawn without a display."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy import stats

from linkside.arrays import FloatArray
from linkside.figures import COLOURS, legend_beside, line_style

from .measures import Measures, Ratio

STRETCHES = 100
"""Points of a line over time."""

FARTHEST = 12.0
"""Normalised innovations beyond it are cut off."""

BLUE, GREEN = COLOURS[0], COLOURS[2]


def draw(report: Measures) -> Figure:
    """Draw it, see `Consistency.figure`."""
    last = "sizes" if report.nees is None else "nees"
    figure = Figure(figsize=(15, 7.6), layout="constrained")
    axes = figure.subplot_mosaic([["nis", "spreads"], ["lags", last]], width_ratios=(1.3, 1))
    figure.suptitle(report.to_text().splitlines()[0])
    _over_time(axes["nis"], report.t, report.nis, report.innovations, "innovations (NIS)", report.level)
    _spreads(axes["spreads"], report)
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


def _spreads(axes: Any, report: Measures) -> None:
    """Of each channel, where half of its innovations are, and where nearly all are."""
    shares = np.array([0.01, 0.25, 0.5, 0.75, 0.99])
    normal = stats.norm.ppf(shares)
    axes.axvspan(normal[0], normal[-1], color=GREEN, alpha=0.15, label="N(0, 1): 98 %")
    axes.axvspan(normal[1], normal[3], color=GREEN, alpha=0.25, label="N(0, 1): 50 %")
    reach = 1.5 * normal[-1]
    for row, values in enumerate(report.normalised.T):
        known = values[np.isfinite(values)]
        if len(known):
            low, left, middle, right, high = np.quantile(known, shares)
            reach = min(max(reach, 1.1 * abs(low), 1.1 * high), FARTHEST)
            axes.plot([low, high], [row, row], color=BLUE, linewidth=1.5, solid_capstyle="butt")
            axes.plot([left, right], [row, row], color=BLUE, linewidth=5, solid_capstyle="butt")
            axes.plot(middle, row, "|", color="white", markersize=6)
    axes.set(xlabel="normalised innovation", title="innovations: thin 98 %, thick 50 %", xlim=(-reach, reach))
    _by_channel(axes, report)
    _tidy(axes)


def _lags(axes: Any, report: Measures) -> None:
    lags = 1 + np.arange(len(report.autocorrelation))
    for index, name in enumerate(report.channels):
        axes.plot(lags, report.autocorrelation[:, index], **line_style(index), label=name)
    bound = np.max(report.bound, initial=0, where=np.isfinite(report.bound))
    axes.axhspan(-bound, bound, color=GREEN, alpha=0.3, label="white")
    axes.axhline(0, color=GREEN)
    axes.set(xlabel="lag [samples]", ylabel="autocorrelation", title="innovations: white if within the band")
    _tidy(axes)


def _sizes(axes: Any, report: Measures) -> None:
    """Root mean square of each channel's normalised innovations."""
    axes.barh(range(len(report.channels)), report.sizes, color=BLUE)
    axes.axvline(1, color=GREEN)
    axes.set(xlabel="RMS of normalised innovations", title="size by channel: should be 1")
    _by_channel(axes, report)
    _tidy(axes, legend=False)


def _by_channel(axes: Any, report: Measures) -> None:
    count = len(report.channels)
    axes.set_yticks(range(count), report.channels, fontsize=max(4.5, min(9.0, 120 / max(count, 1))))
    axes.set_ylim(max(count, 1) - 0.5, -0.5)


def _tidy(axes: Any, legend: bool = True) -> None:
    axes.grid(True, color="0.92")
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    if legend:
        legend_beside(axes)
