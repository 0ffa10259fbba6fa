"""What the filters of all models share: readings by kind, one recording or many, the live state."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, Literal, Protocol, TypeVar, overload

import numpy as np
import numpy.typing as npt

from linkside.arguments import whole
from linkside.arrays import FloatArray
from linkside.channels import BIASED, CHANNELS
from linkside.errors import EstimatorError, NumericalError
from linkside.findings import named
from linkside.recording.batch import Copies, Described, Job, run_each
from linkside.recording.estimate import Estimate, without_waits
from linkside.recording.log import Log
from linkside.robot import Robot, wrenches
from linkside.robot.compiled import period_of

from .cleaning import cleaned
from .disturbance_evidence import explains, is_seen, is_suspicious, looks_broken, of_estimate, of_load
from .exclusion import excluding
from .late_sensors import sensors
from .linearisation import Linearisation, checked
from .link_disturbance import LinkDisturbance, Outside, Wanted, check, given_law
from .losses import Losses, by_kind
from .scale import blame_settings
from .start import Moving, Readings, Spread, Start, find_start, given


@dataclass(frozen=True, eq=False, repr=False)
class KalmanEstimate(Estimate):
    """An estimate with the quantities that show whether to trust it.

    Attributes
    ----------
    used : (T,)
        Readings used at each sample.
    log_likelihood : (T,)
        Logarithm of the probability density of the sample's readings, given those before.
    state : (T, k), optional
        The filter's whole state, biases last; ``covariance`` belongs to it.
    innovation, innovation_std : (T, m), optional
        Readings minus their predictions, and the standard deviations of these differences.
    channels : tuple of str
        The m columns of the log that were read.
    """

    used: npt.NDArray[np.uint32] | None = None
    log_likelihood: FloatArray | None = None
    state: FloatArray | None = None
    innovation: FloatArray | None = None
    innovation_std: FloatArray | None = None
    channels: tuple[str, ...] = ()


class CoreFilter(Protocol):
    """A filter of the core, with the belief after the samples that it took."""

    @property
    def states(self) -> int:
        """Number of states."""

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the state, (states, states)."""


class Startable(CoreFilter, Protocol):
    """A filter of the core whose start can be set."""

    def reset(self) -> None:
        """Forget the state."""

    @property
    def own_states(self) -> int:
        """Number of states, but for those of late sensors."""

    def set_start(self, mean: FloatArray, covariance: FloatArray) -> None:
        """Let a first sample find this belief."""


Core = TypeVar("Core", bound=CoreFilter)


