"""A finding of a check about a recording."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Verdict = Literal["refused", "suspicious", "mended"]


@dataclass(frozen=True)
class Finding:
    """Something in a column of a recording that is impossible, unlikely, or was corrected.

    Attributes
    ----------
    kind : str
        The check that found it: ``"wrap"``, ``"degrees"``, ``"milliseconds"`` and so on.
    verdict : str
        ``"refused"``: no estimate from such a recording can be right; ``"suspicious"``: may be intended; ``"mended"``:
        a certain mistake, corrected.
    column : str
        The column of the recording.
    what : str
        What was found, in words.
    remedy : str
        What to do about it.
    row : int, optional
        The first row where it shows.
    time : float, optional
        ``t`` of that row [s].
    size : float, optional
        How large it is, in the column's unit.
    count : int
        In how many places it shows.
    """

    kind: str
    verdict: Verdict
    column: str
    what: str
    remedy: str
    row: int | None = None
    time: float | None = None
    size: float | None = None
    count: int = 1

    def __str__(self) -> str:
        """One line: column, row, what is wrong, and the remedy."""
        at = "" if self.row is None else f" at row {self.row} (t = {self.time:.9g})"
        more = f" and {self.count - 1} more times" if self.count > 1 else ""
        return f"column {self.column!r} {self.what}{at}{more}; {self.remedy}"
