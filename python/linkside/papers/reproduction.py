"""What the repetition of a paper's experiment gives: numbers beside the published ones, tables and figures."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

from matplotlib.figure import Figure
from rich.console import RenderableType

from linkside.text import Titled

Agreement: TypeAlias = Literal["same", "different", "not stated"]


@dataclass(frozen=True)
class PaperComparison:
    """One published number or conclusion, and what the repetition found.

    Attributes
    ----------
    quantity : str
        What is compared, with its unit.
    paper : float or str
        The published number; where there is none, what the paper says in words.
    here : float
        The number found here.
    conclusion : {"same", "different", "not stated"}
        Whether the paper's conclusion holds here; ``"not stated"`` if the paper draws none.
    """

    quantity: str
    paper: float | str
    here: float
    conclusion: Agreement


@dataclass(frozen=True, eq=False)
class Reproduction:
    """The repetition of a paper's experiment.

    Attributes
    ----------
    title : str
        The experiment.
    comparisons : tuple of PaperComparison
        Published numbers and ours.
    details : tuple of Titled
        Further tables of what was found.
    figures : dict of str to matplotlib.figure.Figure
        Figures, by the names of their files.
    """

    title: str
    comparisons: tuple[PaperComparison, ...]
    details: tuple[Titled, ...] = ()
    figures: dict[str, Figure] = field(default_factory=dict)

    def here(self, quantity: str) -> float:
        """Return the number that was found for a quantity; `KeyError` if it was not compared."""
        return {comparison.quantity: comparison.here for comparison in self.comparisons}[quantity]

    def report(self) -> Iterator[RenderableType]:
        """Yield the table of comparisons, then the details."""
        table = Titled(self.title, ("quantity", "paper", "here", "conclusion"))
        for row in self.comparisons:
            published = row.paper if isinstance(row.paper, str) else f"{row.paper:.4g}"
            table.add_row(row.quantity, published, f"{row.here:.4g}", row.conclusion)
        yield table
        yield from self.details


def verdict(holds: bool) -> Agreement:
    """Whether a conclusion of the paper holds here."""
    return "same" if holds else "different"
