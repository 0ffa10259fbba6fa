"""Running any estimator on one recording or on several."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar, overload

from linkside.errors import EstimatorError

from .estimate import Estimate, result_of
from .log import Log

Found = TypeVar("Found", bound=Estimate)


@dataclass(frozen=True)
class Job(Generic[Found]):
    """One recording as the core takes it.

    Attributes
    ----------
    log
        The recording.
    core
        An estimator of the core; what it may have taken before does not matter.
    arrays
        The recording's arrays, as that estimator takes them.
    finish
        Makes an estimate of the arrays that the core gives.
    """

    log: Log
    core: Any
    arrays: tuple[Any, ...]
    finish: Callable[[dict[str, Any]], Found]


@overload
def run_each(log: Log, prepare: Callable[[Log], Job[Found]], run_all: Callable[..., list[Any]]) -> Found: ...
@overload
def run_each(
    log: Sequence[Log], prepare: Callable[[Log], Job[Found]], run_all: Callable[..., list[Any]]
) -> list[Found]: ...
@overload
def run_each(
    log: Log | Sequence[Log], prepare: Callable[[Log], Job[Found]], run_all: Callable[..., list[Any]]
) -> Found | list[Found]: ...
def run_each(
    log: Log | Sequence[Log], prepare: Callable[[Log], Job[Found]], run_all: Callable[..., list[Any]]
) -> Found | list[Found]:
    """Estimate a recording, or several on all cores, with the same bits as one by one.

    All recordings are checked before any is run. The first that fails raises an error with its name.
    """
    logs = [log] if isinstance(log, Log) else list(log)
    for one in logs:
        if not isinstance(one, Log):
            raise EstimatorError(f"log is {type(one).__name__!r}, expected a Log or several")
    jobs = [prepare(one) for one in logs]
    outcomes = run_all([(job.core, job.arrays) for job in jobs])
    found = [job.finish(result_of(job.log.source, one)) for job, one in zip(jobs, outcomes, strict=True)]
    return found[0] if isinstance(log, Log) else found


class Described:
    """Estimators have a one-line repr."""

    robot: Any

    def __repr__(self) -> str:
        """Name the class, the robot and the settings."""
        settings = "".join(f", {name}={value!r}" for name, value in self._described().items())
        return f"{type(self).__name__}({self.robot!r}{settings})"

    def _described(self) -> dict[str, Any]:
        """The settings that distinguish one from another."""
        return {}


class Copies(Described):
    """Copies of an estimator are estimators of their own: `copy.copy` keeps the state of `step`.

    A pickled one holds the settings only; after unpickling, `step` starts from the beginning.
    """

    _cores: tuple[str, ...] = ()
    """Attributes that hold an estimator of the core, or None."""

    def __copy__(self) -> Any:
        """Copy the state; what never changes is shared."""
        other = object.__new__(type(self))
        vars(other).update(vars(self))
        for name in self._cores:
            core = getattr(self, name)
            setattr(other, name, None if core is None else core.copy())
        return other

    def __deepcopy__(self, memo: dict[int, Any]) -> Any:
        """Settings and robot never change, so that this is `copy.copy`."""
        other = self.__copy__()
        memo[id(self)] = other
        return other

    def __getstate__(self) -> dict[str, Any]:
        """Everything but the core's part, which is rebuilt."""
        return {name: None if name in self._cores else value for name, value in vars(self).items()}