class LiveFilter(Copies, ABC, Generic[Core]):
    """The state between calls of ``step``."""

    _cores = ("_started",)

    def __init__(self) -> None:
        self.status = 0
        self._started: Core | None = None
        self._period = np.inf  # of the samples, where `step` has begun

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the state after the last `step`, (states, states)."""
        return self._live.covariance

    def reset(self) -> None:
        """Reset: the next `step` starts from the beginning."""
        self._started, self.status = None, 0

    @property
    def _live(self) -> Core:
        if self._started is None:
            self._started = self._start()
        return self._started

    @abstractmethod
    def _start(self) -> Core:
        """Build a filter that has taken no sample."""


class KalmanMethod(Described, ABC):
    """A Kalman filter, or by ``_way`` a smoother, of any model, over recordings."""

    _way: Literal["filter", "smooth", "iterate"] = "filter"
    noise: Any
    left_out: tuple[str, ...] = ()
    """Fields of its estimates that are no columns."""

    def __init__(
        self,
        robot: Robot,
        wanted: Mapping[str, bool | None],
        biases: Sequence[str],
        gate: float | None,
        iterations: int,
        start: Start = "auto",
        link_disturbance: Wanted = False,
        loss: Losses = "squares",
        linearisation: Linearisation = "derivatives",
        exclude_faulty: bool = False,
    ) -> None:
        super().__init__()
        self._exclude_faulty = exclude_faulty
        self._linearisation = checked(linearisation, self._way)
        self._losses = by_kind(loss)
        self._link_disturbance = check(link_disturbance)
        if isinstance(start, str) and start not in ("auto", "rest"):
            raise EstimatorError(f"start is {start!r}, expected 'auto', 'rest', or a mean and a covariance")
        self._at = start
        unknown = sorted(set(biases) - set(BIASED))
        if unknown:
            raise EstimatorError(f"biases: {unknown[0]!r} is not one of {', '.join(map(repr, BIASED))}")
        robot.require_masses("a Kalman filter", elastic_only=True)
        self.robot = robot
        self._wanted, self._biases = dict(wanted), tuple(biases)
        if robot.wrench_channels:
            self._wanted["wrench"] = True
        if robot.position_channels:
            self._wanted["position"] = None
        self._gate, self._iterations = gate, whole("iterations", iterations, least=1)

    def _described(self) -> dict[str, Any]:
        start = self._at if isinstance(self._at, str) else "given"
        return {
            "biases": self._biases,
            "gate": self._gate,
            "start": start,
            "link_disturbance": self._link_disturbance,
            "loss": self._described_losses(),
            "linearisation": self._linearisation,
            "exclude_faulty": self._exclude_faulty,
        }

    @property
    def _points(self) -> str | None:
        """The sigma points that are in place of derivatives, if any."""
        return None if self._linearisation == "derivatives" else self._linearisation

    def _described_losses(self) -> Any:
        """The loss of all kinds, or of each that has another than squares."""
        if len(set(self._losses.values())) == 1:
            return self._losses["motor"]
        return {kind: loss for kind, loss in self._losses.items() if loss != "squares"}

    @overload
    def run(self, log: Log, *, covariance: bool = False, innovations: bool = False) -> KalmanEstimate: ...
    @overload
    def run(
        self, log: Sequence[Log], *, covariance: bool = False, innovations: bool = False
    ) -> list[KalmanEstimate]: ...
    def run(
        self, log: Log | Sequence[Log], *, covariance: bool = False, innovations: bool = False
    ) -> KalmanEstimate | list[KalmanEstimate]:
        """Estimate a recording, or several on all cores; each starts as ``start`` says.

        Parameters
        ----------
        log
            The recording, with motor positions of all joints, and on the elastic-joint model motor torques.
        covariance
            Keep the whole state and its covariance.
        innovations
            Keep the innovations and their standard deviations.

        Raises
        ------
        LogError
            A column is missing, or at the first sample a value that the model needs.
        NumericalError
            The estimate is no longer finite; names the sample.
        """
        logs = [log] if isinstance(log, Log) else log
        try:
            found = self._run_logs(logs, covariance, innovations)
            if self._exclude_faulty:
                found = [self._excluding(*pair, covariance, innovations) for pair in zip(logs, found, strict=True)]
            return found[0] if isinstance(log, Log) else found
        except NumericalError as error:
            raise blame_settings(error, self.robot, self.noise) from None

    def _run_logs(self, logs: Sequence[Log], covariance: bool, innovations: bool) -> list[KalmanEstimate]:
        """Estimates with all channels, and with disturbance torques where there are some."""
        found: list[KalmanEstimate] = self._run_each(logs, self._job, covariance, innovations)
        if self._link_disturbance is False:
            return found
        return [self._disturbed(*pair, covariance, innovations) for pair in zip(logs, found, strict=True)]

    def _excluding(self, log: Log, plain: KalmanEstimate, covariance: bool, innovations: bool) -> KalmanEstimate:
        """The estimate without channels that are faulty, else ``plain``."""
        signals = [CHANNELS[kind].signal for kind in self.kinds(log)]
        return excluding(log, plain, signals, lambda rest: self._run_logs([rest], covariance, innovations)[0])

    def refuse_pieces(self) -> None:
        """Refuse a recording that comes in pieces where it is read more than once."""
        if self._exclude_faulty:
            raise EstimatorError("exclude_faulty: a recording is estimated several times; use run, not pieces of it")

    def _run_each(
        self, log: Any, job: Callable[[Log], Job[KalmanEstimate]], covariance: bool, innovations: bool
    ) -> Any:
        return run_each(log, job, lambda jobs: self._run_all(jobs, self._way, covariance, innovations))

    def _filtered(self, log: Log, law: LinkDisturbance | None) -> KalmanEstimate:
        """The filter's estimate of a recording, also of a smoother."""
        return run_each(log, lambda one: self._job(one, law), lambda jobs: self._run_all(jobs, "filter", False, False))

    def _disturbed(self, log: Log, plain: KalmanEstimate, covariance: bool, innovations: bool) -> KalmanEstimate:
        """The estimate with disturbance torques of the links where there are some, else ``plain``."""
        law = self._law(log, plain)
        if law is None:
            return plain
        found: KalmanEstimate = self._run_each(log, lambda one: self._job(one, law), covariance, innovations)
        return found

    def law(self, log: Log) -> LinkDisturbance | None:
        """How the links' disturbance torques wander in a recording; None where there are none."""
        return None if self._link_disturbance is False else self._law(log, self._filtered(log, None))

    def _law(self, log: Log, plain: KalmanEstimate) -> LinkDisturbance | None:
        """The same, by an estimate without such torques."""
        automatic, kinds = self._link_disturbance == "auto", self.kinds(log)
        if automatic and not (is_seen(kinds) and is_suspicious(plain)):
            return None
        law = of_load(self.noise, self.robot, log, plain)
        try:
            found = self._filtered(log, law)
            if self.noise.link_disturbance is None:
                law = of_estimate(law, found)
                found = self._filtered(log, law)
        except NumericalError:
            if automatic:
                return None
            raise
        if automatic and not (explains(found, plain) and not looks_broken(self.robot, log, kinds, plain, found)):
            return None
        return law

    @property
    def live_law(self) -> LinkDisturbance | None:
        """The same for `step`, which has no recording to look at."""
        return given_law(self.noise, self.robot) if self._link_disturbance is True else None

    def _loss_names(self, kinds: tuple[str, ...]) -> list[str]:
        """What errors of each channel cost; none where all of them cost squares."""
        if all(self._losses[kind] == "squares" for kind in kinds):
            return []
        return [self._losses[kind] for kind in kinds for _ in range(self.width(kind))]

    def _begin(
        self,
        core: Startable,
        first: Readings | None,
        kinds: tuple[str, ...],
        noise: Any,
        jerk: FloatArray,
        law: LinkDisturbance | None = None,
    ) -> None:
        """Set where a filter of the core starts: as the user says, or from its first samples, if there are any."""
        start = self._found(core.own_states, first, kinds, noise, jerk, law)
        if start is not None:
            core.set_start(*start)

    def _found(
        self,
        own_states: int,
        first: Readings | None,
        kinds: tuple[str, ...],
        noise: Any,
        jerk: FloatArray,
        law: LinkDisturbance | None,
    ) -> tuple[FloatArray, FloatArray] | None:
        """Mean and covariance of the state at the first sample; None: at rest."""
        if self._at == "rest":
            return None
        arrays = noise.arrays(self.robot, kinds)
        biased = self._channels(kinds)["biased"]
        bias = np.array(arrays["initial_bias"])[biased]
        if not isinstance(self._at, str):
            outside = Outside(law, self.robot)
            dense = own_states - len(bias) - outside.states
            start = given(self._at, np.concatenate([np.zeros(dense), bias]), dense)
            return outside.widened(start, dense)
        if first is None:
            return None
        n = self.robot.n
        sensors = np.array(arrays["reading"])[n:][: self.width("acceleration") if "acceleration" in kinds else 0]
        spread = Spread(np.array(arrays["reading"])[:n], max(noise.motor_velocity, 1e-9), sensors, jerk)
        if "acceleration" not in kinds:
            first = replace(first, acceleration=None)
        motors, acceleration = (self._losses[kind] != "squares" for kind in ("motor", "acceleration"))
        first = cleaned(first, spread, motors=motors, acceleration=acceleration)
        moving = find_start(self.robot, first, spread)
        if moving is None:
            return None
        mean, std = self._state(moving, arrays, kinds)
        dense, std = len(std), np.concatenate([std, bias])
        start = np.concatenate([mean, np.zeros(len(bias))]), self._tied(np.diag(std**2), moving)
        return Outside(law, self.robot).widened(start, dense, first.wrench, arrays["reading"])

    def _compiled_start(
        self, own_states: int, kinds: tuple[str, ...], noise: Any, law: LinkDisturbance | None
    ) -> dict[str, Any] | None:
        """Describe where a filter in a controller starts; None: from rest."""
        if self._at == "auto":
            raise EstimatorError("a controller has no recording to see where a filter starts: start='rest', or a state")
        start = self._found(own_states, None, kinds, noise, np.zeros(self.robot.n), law)
        return None if start is None else {"mean": start[0].tolist(), "covariance": start[1].tolist()}

    def _compiled_period(self, period: float | None, kinds: tuple[str, ...]) -> float:
        """The period that the delays of sensors are counted in."""
        if not any(sensor is not None and sensor.delay for kind in kinds for sensor in sensors(self.robot, kind)):
            return np.inf
        return period_of(self.robot, period, "as sensors have delays")

    def _tied(self, covariance: FloatArray, moving: Moving) -> FloatArray:
        """Set the correlations of states that depend on each other at the start."""
        return covariance

    @abstractmethod
    def _state(
        self, moving: Moving, arrays: Mapping[str, Any], kinds: tuple[str, ...]
    ) -> tuple[FloatArray, FloatArray]:
        """Mean and standard deviations of the state without biases, of a robot that is moving."""

    @abstractmethod
    def _job(self, log: Log, law: LinkDisturbance | None = None) -> Job[KalmanEstimate]:
        """Prepare one recording, links having disturbance torques that wander as ``law`` says."""

    @abstractmethod
    def kinds(self, log: Log) -> tuple[str, ...]:
        """Kinds of channels to use, in the filter's order."""

    _run_all: Callable[..., list[Any]]
    """Of the core's filter."""

    def _with_wanted(self, kinds: tuple[str, ...], log: Log, purpose: str) -> tuple[str, ...]:
        """``kinds`` and those that were asked for, or are there unless asked about."""
        chosen = list(kinds)
        for kind, wanted in self._wanted.items():
            if wanted:
                log.require(kind, purpose=purpose)
            if wanted or (wanted is None and getattr(log, kind) is not None):
                chosen.append(kind)
        return tuple(chosen)

    def width(self, kind: str) -> int:
        """Channels of a kind."""
        return CHANNELS[kind].width(self.robot)

    def _channels(self, kinds: tuple[str, ...]) -> dict[str, Any]:
        """Kinds of channels as the core names them, and which of their channels have a bias."""
        return {
            "kinds": [CHANNELS[kind].signal for kind in kinds],
            "biased": [kind in self._biases for kind in kinds for _ in range(self.width(kind))],
        }

    @property
    def _wrench_law(self) -> dict[str, list[float]]:
        """How varying wrenches wander, as the core takes it."""
        return {name: values.tolist() for name, values in wrenches.law(self.robot.varying_wrenches).items()}

    def columns(self, log: Log, kinds: tuple[str, ...]) -> tuple[str, ...]:
        """Columns of a log that channels of these kinds read."""
        return tuple(name for kind in kinds for name in log.columns(CHANNELS[kind].signal))

    def _estimate(self, log: Log, kinds: tuple[str, ...], result: dict[str, Any]) -> KalmanEstimate:
        columns = self.columns(log, kinds)
        found = named(result.pop("findings", ()), columns)
        return self.told(t=log.t, channels=columns, findings=found, **without_waits(log, result))

    def told(self, **fields: Any) -> KalmanEstimate:
        """Make an estimate of these fields, with the names of what it is of."""
        outside = tuple(wrench.name for wrench in self.robot.varying_wrenches)
        return KalmanEstimate(names=self.robot.names, wrenches=outside, left_out=self.left_out, **fields)
