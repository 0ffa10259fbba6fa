"""The summary line of an estimated log."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np

from linkside._core import largest_nis
from linkside.findings import Fault
from linkside.kalman.filtering import KalmanEstimate
from linkside.recording.estimate import Estimate

Item = TypeVar("Item")

STATUS_WORDS = {
    "damped": "damped near a singular posture",
    "bridged": "bridged over missing samples",
    "unseen": "with an acceleration that no sensor sees",
    "gated": "with an outlier left out",
    "predicted": "predicted without a reading",
    "unwrapped": "with an encoder's wrap taken out",
    "contradicted": "in contradiction to the model",
    "faulty": "of these by one channel",
}


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
    findings : tuple of Fault
        Contradictions between readings and model.
    disturbed : dict of str to float
        The largest disturbance torque of each link, where there are any [N m].
    """

    rows: int = 0
    motion: float = 0.0
    seconds: float = 0.0
    status: Counter[str] = field(default_factory=Counter)
    nis: float = 0.0
    used: int = 0
    findings: tuple[Fault, ...] = ()
    disturbed: dict[str, float] = field(default_factory=dict)
    _first: float | None = None

    def add(self, estimate: Estimate) -> None:
        """Count one piece."""
        if len(estimate):
            self._first = float(estimate.t[0]) if self._first is None else self._first
            self.motion = float(estimate.t[-1]) - self._first
        self.rows += len(estimate)
        self.status.update(estimate.status_summary())
        self.findings = estimate.findings or self.findings
        if estimate.disturbance is not None:
            largest = np.abs(estimate.disturbance).max(axis=0, initial=0.0)
            for name, torque in zip(estimate.names, largest.tolist(), strict=True):
                self.disturbed[name] = max(torque, self.disturbed.get(name, 0.0))
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
        text = f"{self.rows} rows, {self.motion:.6g} s of motion, {speed:.3g} µs per sample; {self._status()}{nis}"
        if not self.disturbed:
            return text
        torques = ", ".join(f"{name} {torque:.3g}" for name, torque in self.disturbed.items())
        return f"{text}; disturbance torques of links up to {torques} N m"

    @property
    def believable(self) -> bool:
        """Whether no reading contradicts the model, and the NIS is not above its bound."""
        return not self.findings and not self.status["contradicted"] and self.nis <= largest_nis(self.used)

    def _status(self) -> str:
        if self.status["good"] == self.rows:
            return "all good" if self.believable else "no row stands out, but the NIS is outside its bounds"
        odd = (f"{count} {STATUS_WORDS.get(word, word)}" for word, count in self.status.items() if count)
        return ", ".join(odd)
