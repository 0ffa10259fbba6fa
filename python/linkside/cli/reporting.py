"""Reports of estimated logs: in words, as lines of JSON, or none."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Literal, TypeAlias

import click

from linkside.fleet import Outcome
from linkside.robot import Robot
from linkside.text import Titled

from .error_tables import error_tables
from .failures import complain, in_words
from .terminal import show

Manner: TypeAlias = Literal["words", "json", "quiet"]


def tell(outcome: Outcome, robot: Robot, manner: Manner) -> None:
    """Report one log; errors always go to standard error."""
    if manner == "json":
        click.echo(json.dumps(_record(outcome), ensure_ascii=False))
    if outcome.error is not None:
        complain(in_words(outcome.error))
    elif manner == "words":
        _in_words(outcome, robot)


def summary(outcomes: Sequence[Outcome]) -> None:
    """Show a table of all logs, the worst first."""
    show([all_logs(outcomes)])


def all_logs(outcomes: Sequence[Outcome]) -> Titled:
    """A table of all logs, the worst first."""
    heads = ("log", "rows", "good", "NIS per reading", "verdict")
    table = Titled("all logs, the worst first", heads)
    for outcome in sorted(outcomes, key=_badness, reverse=True):
        tally = outcome.tally
        good = f"{100 * tally.status['good'] / tally.rows:.1f} %" if tally.rows else "–"
        nis = f"{tally.nis / tally.used:.2f}" if tally.used else "–"
        table.add_row(outcome.job.log, str(tally.rows or "–"), good, nis, _verdict(outcome))
    return table


def _in_words(outcome: Outcome, robot: Robot) -> None:
    show(error_tables(outcome, robot))
    if outcome.kept:
        click.echo(f"{outcome.job.output}: up to date")
        return
    click.echo(f"{outcome.job.output}: {outcome.tally}")
    for words in outcome.conversions:
        click.echo(f"{outcome.job.log}: converted: {words}")
    for finding in outcome.tally.findings:
        click.echo(f"{outcome.job.log}: {finding}")


def _verdict(outcome: Outcome) -> str:
    if outcome.error is not None:
        return "not estimated"
    if outcome.kept:
        return "up to date" if outcome.believable else "up to date, contradicted"
    if outcome.tally.findings:
        count = len(outcome.tally.findings)
        return f"{count} contradiction{'s' if count > 1 else ''}"
    return "believable" if outcome.believable else "NIS outside its bounds"


def _badness(outcome: Outcome) -> tuple[bool, bool, float]:
    tally = outcome.tally
    odd = 1 - tally.status["good"] / tally.rows if tally.rows else 0.0
    return outcome.error is not None, not outcome.believable, odd


def _record(outcome: Outcome) -> dict[str, object]:
    tally = outcome.tally
    return {
        "log": outcome.job.log,
        "output": str(outcome.job.output),
        "error": None if outcome.error is None else in_words(outcome.error),
        "up_to_date": outcome.kept,
        "converted": list(outcome.conversions),
        "rows": tally.rows,
        "motion": tally.motion,
        "seconds": tally.seconds,
        "status": {word: count for word, count in tally.status.items() if count},
        "nis": tally.nis / tally.used if tally.used else None,
        "believable": outcome.believable,
        "findings": [str(finding) for finding in tally.findings],
    }
