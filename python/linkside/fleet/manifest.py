"""A table with a row for each log: verdict, figures, digests, time and worker."""

from __future__ import annotations

import time
from collections.abc import Mapping
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

EVERY = 30.0
"""Time between two writings of a manifest while logs are estimated [s]."""

ONCE = ("nis_per_reading", "digest", "begun", "elapsed", "method_seconds", "worker")
"""Columns that a skipped estimate takes from the earlier manifest."""


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
        A Parquet file, or the URL of one. Its rows stay until their output is estimated again.

    Raises
    ------
    LogError
        If another file is there.
    """

    def __init__(self, place: str) -> None:
        self.place = place
        self.rows = {row["output"]: row for row in _read(place)}
        self._written = time.monotonic()

    def seen(self, output: str, log: str) -> tuple[str, bytes] | None:
        """State and digest of a log in a store when its estimate was made, where they are known."""
        row = self.rows.get(output)
        if row is None or row["log"] != log or not (row["log_state"] and row["log_digest"]):
            return None
        return row["log_state"], bytes.fromhex(row["log_digest"])

    def add(self, outcome: Outcome) -> None:
        """Note an outcome, and from time to time write all rows, so that a killed run loses few.

        A skipped estimate keeps the time and worker of its earlier run.
        """
        output = outcome.job.output
        self.rows[output] = _row(outcome, self.rows.get(output, {}))
        if time.monotonic() > self._written + EVERY:
            self.write()

    def write(self) -> None:
        """Write all rows, sorted by their output, whole or not at all."""
        self._written = time.monotonic()
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
        raise failure(place, f"this file is not a manifest: {error}") from None
    if not table.schema.equals(SCHEMA):
        raise failure(place, "this file is not a manifest")
    return list(table.to_pylist())
