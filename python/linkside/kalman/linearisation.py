"""How a filter takes what is not linear: by derivatives, or by values at a few points."""

from __future__ import annotations

from typing import Literal, TypeAlias

from linkside.arguments import one_of
from linkside.errors import EstimatorError

Linearisation: TypeAlias = Literal["derivatives", "unscented", "cubature"]
"""At the estimate; or by sigma points as far from it as it is uncertain, with their centre or without."""


def checked(linearisation: Linearisation, way: str) -> Linearisation:
    """Check what a user says, for a filter or a smoother."""
    one_of("linearisation", linearisation, ("derivatives", "unscented", "cubature"))
    if linearisation != "derivatives" and way == "iterate":
        raise EstimatorError(
            f"linearisation is {linearisation!r}: the most probable motion goes by derivatives, expected 'derivatives'"
        )
    return linearisation
