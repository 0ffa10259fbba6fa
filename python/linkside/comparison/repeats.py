"""Repeats of one motion: their mean, the spread between them, a trend, and repeats unlike the others."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np
import numpy.typing as npt

from linkside.arrays import FloatArray
from linkside.statistics import rms

from .alignment import sampled
from .measures import MEAN, Difference
from .outliers import apart, distances, outlying

ORDERS = 5040
"""Orders of the repeats that a trend is tested against; of up to seven repeats these are all."""

SIGNIFICANT = 0.01
"""Probability below which a trend is not taken for chance."""


@dataclass(frozen=True, eq=False)
class Repeats:
    """Repeats of one motion, in the order in which they were made: their mean, spread, trend and outliers.

    Attributes
    ----------
    signals : tuple of str
        Signals that are compared: ``tool``, or positions of joints ``q_<joint>``.
    distances : dict of str to float
        Distance of each repeat from the median path, without a trend that all have, RMS over time.
    outliers : tuple of str
        Repeats far from the others; the rest is computed without them. Needs five repeats.
    mean : Difference
        Mean of the repeats less the reference, by signal.
    spread : dict of str to float
        Standard deviation between repeats, RMS over time, by signal.
    trend : dict of str to float
        Size of the change from one repeat to the next, by least squares, RMS over time.
    p_value : float
        Probability that repeats without a trend have one of this size: the share of their orders that do.
    """

    signals: tuple[str, ...]
    distances: dict[str, float]
    outliers: tuple[str, ...]
    mean: Difference
    spread: dict[str, float]
    trend: dict[str, float]
    p_value: float

    @property
    def has_trend(self) -> bool:
        """Whether the repeats change from one to the next, at a level of 1 %; six repeats are needed to tell."""
        return self.p_value < SIGNIFICANT

    @classmethod
    def of(cls, differences: Sequence[Difference]) -> Repeats:
        """Judge repeats by their differences from one reference, at the first one's times."""
        first = differences[0]
        stacks = {signal: _stack(differences, signal) for signal in first.signals}
        common = [signal for signal, stack in stacks.items() if len(stack) == len(differences)]
        signals = tuple(s for s in common if s == "tool") or tuple(s for s in common if s.startswith("q_"))
        away, kept, p_value = np.zeros(len(differences)), np.ones(len(differences), bool), 1.0
        if signals:
            paths = np.concatenate([stacks[signal] for signal in signals], axis=2)
            gram = _gram(paths)
            everyone = np.arange(len(gram))
            drifts = _chance(gram, everyone) < SIGNIFICANT  # or an outlier would be lost among what drifts
            deviations = apart(gram, everyone.astype(float) if drifts else None)
            away, kept = distances(deviations), ~outlying(deviations)
            p_value = _chance(gram[np.ix_(kept, kept)], np.flatnonzero(kept))
        good = {s: stack[kept] if len(stack) == len(kept) else stack for s, stack in stacks.items()}
        names = [difference.name for difference in differences]
        return cls(
            signals,
            dict(zip(names, away.tolist(), strict=True)),
            tuple(name for name, fine in zip(names, kept, strict=True) if not fine),
            Difference(MEAN, first.t, 0.0, {s: stack.mean(axis=0) for s, stack in good.items()}),
            _sizes({s: stack.std(axis=0, ddof=1) for s, stack in good.items() if len(stack) > 1}),
            _sizes({s: _trend(good[s], np.flatnonzero(kept)) for s in signals}),
            p_value,
        )


def _stack(differences: Sequence[Difference], signal: str) -> FloatArray:
    """A signal of those repeats that have it, at the times of the first, (R, T, k)."""
    first, *others = (d for d in differences if signal in d.signals)
    later = (sampled(d.t, d.signals[signal], None, first.t) for d in others)
    return np.stack([first.signals[signal], *later])


def _gram(paths: FloatArray) -> FloatArray:
    """Mean over time of the products of deviations from the mean, (R, R); rows that one repeat lacks are left out."""
    known = paths[:, np.isfinite(paths).all(axis=(0, 2))]
    deviations = (known - known.mean(axis=0)).reshape(len(paths), -1) if known.size else np.zeros((len(paths), 1))
    return np.asarray(deviations @ deviations.T / max(known.shape[1], 1), np.float64)


def _chance(gram: FloatArray, order: npt.NDArray[np.intp]) -> float:
    """Share of the orders of repeats that have a trend at least as large, by its square, which is a form of the Gram
    matrix.
    """
    count = len(order)
    if count < 3:
        return 1.0
    steps = order - order.mean()
    if math.factorial(count) <= ORDERS:
        drawn = np.array(list(permutations(steps)))
    else:
        drawn = np.random.default_rng(0).permuted(np.tile(steps, (ORDERS, 1)), axis=1)
        drawn[0] = steps
    sizes = np.einsum("ij,ij->i", drawn @ gram, drawn)
    return float(np.mean(sizes >= steps @ gram @ steps * (1 - 1e-9)))


def _trend(stack: FloatArray, order: npt.NDArray[np.intp]) -> FloatArray:
    """Change from one repeat to the next by least squares, (T, k)."""
    steps = order - order.mean()
    return np.asarray(np.tensordot(steps, stack, 1) / max(float(steps @ steps), 1.0))


def _sizes(signals: dict[str, FloatArray]) -> dict[str, float]:
    """RMS over time of the sizes of signals, (T, k); signals nowhere known are left out."""
    sizes = {signal: np.linalg.norm(values, axis=1) for signal, values in signals.items()}
    known = {signal: size[np.isfinite(size)] for signal, size in sizes.items()}
    return {signal: rms(size) for signal, size in known.items() if len(size)}
