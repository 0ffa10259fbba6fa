"""The first samples decide where a filter starts: of a recording, of its pieces, or live."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from itertools import chain
from typing import Any, TypeVar

import numpy as np

from linkside import _core
from linkside.arguments import finite_or_missing, numbers, sized, time_step
from linkside.errors import EstimatorError, NumericalError
from linkside.recording.log import Log
from linkside.robot import Robot

from .filtering import Core, LiveFilter
from .start import WINDOW, Readings, Start

Filter = TypeVar("Filter")
Found = TypeVar("Found")


class DecidingFilter(LiveFilter[Core]):
    """A live filter that determines its initial state from its first samples.

    Whenever their number has doubled, and when all are there, the initial state is computed again and the samples are
    processed again. The filter is then where it would be if it had waited for them.
    """

    robot: Robot
    _at: Start

    def __init__(self, *arguments: Any, **settings: Any) -> None:
        super().__init__(*arguments, **settings)
        self._early: list[dict[str, Any]] = []

    def reset(self) -> None:
        """Reset: the next `step` starts from the beginning."""
        super().reset()
        self._early = []

    def __copy__(self) -> Any:
        """Copy the state, the samples that may be redone included."""
        other = super().__copy__()
        other._early = self._early.copy()
        return other

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restart."""
        vars(self).update(state)
        self.reset()

    def _decide(
        self, sample: dict[str, Any], step: Callable[..., _core.State], begin: Callable[[Readings], None]
    ) -> _core.State:
        """Take one of the first samples; when their number has doubled, restart and take all of them again."""
        sample = own_sample(sample)
        if not self._early:
            self._period = sample["dt"]
        before = self._started, self.status
        self._early.append(sample)
        try:
            anew = _decides(len(self._early))
            if anew:
                self._start_anew()
                begin(early_readings(self.robot, self._early))
            for early in self._early if anew else [sample]:
                state = step(**early)
        except EstimatorError:
            self._early.pop()
            self._started, self.status = before
            raise
        except NumericalError:
            self.reset()
            raise
        return state

    def _start_anew(self) -> None:
        """Drop the samples of the live filter; it goes on."""
        self._started = self._start()

    def _deciding(self) -> bool:
        return self._at == "auto" and len(self._early) < WINDOW


def early_readings(robot: Robot, samples: list[dict[str, Any]]) -> Readings:
    """The first samples that `step` took."""
    columns = {"theta": robot.n, "dtheta": robot.n, "acceleration": len(robot.acceleration_channels)}
    signals = {name: np.array([sized(name, s.get(name), k) for s in samples]) for name, k in columns.items()}
    t = np.cumsum([s["dt"] for s in samples])
    there = {name: None if np.isnan(values).all() else values for name, values in signals.items()}
    return Readings(t, signals["theta"], there["dtheta"], there["acceleration"])


def _decides(samples: int) -> bool:
    """Whether the initial state is computed again at this number of samples."""
    return samples.bit_count() == 1 or samples == WINDOW


def own_sample(sample: dict[str, Any]) -> dict[str, Any]:
    """A sample of `step` that may be taken again later: a caller may write into its arrays."""
    return {name: _copied(name, value) for name, value in sample.items()}


def _copied(name: str, value: Any) -> Any:
    """A signal of a sample, or its step of time, that a filter can take."""
    if name == "dt":
        return time_step(value)
    return None if value is None else finite_or_missing(name, np.array(numbers(name, value)))


def first_readings(log: Log) -> Readings:
    """The samples of a recording that decide where it starts."""
    optional = (None if s is None else s[:WINDOW] for s in (log.dtheta, log.acceleration, log.wrench))
    return Readings(log.t[:WINDOW], log.theta[:WINDOW], *optional)


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
    for name in ("dtheta", "acceleration", "wrench"):
        parts = [getattr(f, name) for f in firsts]
        optional.append(None if any(part is None for part in parts) else np.concatenate(parts)[:WINDOW])
    return Readings(*joined, *optional), chain(taken, rest)


def in_pieces(
    pieces: Iterable[Log],
    start: Callable[[Log, Readings], tuple[Filter, tuple[str, ...]]],
    run: Callable[[Filter, tuple[str, ...], Log, Log | None], dict[str, Any]],
    finish: Callable[[Log, tuple[str, ...], dict[str, Any]], Found],
) -> Iterator[Found]:
    """Estimates of pieces of a recording, by one filter of the core that goes on from piece to piece.

    ``start`` makes it of the first piece and the samples that decide, and names the kinds of its channels; ``run``
    gives it a piece, with the last row of the one before.
    """
    first, pieces = with_first(pieces)
    started: tuple[Filter, tuple[str, ...]] | None = None
    before: Log | None = None
    for piece in pieces:
        if started is None:
            assert first is not None  # there is a piece
            started = start(piece, first)
        core, kinds = started
        try:
            result = run(core, kinds, piece, before)
        except NumericalError as error:
            raise NumericalError(f"{piece.source}: {error}") from None
        before = piece[-1:]
        yield finish(piece, kinds, result)
