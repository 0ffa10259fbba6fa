"""A table of what came of each log: its verdict and figures, digests, and when and where that was worked out."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import datetime, timezone
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from linkside.files.tables import failure
from linkside.recording.writer import EstimateWriter

from .places import exists, local_copy, local_output
from .task import Outcome

SCHEMA = pa.schema(
    [
        ("log", pa.string()),
        ("output", pa.string()),
        ("verdict", pa.string()),
        ("error", pa.string()),
        ("rows", pa.int64()),
        ("motion", pa.float64()),  # [s]
        ("good", pa.float64()),  # share of the rows
        ("nis_per_reading", pa.float64()),
        ("findings", pa.list_(pa.string())),
        ("log_digest", pa.string()),
        ("log_state", pa.string()),
        ("made_from", pa.string()),
        ("digest", pa.string()),
        ("begun", pa.timestamp("ms", "UTC")),
        ("elapsed", pa.float64()),  # [s], with reading and writing
        ("method_seconds", pa.float64()),
        ("worker", pa.string()),
    ]
)
"""Columns of a manifest; digests are BLAKE2b of 16 bytes."""

ONCE = ("digest", "begun", "elapsed", "method_seconds", "worker")
"""What an earlier manifest knows of an estimate that is left alone."""


@dataclass(frozen=True)
class _ManifestRows:
    table: pa.Table

    def to_arrow(self) -> pa.Table:
        return self.table


class Manifest:
    """Rows by the place of their output, each once.

    Parameters
    ----------
    place
        A Parquet file, or the URL of one. Rows that it has already stay until their output is estimated anew.

    Raises
    ------
    LogError
        Where that is there and no manifest.
    """

    def __init__(self, place: str) -> None:
        self.place = place
        self.rows = {row["output"]: row for row in _read(place)}

    def seen(self, output: str, log: str) -> tuple[str, bytes] | None:
        """State and digest of a log in a store when its estimate was made, where they are known."""
        row = self.rows.get(output)
        if row is None or row["log"] != log or not (row["log_state"] and row["log_digest"]):
            return None
        return row["log_state"], bytes.fromhex(row["log_digest"])

    def add(self, outcomes: Iterable[Outcome]) -> None:
        """Note outcomes; one that was left alone keeps when and where it was worked out."""
        for outcome in outcomes:
            output = outcome.job.output
            self.rows[output] = _row(outcome, self.rows.get(output, {}))

    def write(self) -> None:
        """Write all rows, sorted by their output, whole or not at all."""
        rows = [self.rows[output] for output in sorted(self.rows)]
        with local_output(self.place) as path, EstimateWriter(path) as file:
            file.write(_ManifestRows(pa.Table.from_pylist(rows, SCHEMA)))


def _row(outcome: Outcome, before: Mapping[str, Any]) -> dict[str, Any]:
    tally = outcome.tally
    row = {
        "log": outcome.job.log,
        "output": outcome.job.output,
        "verdict": outcome.verdict,
        "error": None if outcome.error is None else str(outcome.error),
        "rows": tally.rows,
        "motion": tally.motion,
        "good": tally.status["good"] / tally.rows if tally.rows else None,
        "nis_per_reading": tally.nis / tally.used if tally.used else None,
        "findings": [str(finding) for finding in tally.findings],
        "log_digest": outcome.log_digest or None,
        "log_state": outcome.log_state,
        "made_from": outcome.made_from or None,
        "digest": outcome.digest or None,
        "begun": datetime.fromtimestamp(outcome.begun, timezone.utc) if outcome.begun else None,
        "elapsed": outcome.elapsed,
        "method_seconds": tally.seconds,
        "worker": outcome.worker or None,
    }
    if outcome.kept:
        same = before.get("made_from") == outcome.made_from
        row |= {name: before[name] if same else None for name in ONCE}
    return row


def _read(place: str) -> list[dict[str, Any]]:
    if not place.lower().endswith(".parquet"):
        raise failure(place, "a manifest is a .parquet file")
    if not exists(place):
        return []
    try:
        with local_copy(place) as path:
            table = pq.read_table(path)
    except (OSError, pa.ArrowException) as error:
        raise failure(place, f"this is there, and no manifest: {error}") from None
    if not table.schema.equals(SCHEMA):
        raise failure(place, "this is there, and no manifest")
    return list(table.to_pylist())
