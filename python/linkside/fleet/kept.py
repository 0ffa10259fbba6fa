"""The outcome of a log in the metadata of its Parquet estimate, so that a skipped estimate is judged as before."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import asdict

from linkside.findings import Fault
from linkside.recording.checks.finding import Finding

from .places import parquet_metadata
from .tally import Tally

METADATA = "linkside.outcome"
"""The key in the metadata of a Parquet file."""


def record(tally: Tally, conversions: tuple[str, ...], suspicions: tuple[Finding, ...]) -> dict[str, str]:
    """Return it as metadata that is the same for the same estimate: without run times and rounding of sums."""
    kept = {name: value for name, value in vars(tally).items() if not name.startswith("_") and name != "seconds"}
    kept["nis"] = float(f"{tally.nis:.10g}")
    kept["findings"] = [asdict(fault) for fault in tally.findings]
    told = {"tally": kept, "conversions": conversions, "suspicions": [asdict(found) for found in suspicions]}
    return {METADATA: json.dumps(told, ensure_ascii=False)}


def recall(place: str) -> tuple[Tally, tuple[str, ...], tuple[Finding, ...]] | None:
    """Read it back; None where the file has none, or not as `record` writes it."""
    try:
        told = json.loads((parquet_metadata(place) or {})[METADATA.encode()])
        counts = dict(told["tally"])
        status: Counter[str] = Counter(counts.pop("status"))
        faults = tuple(Fault(**fault) for fault in counts.pop("findings"))
        suspicions = tuple(Finding(**found) for found in told["suspicions"])
        return Tally(status=status, findings=faults, **counts), tuple(told["conversions"]), suspicions
    except (KeyError, ValueError, TypeError):
        return None
