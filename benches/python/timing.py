"""How everything here is timed, and what a result is."""

import gc
import time
from collections.abc import Callable
from dataclasses import dataclass
from statistics import median

REPEATS = 9


@dataclass(frozen=True)
class Result:
    """One line of the table: times in µs for the same unit of work, and what is required of ours."""

    what: str
    ours: float
    peer: str = ""
    theirs: float | None = None
    least_ratio: float | None = None
    most: float | None = None

    @property
    def ratio(self) -> float | None:
        """How many times faster ours is."""
        return None if self.theirs is None else self.theirs / self.ours

    @property
    def requirement(self) -> str:
        """In words; empty if none."""
        if self.least_ratio is not None:
            return f"≥ {self.least_ratio:g} times"
        return "" if self.most is None else f"≤ {self.most:g} µs"

    @property
    def met(self) -> bool:
        """Whether the requirement, if any, is met."""
        fast = self.least_ratio is None or (self.ratio or 0) >= self.least_ratio
        return fast and (self.most is None or self.ours <= self.most)


def microseconds(call: Callable[[], object], units: int, repeats: int = REPEATS) -> float:
    """Median time of a call over a few repeats, for each of the `units` of work that it does [µs]."""
    call()
    times = []
    gc.disable()
    for _ in range(repeats):
        start = time.perf_counter_ns()
        call()
        times.append(time.perf_counter_ns() - start)
    gc.enable()
    return median(times) / units / 1e3
