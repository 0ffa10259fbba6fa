"""Checks of arguments: lengths, shapes, whole numbers and choices, each with a message that names the argument."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from .arrays import FloatArray
from .errors import EstimatorError


def one_of(name: str, value: object, allowed: Sequence[str]) -> None:
    """Insist on one of a few words."""
    if value not in allowed:
        raise EstimatorError(f"{name} is {value!r}, expected {' or '.join(map(repr, allowed))}")


def whole(name: str, value: Any, least: int = 0) -> int:
    """Give a whole number of at least ``least``."""
    if not isinstance(value, int | np.integer) or isinstance(value, bool) or value < least:
        raise EstimatorError(f"{name} is {value!r}, expected a whole number of at least {least}")
    return int(value)


def numbers(name: str, value: npt.ArrayLike) -> FloatArray:
    """Give an array of float64; complex numbers, text and dates would be cast at a loss, and are refused."""
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


def per_joint(name: str, value: npt.ArrayLike, n: int) -> FloatArray:
    """Give one number for each of n joints, from one for all of them or one for each, (n,)."""
    array = np.atleast_1d(numbers(name, value))
    if array.ndim > 1 or array.size not in (1, n):
        count = f"{array.size} entries" if array.ndim == 1 else f"shape {array.shape}"
        raise EstimatorError(f"{name} has {count}, expected 1 or {n}")
    return np.array(np.broadcast_to(array, n))
