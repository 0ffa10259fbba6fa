"""Measures of a filter's innovations and errors against what it expects of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from linkside.arrays import FloatArray


@dataclass(frozen=True)
class Ratio:
    """A mean that should be 1, with the bounds it should be in.

    Attributes
    ----------
    mean : float
        Normalised square per degree of freedom.
    low, high : float
        Its bounds.
    inside : float
        Share of samples within their own bounds; should be `Consistency.level`.
    degrees : float
        Degrees of freedom of a sample.
    independent : float
        Share of samples that count as independent; 1 for innovations.
    varying : float or None
        Of an error, the mean without the error's constant part.
    """

    mean: float
    low: float
    high: float
    inside: float
    degrees: float
    independent: float
    varying: float | None = None

    @property
    def verdict(self) -> str:
        """``"consistent"``, ``"overconfident"`` or ``"cautious"``."""
        return "overconfident" if self.mean > self.high else "cautious" if self.mean < self.low else "consistent"


@dataclass(frozen=True, eq=False)
class Measures:
    """How a filter's innovations, and its errors where a truth is given, compare with what it expects.

    Attributes
    ----------
    level : float
        Probability of all bounds.
    t, nis, nees : (T,)
        Time, and normalised squares of innovations and of the error of q, per degree of freedom; NaN where there is
        none.
    innovations, position, tool : Ratio
        Of innovations over the recording, of the error of q, and of the tool's. The last two are None without a truth.
    log_likelihood : float
        Of the whole recording.
    channels : tuple of str
        The m channels.
    normalised : (T, m)
        Innovations over their standard deviations.
    autocorrelation : (lags, m)
        Of those, from lag 1 on; zero for a filter that is right.
    bound : (m,)
        What an autocorrelation of white innovations exceeds with probability 1 - level.
    white : (m,)
        Whether Ljung and Box's test over all lags leaves a channel's innovations white.
    """

    level: float
    t: FloatArray
    nis: FloatArray
    nees: FloatArray | None
    innovations: Ratio
    position: Ratio | None
    tool: Ratio | None
    log_likelihood: float
    channels: tuple[str, ...]
    normalised: FloatArray
    autocorrelation: FloatArray
    bound: FloatArray
    white: npt.NDArray[np.bool_]

    @property
    def sizes(self) -> FloatArray:
        """Root mean square of each channel's normalised innovations, (m,); 1 for a filter that is right."""
        counts = np.maximum(1, np.isfinite(self.normalised).sum(axis=0))
        return np.asarray(np.sqrt(np.nansum(self.normalised**2, axis=0) / counts))

    def to_text(self) -> str:
        """Report in words."""
        parts = [("innovations", self.innovations), ("error of q", self.position), ("error of the tool", self.tool)]
        lines = [_line(name, ratio, self.level) for name, ratio in parts if ratio is not None]
        lines += self._whiteness_lines()
        lines.append(f"log-likelihood: {self.log_likelihood:.1f}")
        return "\n".join([*self._verdicts(), *lines]) + "\n"

    def _verdicts(self) -> list[str]:
        ratio, what = (self.position, "errors") if self.position else (self.innovations, "innovations")
        factor = float(np.sqrt(ratio.mean))
        if ratio.verdict == "consistent":
            return [f"The filter is consistent: {what} are as large as it states."]
        if ratio.verdict == "cautious":
            return [f"The filter is cautious: {what} are {_times(1 / factor)} smaller than it states."]
        constant = ratio.varying is not None and ratio.varying < 0.5 * ratio.mean
        sees = self.innovations.verdict == "overconfident"  # no innovation shows an offset at rest
        advice = "try linkside tune" if sees or not constant else "most of it is a constant offset: calibrate"
        return [f"The filter is overconfident: {what} are {_times(factor)} larger than it states; {advice}."]

    def _whiteness_lines(self) -> list[str]:
        if not self.channels:
            return ["whiteness of innovations: not known; run with innovations=True"]
        coloured = [name for name, white in zip(self.channels, self.white, strict=True) if not white]
        if not coloured:
            return [f"innovations are white in all {len(self.channels)} channels over {len(self.autocorrelation)} lags"]
        rows = [f"innovations are correlated in time in {len(coloured)} of {len(self.channels)} channels:"]
        rows += [self._channel_line(index, name) for index, name in enumerate(self.channels) if name in coloured]
        return [
            *rows,
            "  errors of the model (stiffness, mass, friction) are correlated from sample to sample, noise is not",
        ]

    def _channel_line(self, index: int, name: str) -> str:
        first, size = self.autocorrelation[0, index], self.sizes[index]
        bound = f"white: within ±{self.bound[index]:.2f}"
        return f"  {name}: {first:.2f} at lag 1 ({bound}), RMS {size:.2f} times what is expected"


def _times(factor: float) -> str:
    return f"{factor:.2g} times" if factor >= 1.1 else "slightly"


def _line(name: str, ratio: Ratio, level: float) -> str:
    varying = "" if ratio.varying is None else f", {ratio.varying:.3g} without its constant part"
    bounds = f"{100 * level:g} % bounds {ratio.low:.3f} to {ratio.high:.3f}"
    share = f"{100 * ratio.inside:.1f} % of samples within theirs"
    return f"{name}: {ratio.mean:.3g} per degree of freedom{varying}; {bounds}; {share} ({ratio.verdict})"
