"""The first samples decide where a filter starts: of a recording, of its pieces, or live."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from itertools import chain
from typing import Any

import numpy as np

from linkside.arguments import sized
from linkside.arrays import FloatArray
from linkside.errors import EstimatorError
from linkside.recording.log import Log

from .filtering import Core, KalmanMethod, LiveFilter
from .start import WINDOW, Readings


class DecidingFilter(KalmanMethod, LiveFilter[Core]):
    """A live filter whose first samples decide where it starts: each of them redoes those before it."""

    def __init__(self, *arguments: Any, **settings: Any) -> None:
        super().__init__(*arguments, **settings)
        self._early: list[dict[str, Any]] = []

    def reset(self) -> None:
        """Forget the state: the next `step` starts anew."""
        super().reset()
        self._early = []

    def _decide(
        self, sample: dict[str, Any], step: Callable[..., FloatArray], begin: Callable[[Readings], None]
    ) -> Any:
        """Take one of the first samples, which decide where the filter starts: all of them, from where they say."""
        if not self._early:
            self._period = sample["dt"]
        self._early.append({name: np.array(x, float) if np.ndim(x) else x for name, x in sample.items()})
        try:
            self._start_anew()
            begin(self._early_readings())
            for early in self._early:
                state = step(**early)
        except EstimatorError:
            self._early.pop()
            raise
        return state

    def _start_anew(self) -> None:
        """Let the live filter forget its samples, but not that it lives."""
        self._started = self._start()

    def _deciding(self) -> bool:
        return self._at == "auto" and len(self._early) < WINDOW

    def _early_readings(self) -> Readings:
        """The first samples that `step` took."""
        n = self.robot.n
        columns = {"theta": n, "dtheta": n, "acceleration": self.width("acceleration")}
        signals = {name: np.array([sized(name, s.get(name), k) for s in self._early]) for name, k in columns.items()}
        t = np.cumsum([s["dt"] for s in self._early])
        there = {name: None if np.isnan(values).all() else values for name, values in signals.items()}
        return Readings(t, signals["theta"], there["dtheta"], there["acceleration"])


def first_readings(log: Log) -> Readings:
    """The samples of a recording that decide where it starts."""
    dtheta, acceleration = (None if s is None else s[:WINDOW] for s in (log.dtheta, log.acceleration))
    return Readings(log.t[:WINDOW], log.theta[:WINDOW], dtheta, acceleration)


def with_first(pieces: Iterable[Log]) -> tuple[Readings | None, Iterator[Log]]:
    """The samples that decide where a recording starts, and all of its pieces."""
    taken: list[Log] = []
    rest = iter(pieces)
    while sum(map(len, taken)) < WINDOW and (piece := next(rest, None)) is not None:
        taken.append(piece)
    if not taken:
        return None, iter(())
    firsts = [first_readings(piece) for piece in taken]
    joined = (np.concatenate([np.atleast_1d(getattr(f, name)) for f in firsts])[:WINDOW] for name in ("t", "theta"))
    optional = []
    for name in ("dtheta", "acceleration"):
        parts = [getattr(f, name) for f in firsts]
        optional.append(None if any(part is None for part in parts) else np.concatenate(parts)[:WINDOW])
    return Readings(*joined, *optional), chain(taken, rest)
