"""The posterior of a robot's parameters by the links' response to their motors: output error, stage by stage.

Motors are where they were measured; nothing else moves the links. What sensors on them should then read is compared
with what they read, so that a wrong spring cannot improve a density of the motors' positions.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, fields, replace
from functools import cached_property
from itertools import pairwise
from operator import methodcaller
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from linkside._core import Response
from linkside.arrays import FloatArray
from linkside.kalman.late_sensors import sensors
from linkside.mapping import Map, here
from linkside.robot import Robot
from linkside.robot.sensors import Lateness

from .band import Band
from .lag import Lag
from .parameters import NOISE, OF_LINK_ENCODERS, CoreName, Parameter, catalogue
from .prepared import ZEROS, Prepared, width
from .problem import HUBER, STATED, Evidence, bare
from .products import products
from .restart import restart, uncertain_start
from .spread import spread
from .whitening import Whitening

LEAST_ZERO = 1e-3
"""Uncertainty of a zero, in the signal's unit, beside the largest reading."""

Found = TypeVar("Found")

OF_TIME = ("time_constant", "delay", *OF_LINK_ENCODERS, "torque_delay")
LATENESS = {"q": OF_LINK_ENCODERS, "tau": ("", "torque_delay")}
"""Kinds that are time constant and delay of all sensors of a signal."""

LEAST_NOISE = 1e-9


@dataclass(frozen=True, eq=False)
class _Left:
    """What a prediction leaves of readings, each (R, m): residuals, Huber's weights, log-densities."""

    clean: FloatArray
    weight: FloatArray
    densities: FloatArray


