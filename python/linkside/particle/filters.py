"""Particle filters: distributions that are not normal, joints with limits, readings with outliers."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal, overload

import numpy as np
import numpy.typing as npt

from linkside import _core
from linkside.arguments import one_of, whole
from linkside.arrays import FloatArray
from linkside.channels import OUTLIERS, widths
from linkside.errors import EstimatorError
from linkside.findings import named
from linkside.kalman.jerk_driven import ExtendedKalmanFilter, JerkDrivenFilter
from linkside.kalman.noise import Noise
from linkside.kalman.start import Readings, Start
from linkside.kalman.starting import DecidingFilter, first_readings, in_pieces
from linkside.recording.batch import Job, run_each
from linkside.recording.estimate import Estimate, without_waits
from linkside.recording.log import Log
from linkside.robot import Robot
from linkside.robot.requirements import refuse_unsupported


@dataclass(frozen=True)
class Mixture:
    """Normal noise with outliers, (1 - share) N(0, σ²) + share N(0, (scale σ)²), with σ of `Noise` or robot.yaml.

    Attributes
    ----------
    share
        Probability that a reading is an outlier, between 0 and 1.
    scale
        Standard deviation of outliers in units of σ, above 1.
    """

    share: float
    scale: float


@dataclass(frozen=True, eq=False, repr=False)
class ParticleEstimate(Estimate):
    """Means over the particles, with the quantities that show how well they represent the state.

    Attributes
    ----------
    effective : (T,)
        Effective number of particles 1/Σw², before resampling.
    reseeded : (T,)
        Whether the cloud was drawn again from the Kalman filter that runs beside it.
    log_likelihood : (T,)
        Logarithm of the probability density of the sample's readings, given those before, as the particles have it.
    used : (T,)
        Readings used at each sample.
    best : (T, n)
        Link positions of the particle of largest weight [rad].
    quantiles : (T, k, n), optional
        Quantiles of the link positions, for the k shares that were asked for [rad].
    state : (T, d), optional
        Mean of the whole state: q, dq, ddq, then biases; ``covariance`` belongs to it.
    channels : tuple of str
        The columns of the log that were read.
    """

    effective: FloatArray | None = None
    reseeded: npt.NDArray[np.bool_] | None = None
    log_likelihood: FloatArray | None = None
    used: npt.NDArray[np.uint32] | None = None
    best: FloatArray | None = None
    quantiles: FloatArray | None = None
    state: FloatArray | None = None
    channels: tuple[str, ...] = ()


class ParticleFilter(DecidingFilter[_core.ParticleFilter], JerkDrivenFilter[_core.ParticleFilter]):
    """Particle filter on the jerk-driven model, with the same noise as `ExtendedKalmanFilter`.

    Axelsson, Karlsson and Norrlöf, "Tool position estimation of a flexible industrial robot using recursive Bayesian
    methods", ICRA 2012. N weighted samples of the state (link positions, velocities, accelerations, biases) represent
    its distribution; only the proposal is linearised.

    Parameters
    ----------
    robot
        The robot, with its accelerometers and gyroscopes.
    noise
        Noise levels; the scale of jerk is estimated from the log unless given.
    particles
        N.
    seed
        The same seed gives the same numbers, whatever the threads and the processor.
    proposal
        ``"linearised"`` moves each particle by the readings linearised at it, ``"bootstrap"`` by the process alone.
    iterations
        How often the linearised proposal is linearised.
    proposal_tail
        Degrees of freedom, even, of Student's density for the linearised proposal; None keeps it normal.
    resampling
        ``"systematic"``, ``"stratified"``, ``"residual"`` or ``"multinomial"``.
    threshold
        Particles are resampled when fewer than this share of N is effective; None: 0.8, without ``kernel`` 0.5.
    kernel
        Width of the normal density that then spreads copies, relative to the cloud (Liu and West 2001); mean and
        covariance are kept. None leaves copies where they are, and Monte-Carlo error in the mean.
    outliers
        Noise that is not normal, by kind of channel: degrees of freedom of Student's density, or a `Mixture`, such as
        ``{"acceleration": 4.0}`` or ``{"acceleration": Mixture(share=0.02, scale=50)}``.
    limits
        Least and largest position by joint [rad]; particles beyond are impossible.
    initial : (k, n)
        Link positions at rest that particles start from in turn, each spread by ``noise.position`` [rad], for example
        for several possible postures. None: as ``start`` says.
    start
        As of `ExtendedKalmanFilter`: ``"auto"``, from the first 32 samples; ``"rest"``, the posture in which the first
        motor positions hold the links; or a mean and a covariance of the state, with or without its biases. During the
        first samples, each `step` repeats the estimate of those before.
    collapse
        What to do with a cloud that does not explain the readings, as a Kalman filter that runs beside it does.
        ``"reseed"`` flags the row `Status.CONTRADICTED` and draws the cloud again from the Kalman filter's estimate; a
        cloud that has only lost its spread is renewed earlier, and each resampling moves it towards that estimate as
        far as their difference is explained by chance. ``"flag"`` flags the row and leaves the cloud as it is.
        ``"raise"`` stops with the sample's number. A sample that is impossible for every particle counts as missing,
        and its row is flagged, unless it stops the run.
    quantiles
        Shares of probability, such as ``(0.05, 0.95)``, whose quantiles of position are kept.
    biases, damping, rate, q, torque, tolerances
        As of `ExtendedKalmanFilter`.

    Raises
    ------
    EstimatorError
        Settings out of range.

    Notes
    -----
    `run` on one log uses one thread for up to 2047 particles, and all cores for more.
    """

    _marginalised: Literal["nothing", "biases", "accelerations"] = "nothing"

    def __init__(
        self,
        robot: Robot,
        noise: Noise | None = None,
        *,
        particles: int = 1000,
        seed: int = 0,
        proposal: Literal["linearised", "bootstrap"] = "linearised",
        iterations: int = 1,
        proposal_tail: int | None = None,
        resampling: Literal["systematic", "stratified", "residual", "multinomial"] = "systematic",
        threshold: float | None = None,
        kernel: float | None = 0.5,
        outliers: Mapping[str, float | Mixture] | None = None,
        limits: Mapping[str, tuple[float, float]] | None = None,
        initial: npt.ArrayLike | None = None,
        start: Start = "auto",
        collapse: Literal["reseed", "flag", "raise"] = "reseed",
        quantiles: Sequence[float] = (),
        biases: Sequence[str] = ("motor", "acceleration", "rate"),
        damping: bool = True,
        rate: bool | None = None,
        q: bool | None = None,
        torque: bool | None = None,
        tolerances: bool = True,
    ) -> None:
        super().__init__()
        one_of("collapse", collapse, ("reseed", "flag", "raise"))
        refuse_unsupported(robot, "a particle filter")
        self._front = ExtendedKalmanFilter(
            robot,
            noise,
            biases=biases,
            damping=damping,
            rate=rate,
            q=q,
            torque=torque,
            tolerances=tolerances,
            start=start if initial is None else "rest",
        )
        self.robot = self._front.robot
        self._at = start if initial is None else "rest"
        self.noise = self._front.noise
        self._outliers = _by_kind(outliers or {})
        self._settings = {
            "particles": whole("particles", particles),
            "seed": whole("seed", seed) % 2**64,
            "proposal": proposal,
            "iterations": whole("iterations", iterations),
            "proposal_tail": proposal_tail,
            "resampling": resampling,
            "threshold": threshold if threshold is not None else 0.5 if kernel is None else 0.8,
            "kernel": kernel,
            "limits": _by_joint(robot, limits or {}),
            "initial": _positions(robot, initial),
            "collapse": collapse,
            "quantiles": list(quantiles),
        }
        self._start()  # settings are checked at once

    def _described(self) -> dict[str, Any]:
        return {name: self._settings[name] for name in ("particles", "seed", "proposal", "resampling")}

    @overload
    def run(self, log: Log, *, covariance: bool = False) -> ParticleEstimate: ...
    @overload
    def run(self, log: Sequence[Log], *, covariance: bool = False) -> list[ParticleEstimate]: ...
    def run(self, log: Log | Sequence[Log], *, covariance: bool = False) -> ParticleEstimate | list[ParticleEstimate]:
        """Estimate a recording, or several on all cores; each starts as ``start`` says.

        Parameters
        ----------
        log
            The recording, with motor positions of all joints.
        covariance
            Keep the whole state and its covariance.

        Raises
        ------
        LogError
            A column is missing, or a motor position at the first sample.
        NumericalError
            The particles do not explain a sample, with ``collapse="raise"``; names the sample.
        """
        return self._recorded(log, smooth=False, covariance=covariance)

    @overload
    def smooth(self, log: Log, *, covariance: bool = False) -> ParticleEstimate: ...
    @overload
    def smooth(self, log: Sequence[Log], *, covariance: bool = False) -> list[ParticleEstimate]: ...
    def smooth(
        self, log: Log | Sequence[Log], *, covariance: bool = False
    ) -> ParticleEstimate | list[ParticleEstimate]:
        """Estimate each sample of a recording from all of its samples, including later ones.

        Rauch, Tung and Striebel's pass (1965) back along the clouds' means and covariances: the motion is linear and
        its noise normal, so nothing is linearised again. The non-normal part of a cloud is not carried back. There is
        neither ``best`` nor ``quantiles``; ``effective``, ``log_likelihood`` and ``status`` are the filter's. Memory is
        about d²/2 numbers a sample, d the number of states. Parameters and errors are those of `run`.
        """
        return self._recorded(log, smooth=True, covariance=covariance)

    def run_pieces(self, pieces: Iterable[Log]) -> Iterator[ParticleEstimate]:
        """Estimate a recording that comes piece by piece, in bounded memory.

        The same bits as `run` when ``noise.jerk`` is given; otherwise the scale of jerk is read off the first piece.
        """

        def run(core: _core.ParticleFilter, kinds: tuple[str, ...], piece: Log, before: Log | None) -> dict[str, Any]:
            return core.run(self._front.arrays(piece, kinds, before), False)

        return in_pieces(pieces, self._prepared, run, self._estimate)

    def step(self, **sample: Any) -> _core.State:
        """Take one sample and give the state at its time; arguments as of `JerkDrivenFilter.step`."""
        if not self._deciding():
            return super().step(**sample)
        return self._decide(sample, super().step, lambda first: self._begin(self._live, first))

    @property
    def effective(self) -> float:
        """Effective number of particles after the last `step`."""
        return self._live.effective

    def _start(self) -> _core.ParticleFilter:
        core = self._core(self._front.live_kinds, self.noise, self._period)
        self._begin(core, None)
        return core

    def _begin(self, core: _core.ParticleFilter, first: Readings | None) -> None:
        self._front.begin(core, first, self._front.live_kinds, self.noise)

    def _recorded(
        self, log: Log | Sequence[Log], *, smooth: bool, covariance: bool
    ) -> ParticleEstimate | list[ParticleEstimate]:
        return run_each(log, self._job, lambda jobs: _core.ParticleFilter.run_all(jobs, smooth, covariance))

    def _job(self, log: Log) -> Job[ParticleEstimate]:
        core, kinds = self._prepared(log, first_readings(log))
        return Job(log, core, self._front.arrays(log, kinds), partial(self._estimate, log, kinds))

    def _prepared(self, log: Log, first: Readings) -> tuple[_core.ParticleFilter, tuple[str, ...]]:
        """A filter of the core that starts where the ``first`` samples say, and the kinds of its channels."""
        kinds, noise = self._front.kinds(log), self.noise.for_log(log, self.robot)
        core = self._core(kinds, noise, log.period)
        self._front.begin(core, first, kinds, noise)
        return core, kinds

    def _core(self, kinds: tuple[str, ...], noise: Noise, period: float) -> _core.ParticleFilter:
        settings = self._front.settings(kinds, noise, period)
        each = zip(kinds, widths(self.robot, kinds), strict=True)
        outliers = [self._outliers.get(kind) for kind, width in each for _ in range(width)]
        return _core.ParticleFilter(
            self.robot.core,
            **settings,
            marginalised=self._marginalised,
            settings=self._settings | {"outliers": outliers},
        )

    def _estimate(self, log: Log, kinds: tuple[str, ...], result: dict[str, Any]) -> ParticleEstimate:
        channels = self._front.columns(log, kinds)
        found = named(result.pop("findings"), channels)
        return ParticleEstimate(
            t=log.t,
            names=self.robot.names,
            channels=channels,
            findings=found,
            left_out=self._front.left_out,
            **without_waits(log, result),
        )


class MarginalizedParticleFilter(ParticleFilter):
    """Particle filter with a part of the state marginalised (Rao–Blackwellised).

    Schön, Gustafsson and Nordlund, "Marginalized particle filters for mixed linear/nonlinear state-space models", IEEE
    Transactions on Signal Processing 53 (2005). Particles represent positions, velocities and accelerations only; the
    biases, which add to the readings and depend on nothing else, are computed in closed form for each. ``outliers`` are
    not supported.

    Parameters
    ----------
    robot, noise, settings
        As of `ParticleFilter`.
    accelerations
        Marginalise accelerations, too: particles represent positions and velocities, and each carries a Kalman filter
        of its accelerations and biases. Exact where springs are linear, else to first order in the acceleration.

    Raises
    ------
    EstimatorError
        Settings out of range.
    """

    def __init__(
        self, robot: Robot, noise: Noise | None = None, *, accelerations: bool = False, **settings: Any
    ) -> None:
        self._marginalised = "accelerations" if accelerations else "biases"  # what settings are checked for
        super().__init__(robot, noise, **settings)


def _by_kind(outliers: Mapping[str, float | Mixture]) -> dict[str, float | tuple[float, float]]:
    for kind in outliers:
        if kind not in OUTLIERS:
            raise EstimatorError(f"outliers: {kind!r} is not one of {', '.join(map(repr, OUTLIERS))}")
    return {kind: (o.share, o.scale) if isinstance(o, Mixture) else float(o) for kind, o in outliers.items()}


def _by_joint(robot: Robot, limits: Mapping[str, tuple[float, float]]) -> list[tuple[float, float]]:
    for name in limits:
        if name not in robot.names:
            raise EstimatorError(f"limits: the robot has no joint {name!r}, only {', '.join(robot.names)}")
    return [limits.get(name, (-np.inf, np.inf)) for name in robot.names]


def _positions(robot: Robot, initial: npt.ArrayLike | None) -> list[float]:
    if initial is None:
        return []
    rows = np.atleast_2d(np.asarray(initial, float))
    if rows.ndim != 2 or rows.shape[1] != robot.n:
        raise EstimatorError(f"initial has shape {np.shape(initial)}, expected one row of {robot.n} a start")
    return list(rows.ravel())
