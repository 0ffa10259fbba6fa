"""Checks of arguments: lengths, shapes, whole numbers and choices, each with a message that names the argument."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from .arrays import FloatArray
from .errors import EstimatorError


def one_of(name: str, value: object, allowed: Sequence[str]) -> None:
    """Check that an argument is one of a few words."""
    if value not in allowed:
        raise EstimatorError(f"{name} is {value!r}, expected {' or '.join(map(repr, allowed))}")


def start_of(start: str | Mapping[str, npt.ArrayLike], signals: Sequence[str], n: int) -> dict[str, FloatArray] | None:
    """Give the state that an observer starts from, each signal (n,); None of ``"auto"`` and ``"rest"``."""
    if isinstance(start, str):
        one_of("start", start, ("auto", "rest"))
        return None
    if set(start) != set(signals):
        raise EstimatorError(f"start has {', '.join(start) or 'nothing'}, expected {', '.join(signals)}")
    state = {name: sized(f"start: {name}", value, n) for name, value in start.items()}
    for name, values in state.items():
        if not np.isfinite(values).all():
            raise EstimatorError(f"start: {name} is {values}, expected finite numbers")
    return state


def whole(name: str, value: Any, least: int = 0) -> int:
    """Give a whole number of at least ``least``."""
    if not isinstance(value, int | np.integer) or isinstance(value, bool) or value < least:
        raise EstimatorError(f"{name} is {value!r}, expected a whole number of at least {least}")
    return int(value)


def numbers(name: str, value: npt.ArrayLike) -> FloatArray:
    """Return an array of float64; refuse complex numbers, text and dates, which a cast would change."""
    try:
        array = np.asarray(value)
        if array.dtype.kind not in "fiub":
            raise TypeError
        return array.astype(np.float64, copy=False)
    except (TypeError, ValueError):
        raise EstimatorError(f"{name}: expected an array of numbers") from None


def sized(name: str, signal: npt.ArrayLike | None, size: int) -> FloatArray:
    """Give a copy of a signal's ``size`` values at one sample; NaN where there is no signal."""
    if signal is None:
        return np.full(size, np.nan)
    array = np.array(numbers(name, signal))
    if array.shape != (size,):
        raise EstimatorError(f"{name} has shape {array.shape}, expected ({size},)")
    return array


def finite_or_missing(name: str, values: FloatArray) -> FloatArray:
    """Give readings back, none of which may be infinite; NaN is one that is missing."""
    if np.isinf(values).any():
        raise EstimatorError(f"{name} is {values}, expected finite numbers, or NaN where a reading is missing")
    return values


def positive(name: str, value: Any) -> float:
    """Give a finite number greater than 0."""
    if not isinstance(value, int | float | np.number) or not 0 < value < np.inf:
        raise EstimatorError(f"{name} is {value!r}, expected a finite number greater than 0")
    return float(value)


def time_step(dt: float) -> float:
    """Return a time step, which must be positive and finite."""
    if not 0 < dt < np.inf:
        raise EstimatorError(f"dt is {dt}, expected a positive, finite time in seconds")
    return dt


def per_joint(name: str, value: npt.ArrayLike, n: int) -> FloatArray:
    """Give one number for each of n joints, from one for all of them or one for each, (n,)."""
    array = np.atleast_1d(numbers(name, value))
    if array.ndim > 1 or array.size not in (1, n):
        count = f"{array.size} entries" if array.ndim == 1 else f"shape {array.shape}"
        raise EstimatorError(f"{name} has {count}, expected 1 or {n}")
    return np.array(np.broadcast_to(array, n))
