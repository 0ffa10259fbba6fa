"""What an encoder reads wrong: its zero, its scale, an axis beside its centre, the lines of its disk."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import model_validator

from linkside.arrays import FloatArray
from linkside.files.yaml_source import refusal

from .section import Section
from .values import NonNegative, Number, Positive

STEEPEST = 0.2
"""A reading's rate is within this of that of the angle: each reading then has one angle."""


class EncoderHarmonic(Section):
    """A part of a reading that comes again `order` times a turn: 1 of an axis beside the centre, else of lines."""

    order: Positive  # cycles a turn
    amplitude: NonNegative  # rad, as seen behind the gear
    phase: Number | None = None  # rad; not given: another one in each recording
    of: Literal["motor", "output"] = "motor"  # what turns: the motor's shaft, or the gear's output


class EncoderError(Section):
    """A reading is scale·angle + zero + Σ amplitude·sin(order·turned + phase), all as seen behind the gear."""

    zero: Number = 0.0  # rad
    scale: Positive = 1.0
    harmonics: tuple[EncoderHarmonic, ...] = ()

    @model_validator(mode="after")
    def _rising(self) -> EncoderError:
        if not 0.5 < self.scale < 2:
            raise refusal(
                f"expected 0.5 to 2, got {self.scale:g}: other units are `units`, other gears gear_ratio", "scale"
            )
        return self

    def known(self, turns: float) -> list[tuple[float, float, float]]:
        """Amplitude [rad], cycles a turn of the output and phase [rad] of those whose phase is known."""
        return [
            (one.amplitude, one.order * self._turns(one, turns), one.phase)
            for one in self.harmonics
            if one.phase is not None and one.amplitude
        ]

    def unknown(self, turns: float) -> list[tuple[float, float]]:
        """Amplitude [rad] and cycles a turn of the output of the others."""
        return [
            (one.amplitude, one.order * self._turns(one, turns))
            for one in self.harmonics
            if one.phase is None and one.amplitude
        ]

    def steepness(self, turns: float) -> float:
        """By how much harmonics change a reading's rate at most."""
        return sum(abs(one.amplitude * one.order * self._turns(one, turns)) for one in self.harmonics)

    @staticmethod
    def _turns(one: EncoderHarmonic, turns: float) -> float:
        return turns if one.of == "motor" else 1.0


@dataclass(frozen=True)
class EncoderReading:
    """How an encoder's readings follow from angles.

    Attributes
    ----------
    scale, zero : float
        Of the straight part; zero [rad].
    harmonics : sequence of (float, float, float)
        Amplitude [rad], cycles a turn and phase [rad] of each.
    """

    scale: float
    zero: float
    harmonics: Sequence[tuple[float, float, float]]

    def of(self, angle: FloatArray) -> FloatArray:
        """EncoderReading of angles [rad]."""
        found = self.scale * angle + self.zero
        for amplitude, cycles, phase in self.harmonics:
            found = found + amplitude * np.sin(cycles * angle + phase)
        return np.asarray(found)

    def rate(self, angle: FloatArray) -> FloatArray:
        """How fast readings change there, for one of the angle's."""
        found = np.full_like(angle, self.scale)
        for amplitude, cycles, phase in self.harmonics:
            found += amplitude * cycles * np.cos(cycles * angle + phase)
        return found

    def angle(self, reading: FloatArray) -> FloatArray:
        """Angles of readings [rad], by Newton's method; missing ones stay missing."""
        found = (reading - self.zero) / self.scale
        for _ in range(30 if self.harmonics else 0):
            step = (self.of(found) - reading) / self.rate(found)
            found = found - step
            if not np.any(np.abs(step) > 1e-15 * (1 + np.abs(found))):
                break
        return found


def readings(error: EncoderError, turns: float) -> EncoderReading | None:
    """What is known of an encoder's error, of a motor that turns ``turns`` times as fast; None if nothing is wrong."""
    if (found := EncoderReading(error.scale, error.zero, error.known(turns))) == EncoderReading(1.0, 0.0, []):
        return None
    return found
