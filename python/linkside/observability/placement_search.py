"""Search for the set of accelerometers that sees link accelerations best."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from math import comb
from typing import Literal

import numpy as np

from linkside.arrays import FloatArray
from linkside.errors import EstimatorError
from linkside.robot import Robot
from linkside.robot.sensors import AccelerometerConfig

from .result import Observability

Criterion = Literal["condition", "covariance"]

NAMES: dict[Criterion, tuple[str, str]] = {
    "condition": ("worst condition number", ""),
    "covariance": ("expected standard deviation of link accelerations", " rad/s²"),
}
"""What a criterion is called, and its unit."""

EVERY_SET = 2000
"""Up to this many sets are searched exhaustively; beyond that, one set is improved sensor by sensor."""


class PlacementSearch:
    """Scores of sets; of each candidate the information matrix T_Aᵀ R⁻¹ T_A in each posture, (C, T, e, e)."""

    def __init__(
        self,
        robot: Robot,
        sensors: tuple[AccelerometerConfig, ...],
        q: FloatArray,
        share: float,
        criterion: Criterion,
        spares: int,
    ) -> None:
        if criterion not in NAMES:
            raise EstimatorError(f"criterion is {criterion!r}, expected one of {', '.join(NAMES)}")
        if not 0 <= spares < len(sensors):
            raise EstimatorError(f"spares is {spares}, expected 0 to {len(sensors) - 1}: fewer than candidates")
        self.robot, self.sensors, self.q, self.criterion = robot, sensors, q, criterion
        self.share, self.spares = share, spares
        rows = self._rows()
        self._refuse_unseen(rows)
        self.information = np.stack([np.einsum("tri,trj->tij", block, block) for block in rows])
        # Sets that see too little still compare: a trace of knowledge in all directions.
        self.trace = 1e-12 * np.trace(self.information.sum(axis=0), axis1=1, axis2=2).max() * np.eye(rows[0].shape[2])
        everything = mounted(robot, sensors)
        if not np.isfinite(Observability.of(everything, q).worst).any():
            raise EstimatorError(
                "all candidates together do not tell the elastic joints apart; add some on other links, or more axes"
            )

    def _rows(self) -> list[FloatArray]:
        """T_A over noise of each candidate, elastic joints alone, (T, axes, e)."""
        everything = mounted(self.robot, self.sensors)
        matrix = everything.acceleration_map(self.q, np.zeros_like(self.q))[0][:, :, self.robot.elastic]
        ends = np.cumsum([len(sensor.axes) for sensor in self.sensors])
        blocks = np.split(matrix, ends[:-1], axis=1)
        return [block / sensor.noise_std for block, sensor in zip(blocks, self.sensors, strict=True)]

    def _refuse_unseen(self, rows: list[FloatArray]) -> None:
        size = np.max([np.abs(block).max(axis=(0, 1)) for block in rows], axis=0)
        names = [name for name, elastic in zip(self.robot.names, self.robot.elastic, strict=True) if elastic]
        for name, seen in zip(names, size > 1e-9 * size.max(initial=0.0), strict=True):
            if not seen:
                links = ", ".join(carried(self.robot, name))
                raise EstimatorError(
                    f"no candidate sees joint '{name}'; add one on a link that it carries ({links}), off its axis"
                )

    @property
    def fewest(self) -> int:
        """Sensors whose axes are as many as elastic joints, and the spares."""
        most = max(len(sensor.axes) for sensor in self.sensors)
        return max(1, -(-int(self.robot.elastic.sum()) // most)) + self.spares

    def scores(self, sets: Sequence[tuple[int, ...]]) -> FloatArray:
        """Of several sets, to compare them: each without those of its sensors that it needs most."""
        return np.array([max(self._score(self._sum(left)) for left in self._after_losses(chosen)) for chosen in sets])

    def _after_losses(self, chosen: tuple[int, ...]) -> list[tuple[int, ...]]:
        """What may be left of a set when as many sensors as there are spares have failed."""
        return list(combinations(chosen, len(chosen) - self.spares))

    def _sum(self, chosen: tuple[int, ...]) -> FloatArray:
        return np.asarray(self.information[list(chosen)].sum(axis=0) + self.trace)

    def _volume(self, chosen: tuple[int, ...]) -> float:
        """What a set tells even if it is too small to have a score: its log-determinant, over all postures."""
        return float(np.linalg.slogdet(self._sum(chosen))[1].mean())

    def _score(self, information: FloatArray) -> float:
        values = np.linalg.eigvalsh(information)
        if self.criterion == "condition":
            return float(np.quantile(np.sqrt(values[:, -1] / values[:, 0]), self.share, method="lower"))
        variance = np.sort(np.sum(1 / values, axis=1))
        return float(np.sqrt(variance[: max(1, int(self.share * len(variance)))].mean()))

    def best(self, count: int) -> tuple[int, ...]:
        """The best set of ``count`` candidates."""
        total = len(self.sensors)
        if not self.spares < count <= total:
            least = f"{self.spares + 1}, one more than spares," if self.spares else "1"
            raise EstimatorError(f"count is {count}, expected {least} to {total}, the number of candidates")
        if comb(total, count) <= EVERY_SET:
            sets = list(combinations(range(total), count))
            return sets[int(np.argmin(self.scores(sets)))]
        return self._exchange(count)

    def _exchange(self, count: int) -> tuple[int, ...]:
        """Add the sensor that tells most, one after the other; then exchange single ones as long as that helps."""
        chosen: tuple[int, ...] = ()
        while len(chosen) < count:
            chosen = max(((*chosen, other) for other in self._others(chosen)), key=self._volume)
        score = float(self.scores([chosen])[0])
        while True:
            swaps = [(*chosen[:i], *chosen[i + 1 :], o) for i in range(count) for o in self._others(chosen)]
            other, better = self._improved(swaps)
            if not better < score:
                return tuple(sorted(chosen))
            chosen, score = other, better

    def _others(self, chosen: tuple[int, ...]) -> list[int]:
        return [index for index in range(len(self.sensors)) if index not in chosen]

    def _improved(self, sets: Sequence[tuple[int, ...]]) -> tuple[tuple[int, ...], float]:
        scores = self.scores(sets)
        return sets[int(np.argmin(scores))], float(scores.min())

    def smallest(self, limit: float, most: int | None) -> tuple[int, ...]:
        """The smallest set whose score is at most ``limit``."""
        most = min(most or 8, len(self.sensors))
        for count in range(self.spares + 1, most + 1):
            best = self.best(count)
            score = self.score(best)
            if score <= limit:
                return best
        raise EstimatorError(
            f"no set of up to {most} candidates has a {NAMES[self.criterion][0]} of {limit:g} or less; the best of "
            f"{most} has {number(score)}: allow more sensors, or offer better places"
        )

    def score(self, chosen: tuple[int, ...]) -> float:
        """Of one set without those of its sensors that it needs most, by singular values."""
        return max(self.whole(left) for left in self._after_losses(chosen))

    def whole(self, chosen: tuple[int, ...]) -> float:
        """Of one set, by singular values."""
        return self.of(mounted(self.robot, tuple(self.sensors[i] for i in chosen)))

    def of(self, robot: Robot) -> float:
        """Of a robot's own sensors."""
        observability = Observability.of(robot, self.q)
        if self.criterion == "condition":
            return float(np.quantile(observability.condition, self.share, method="lower"))
        variance = np.sort(np.sum(observability.joints**2, axis=1))
        return float(np.sqrt(variance[: max(1, int(self.share * len(variance)))].mean()))


def mounted(robot: Robot, sensors: tuple[AccelerometerConfig, ...]) -> Robot:
    """Give the robot with these accelerometers in place of its own."""
    return Robot(robot.config.model_copy(update={"accelerometers": sensors}), robot.tree)


def carried(robot: Robot, joint: str) -> list[str]:
    """Give the links that a joint moves."""
    tree = robot.tree
    return [name for name, link in tree.moving_links.items() if tree.index[joint] in tree.carriers(link.joint)]


def number(value: float) -> str:
    """Write a score."""
    return "sees too little" if np.isinf(value) else f"{value:.3g}"
