"""Arrays as they go to the core, and checks of their lengths and shapes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

FloatArray: TypeAlias = npt.NDArray[np.float64]
"""Float64, C order."""

Signal: TypeAlias = FloatArray | Sequence[float]
"""One sample of a signal, such as (n,)."""

Progress: TypeAlias = Callable[[int, int], None]
"""What a long computation calls: how much is done, and of how much."""
