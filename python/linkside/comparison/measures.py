"""What is measured of a difference between two motions."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from linkside.arrays import FloatArray
from linkside.statistics import rms

MEAN = "mean of repeats"
"""What the mean of repeats is called among estimates."""


@dataclass(frozen=True)
class Measure:
    """A signal's difference in one segment.

    Attributes
    ----------
    estimate, segment, signal, unit : str
        Whose, in which part, of what, such as ``q_a1`` or ``tool``, and in which SI unit.
    samples : int
        Rows that were compared.
    mean : float
        Constant part; of the tool, its length.
    rms, max, p50, p95 : float
        Root mean square, largest, and percentiles of the size.
    rms_centred, max_centred : float
        After the constant part is taken out.
    """

    estimate: str
    segment: str
    signal: str
    unit: str
    samples: int
    mean: float
    rms: float
    max: float
    p50: float
    p95: float
    rms_centred: float
    max_centred: float

    @classmethod
    def of(cls, names: tuple[str, str, str], unit: str, error: FloatArray) -> Measure:
        """Measure an error, (T, k), rows without NaN; k is 3 for the tool and 1 for a joint."""
        constant = error.mean(axis=0)
        size, centred = np.linalg.norm(error, axis=1), np.linalg.norm(error - constant, axis=1)
        mean = float(constant[0]) if error.shape[1] == 1 else float(np.linalg.norm(constant))
        p50, p95 = np.percentile(size, (50, 95))
        sizes = (rms(size), float(size.max()), float(p50), float(p95), rms(centred), float(centred.max()))
        return cls(*names, unit, len(error), mean, *sizes)


@dataclass(frozen=True, eq=False)
class Difference:
    """An estimate less the reference.

    Attributes
    ----------
    name : str
        The estimate's.
    t : (T,)
        Its times, by the reference's clock [s].
    shift : float
        What its clock was late by, taken out [s].
    signals : dict of str to (T, k)
        By column, ``tool`` with three components; NaN where there is nothing to compare with.
    """

    name: str
    t: FloatArray
    shift: float
    signals: dict[str, FloatArray]

    def measures(self, segment: str, rows: npt.NDArray[np.bool_], units: dict[str, str]) -> Iterator[Measure]:
        """Measure each signal in some rows; a signal that is nowhere known there is left out."""
        for signal, error in self.signals.items():
            known = error[rows]
            known = known[np.isfinite(known).all(axis=1)]
            if len(known):
                yield Measure.of((self.name, segment, signal), units[signal], known)