class ResponseProblem:
    """Recordings of one robot, the parameters that are free, and the band that is looked at.

    Parameters
    ----------
    robot
        The robot as robot.yaml has it.
    recordings
        Its recordings, by `recordings`.
    free
        The free parameters.
    held
        Further parameters and the z that each is held at; all others are as in robot.yaml.
    corner
        Frequencies above it are left out [Hz].
    size
        Standard deviations of residuals in that band, (m,); as small as can be where they are not known.
    base
        `robot` without what `bare` takes off, where it is known.
    white
        What makes residuals white where all frequencies are looked at, if they are not taken as they are.
    run
        Evaluates the recordings, each by itself.
    """

    def __init__(
        self,
        robot: Robot,
        recordings: Sequence[Prepared],
        free: Sequence[Parameter],
        held: Sequence[tuple[Parameter, float]] = (),
        corner: float = np.inf,
        size: FloatArray | None = None,
        base: Robot | None = None,
        white: Whitening | None = None,
        run: Map = here,
    ) -> None:
        self.robot, self.recordings, self.white, self.run = robot, list(recordings), white, run
        self.logs = [recording.log for recording in recordings]
        self.free, self.held, self.corner = tuple(free), tuple(held), corner
        self.kinds = recordings[0].kinds
        self._seen = [recording.coarser(corner) for recording in recordings]
        bands = [Band.below(corner, seen.period, len(seen.readings)) for seen in self._seen]
        self._bands: list[Band] | list[Whitening] = bands if white is None else [white] * len(bands)
        self._narrowed = [float(np.linalg.norm(band.weights)) for band in bands]
        self.base = base or bare(robot)
        self.size = self._least() if size is None else size
        self._zeros = [c for c, kind in enumerate(self._kind_of_channels()) if kind in ZEROS]
        largest = [float(np.abs(recordings[0].readings[:, c]).max()) for c in self._zeros]
        self._start = np.concatenate([uncertain_start(robot, self.recordings), np.array(largest) + LEAST_ZERO])

    def _like(self, **changes: Any) -> ResponseProblem:
        names = ("robot", "recordings", "free", "held", "corner", "size", "base", "white", "run")
        return ResponseProblem(**{name: getattr(self, name) for name in names} | changes)

    def restricted(self, free: Sequence[Parameter]) -> ResponseProblem:
        """Give the same problem with other parameters free."""
        return self._like(free=free, held=())

    def holding(self, at: Mapping[str, float], free: Sequence[Parameter]) -> ResponseProblem:
        """Give the same problem with only some of its parameters free, the others held at ``at``, their z by name."""
        return self._like(free=free, held=[(p, at.get(p.name, 0.0)) for p in self.free if p not in free])

    def without(self, stretches: Sequence[Sequence[slice]]) -> ResponseProblem:
        """Give the same problem where stretches of each recording were not read, but for the motors' positions."""
        pairs = zip(self.recordings, stretches, strict=True)
        return self._like(recordings=[recording.without(parts) for recording, parts in pairs])

    def sensors(self) -> dict[str, list[int]]:
        """Columns of each sensor that reads anything: an accelerometer's axes together, other channels one by one."""
        read = np.any([~recording.missing.all(axis=0) for recording in self.recordings], axis=0)
        found = {name: [c] for c, name in enumerate(self.channels) if read[c]}
        if "acceleration" in self.kinds:
            for sensor, columns in zip(self.robot.accelerometers, self._columns(), strict=True):
                axes = range(columns.start, columns.stop)
                found = {name: own for name, own in found.items() if own[0] not in axes} | {sensor.name: [*axes]}
        return found

    def reading(self, columns: Sequence[int]) -> ResponseProblem:
        """Give the same problem where only some channels were read, beside the motors' positions."""
        return self._like(recordings=[recording.reading(columns) for recording in self.recordings])

    def smoothed(self, wider: float) -> ResponseProblem:
        """Give the same problem with motors' positions smoothed less, by this factor on the corner frequency."""
        return self._like(recordings=list(self.run(methodcaller("smoothed", self.robot, wider), self.recordings)))

    def measured_again(self, z: FloatArray, rng: np.random.Generator) -> ResponseProblem:
        """Give the same problem with encoders that read the motors' positions again.

        All other sensors read what they should at ``z``, so that the gradient there is due to the encoders alone.
        """
        pairs = zip(self.recordings, self.predicted(z), strict=True)
        return self._like(recordings=[recording.measured_again(self.robot, x, rng) for recording, x in pairs])

    def alone(self, index: int, z: FloatArray) -> ResponseProblem:
        """Give the same problem on one of its recordings."""
        return self._like(recordings=[self.recordings[index]]).settled(z)

    def settled(self, z: FloatArray, corner: float | None = None) -> ResponseProblem:
        """Give the same problem with residuals as large, and the links' start, as the residuals at ``z`` have them.

        ``corner`` is of another band.
        """
        there = self._like(corner=self.corner if corner is None else corner, size=None, white=None)
        seen = there._each(methodcaller("_residuals", 0, z, sloped=False))
        size = spread([residual * there.size for residual, _ in seen], there._least())
        started, left = [], []
        for recording, (residual, start) in zip(self.recordings, seen, strict=True):
            by, e = start * (there.size / size)[:, None], residual * (there.size / size)
            shift = restart(e, by, self._start)
            started.append(replace(recording, offset=recording.offset + shift))
            left.append((e - by @ shift) * size)
        if np.isfinite(there.corner):
            return there._like(recordings=started, size=spread(left, there._least()))
        white = Whitening.of(left, self._slow())
        told = [np.where(white.told(np.isnan(e)), white(np.nan_to_num(e)), np.nan) for e in left]
        return there._like(recordings=started, size=spread(told, there._least()), white=white)

    def _slow(self) -> dict[int, FloatArray]:
        """Weights of the filters that motor torques go through: above, what encoders read wrong hides them."""
        first, last = self.recordings[0], self.recordings
        count = min(len(recording.readings) for recording in last)
        corners = np.max([recording.limits for recording in last], axis=0) if first.limits else ()
        at = len(self.channels) - len(corners)
        bands = [Band.below(corner, first.period, count) for corner in corners]
        return {at + j: band.weights for j, band in enumerate(bands)}

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the channels, in the order of `Evidence.innovations`."""
        return tuple(column for kind in self.kinds for column in self.logs[0].columns(kind))

    def values(self, z: FloatArray) -> list[float]:
        """Physical values."""
        return [p.value(x) for p, x in zip(self.free, z, strict=True)]

    def evidence(self, z: FloatArray, detail: bool = False) -> Evidence:
        """Evaluate at one point; raises NumericalError where links fly away."""
        p = len(self.free)
        total = Evidence(0.0, np.zeros(p), np.zeros((p, p)), 0, [], [], [])
        for found in self._each(methodcaller("_of_log", z, detail)):
            total = _sum(total, found)
        return total

    def log_likelihood(self, z: FloatArray) -> float:
        """Log-likelihood alone."""
        return float(sum(self._each(methodcaller("_density", z))))

    def predicted(self, z: FloatArray) -> list[FloatArray]:
        """What sensors should read in each recording, (T, m)."""
        return [self._prediction(i, z, sloped=False)[0] for i in range(len(self.logs))]

    def paths(self, z: FloatArray) -> list[tuple[FloatArray, FloatArray]]:
        """Each recording's link positions (T, n), and their derivatives in z (T, n, p)."""
        return [self._path(recording, z) for recording in self.recordings]

    def _path(self, recording: Prepared, z: FloatArray) -> tuple[FloatArray, FloatArray]:
        moving = self._moving()
        values = self.values(z)
        core = Response(self.base.core, recording.motors, kinds=("q",), fixed=self._fixed())
        offset = recording.offset[: 2 * self.robot.n].tolist()
        q, by = core.evaluate([self.free[k].core for k in moving], [values[k] for k in moving], offset)
        slopes = np.zeros((*q.shape, len(self.free)))
        slopes[:, :, moving] = by[:, :, : len(moving)] * [self.free[k].slope(float(z[k])) for k in moving]
        return q, slopes

    def _moving(self) -> list[int]:
        """Parameters that predictions depend on before sensors' filters."""
        return [k for k, p in enumerate(self.free) if p.kind not in (*NOISE, *OF_TIME)]

    def _each(self, function: Callable[[ResponseProblem], Found]) -> list[Found]:
        """What a function gives for each recording by itself, all else as it is."""
        return [function(self)] if len(self.logs) == 1 else list(self.run(function, self._singles))

    @cached_property
    def _singles(self) -> list[ResponseProblem]:
        """The same problem on each recording as it is seen in the band."""
        singles = [copy(self) for _ in self.logs]
        for i, single in enumerate(singles):
            single.recordings = single._seen = [self._seen[i]]
            single.logs, single._bands = [self.logs[i]], self._bands[i : i + 1]
        return singles

    def __getstate__(self) -> dict[str, Any]:
        """What a copy elsewhere needs; it evaluates its recordings there."""
        return {name: own for name, own in vars(self).items() if name not in ("_cores", "_singles")} | {"run": here}

    @cached_property
    def _cores(self) -> list[Response]:
        """What predicts readings of each recording."""
        fixed = self._fixed()
        return [Response(self.base.core, seen.motors, kinds=self.kinds, fixed=fixed) for seen in self._seen]

    def _density(self, z: FloatArray) -> float:
        """Log-likelihood of the only recording."""
        return float(self._clean(*self._residuals(0, z, sloped=False)).densities.sum())

    def _of_log(self, z: FloatArray, detail: bool) -> Evidence:
        """Evidence of the only recording."""
        residual, by = self._residuals(0, z)
        p, total = len(self.free), by.shape[2]
        given = np.isfinite(residual)
        left = self._clean(residual, by[:, :, p:])
        weighted = np.concatenate([by, np.where(given, left.clean, 0.0)[:, :, None]], axis=2)
        weighted *= np.sqrt(left.weight)[:, :, None]
        gram = products(weighted.reshape(given.size, total + 1))
        # What another start of the links would explain carries no information: it is projected out (Golub and Pereyra
        # 1973).
        start = slice(p, total)
        explained = np.linalg.solve(gram[start, start] + np.diag(1 / self._start**2), gram[start])
        told = gram[:p] - gram[:p, start] @ explained
        information = told[:, :p] + np.diag([self._of_noise(p, given) for p in self.free])
        out = Evidence(float(left.densities.sum()), told[:, total], information, int(given.sum()), [], [], [])
        if not detail:
            return out
        count = len(self._seen[0].readings)
        rows = self._bands[0].rows(count)
        pull = (weighted[:, :, :p] - weighted[:, :, start] @ explained[:, :p]) * weighted[:, :, total:]
        return replace(
            out,
            densities=[_placed(left.densities.sum(axis=1), rows, count, 0.0)],
            scores=[_placed(pull.sum(axis=1), rows, count, 0.0)],
            innovations=[_placed(left.clean, rows, count, np.nan)],
        )

    def _clean(self, residual: FloatArray, start: FloatArray) -> _Left:
        """What is left of residuals (R, m) with the best start, whose slopes are ``start`` (R, m, s)."""
        given = np.isfinite(residual)
        clean = residual - np.where(given, start @ restart(residual, start, self._start), 0.0)
        size = np.where(given, np.abs(clean), 0.0)
        outlying = size > HUBER
        loss = np.where(outlying, HUBER * (2 * size - HUBER), size**2)
        densities = np.where(given, -0.5 * (loss + np.log(2 * np.pi * self.size**2)), 0.0)
        return _Left(clean, np.where(outlying, HUBER / np.maximum(size, HUBER), given), densities)

    def _of_noise(self, p: Parameter, given: npt.NDArray[np.bool_]) -> float:
        """Information on a sensor's noise, which is not sought but seen in what is left."""
        if p.kind != "sensor_noise" or "acceleration" not in self.kinds:
            return 0.0
        return 2 * p.tolerance**2 * float(given[:, self._columns()[p.core[1]]].sum())

    def noise_of(self, p: Parameter) -> float:
        """Give the factor on the noise of an accelerometer, whose parameter is ``p``, that residuals show."""
        size = float(np.sqrt(np.mean(self.size[self._columns()[p.core[1]]] ** 2)))
        return float(np.clip(size / self.robot.accelerometers[p.core[1]].noise_std, p.low, p.high))

    def _columns(self) -> list[slice]:
        """Columns of each accelerometer."""
        ends = np.cumsum([0, *(len(sensor.axes) for sensor in self.robot.accelerometers)])
        offset = next((i for i, name in enumerate(self.channels) if name in self.robot.acceleration_channels), 0)
        return [slice(offset + a, offset + b) for a, b in pairwise(ends.tolist())]

    def _residuals(self, i: int, z: FloatArray, sloped: bool = True) -> tuple[FloatArray, FloatArray]:
        """Residuals (R, m) of a log over their spread, NaN where missing; slopes of predictions in z and the start.

        Those in z are left out unless ``sloped``.
        """
        recording, band = self._seen[i], self._bands[i]
        prediction, slopes = self._prediction(i, z, sloped)
        residual = np.where(band.told(recording.missing), band(recording.readings - prediction), np.nan)
        slopes = band(slopes)
        slopes /= self.size[:, None]
        slopes[~np.isfinite(residual)] = 0.0
        return residual / self.size, slopes

    def _prediction(self, i: int, z: FloatArray, sloped: bool) -> tuple[FloatArray, FloatArray]:
        """What sensors should read (T, m), and its slopes in z and the start."""
        recording, moving = self._seen[i], self._moving()
        names, values = [self.free[k].core for k in moving], self.values(z)
        at = [values[k] for k in moving]
        offset = recording.offset[: 2 * self.robot.n].tolist()
        if sloped:
            prediction, by = self._cores[i].evaluate(names, at, offset)
        else:
            fixed = [*self._fixed(), *zip(names, at, strict=True)]
            core = Response(self.base.core, recording.motors, kinds=self.kinds, fixed=fixed)
            (prediction, by), moving = core.evaluate([], [], offset), []
        p, (count, m, width) = len(self.free) if sloped else 0, by.shape
        at_start = p + width - len(moving)
        slopes = np.zeros((count, m, at_start + len(self._zeros)))
        slopes[:, :, moving] = by[:, :, : len(moving)] * [self.free[k].slope(float(z[k])) for k in moving]
        slopes[:, :, p:at_start] = by[:, :, len(moving) :]
        self._lag(z, recording.period, prediction, slopes, sloped)
        prediction[:, self._zeros] += recording.offset[2 * self.robot.n :]
        slopes[:, self._zeros, range(at_start, slopes.shape[2])] = 1.0
        return prediction, slopes

    def _lag(self, z: FloatArray, period: float, prediction: FloatArray, slopes: FloatArray, sloped: bool) -> None:
        """Let the sensors' own filters and delays act, in place."""
        at = {p.core: (k, p, float(x)) for k, (p, x) in enumerate(zip(self.free, z, strict=True))}
        held = {p.core: p.value(x) for p, x in self.held}
        for columns, of, stated in self._late():
            free = [at.get(core) for core in of]
            values = [
                f[1].value(f[2]) if f else held.get(core, value)
                for f, core, value in zip(free, of, stated, strict=True)
            ]
            if not (any(values) or any(free)):
                continue
            lag = Lag(*(value / period for value in values))
            by = lag.slopes(prediction[:, columns]) if sloped else ()
            prediction[:, columns] = lag(prediction[:, columns])
            slopes[:, columns] = lag(slopes[:, columns])
            for f, slope in zip(free, by, strict=sloped):
                if f:
                    slopes[:, columns, f[0]] = slope * (f[1].slope(f[2]) / period)

    def _late(self) -> list[tuple[slice, list[CoreName], list[float]]]:
        """Columns with one filter and delay: what these are called, and what robot.yaml says of them [s]."""
        found: list[tuple[slice, list[CoreName], list[float]]] = []
        at = 0
        for kind in self.kinds:
            of_all = sensors(self.robot, kind)
            if kind == "acceleration":
                for i, (own, columns) in enumerate(zip(self.robot.accelerometers, self._columns(), strict=True)):
                    found.append((columns, [("time_constant", i, 0), ("delay", i, 0)], _times(own)))
            else:
                of: list[CoreName] = [(name, 0, 0) for name in LATENESS.get(kind, ("", ""))]
                found += [(slice(at + i, at + i + 1), of, _times(sensor)) for i, sensor in enumerate(of_all)]
            at += len(of_all)
        return found

    def _fixed(self) -> list[tuple[tuple[str, int, int], float]]:
        estimated = {p.name for p in (*self.free, *(p for p, _ in self.held))}
        stated = [p for p in catalogue(self.robot, False) if p.kind in STATED and p.name not in estimated]
        held = [(p.core, p.value(z)) for p, z in self.held if p.kind not in (*NOISE, *OF_TIME)]
        return held + [(p.core, p.start) for p in stated if p.kind not in OF_TIME]

    def _kind_of_channels(self) -> list[str]:
        return [kind for kind in self.kinds for _ in range(width(self.robot, kind))]

    def _least(self) -> FloatArray:
        """A tenth of what the noise of sensors can be."""
        told = {
            "acceleration": [0.1 * s.noise_std for s in self.robot.accelerometers for _ in s.axes],
            "tau": [0.1 * self.robot.config.torque.noise_std] * self.robot.n,
        }
        parts = [told.get(kind, [LEAST_NOISE] * width(self.robot, kind)) for kind in self.kinds]
        pairs = zip(self._narrowed, self._seen, strict=True)
        shrunk = min(narrowed / np.sqrt(seen.every) for narrowed, seen in pairs)
        return np.array([x * shrunk for part in parts for x in part], dtype=np.float64)


def _times(sensor: Lateness | None) -> list[float]:
    """Time constant and delay that robot.yaml gives a sensor [s]."""
    if sensor is None:
        return [0.0, 0.0]
    return [1 / (2 * np.pi * sensor.corner_frequency) if sensor.corner_frequency else 0.0, sensor.delay]


def _placed(values: FloatArray, rows: npt.NDArray[np.int64], count: int, empty: float) -> FloatArray:
    out = np.full((count, *values.shape[1:]), empty)
    out[rows] = values
    return out


def _sum(a: Evidence, b: Evidence) -> Evidence:
    return Evidence(*(getattr(a, f.name) + getattr(b, f.name) for f in fields(Evidence)))
