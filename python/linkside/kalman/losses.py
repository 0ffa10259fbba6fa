"""What an error of a sensor's readings costs: its square, or less where it is an outlier."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, TypeAlias

from linkside.arguments import one_of
from linkside.channels import CHANNELS
from linkside.errors import EstimatorError

Loss: TypeAlias = Literal["squares", "huber", "student-t"]
"""Half an error's square in standard deviations; Huber's, absolute beyond 1.345; Student's t, 4 degrees of freedom."""

Losses: TypeAlias = Loss | Mapping[str, Loss]
"""One for all sensors, or by kind, the others being ``"squares"``."""


def by_kind(loss: Losses) -> dict[str, Loss]:
    """Check what a user says, and give the loss of each kind of channel."""
    if isinstance(loss, str):
        one_of("loss", loss, ("squares", "huber", "student-t"))
        return dict.fromkeys(CHANNELS, loss)
    unknown = sorted(set(loss) - set(CHANNELS))
    if unknown:
        raise EstimatorError(f"loss: {unknown[0]!r} is not one of {', '.join(map(repr, CHANNELS))}")
    for kind, own in loss.items():
        one_of(f"loss of {kind}", own, ("squares", "huber", "student-t"))
    return {kind: loss.get(kind, "squares") for kind in CHANNELS}
