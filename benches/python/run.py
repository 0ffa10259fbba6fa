"""How fast linkside is beside what one would write or call instead: `make bench`.

Each bench is a file with a function `bench` that yields `timing.Result`; list it in `BENCHES`. Medians in one process
on one thread. The exit status is 1 if a requirement is not met.
"""

import os
import platform
from importlib import import_module
from importlib.metadata import version

from rich.console import Console
from rich.table import Table
from timing import Result

BENCHES = ("observer", "kalman", "particle", "dynamics", "velocity", "simulate", "control", "calibrate")
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "RAYON_NUM_THREADS")


def main() -> int:
    """Run all benches and print their table."""
    os.environ |= dict.fromkeys(THREADS, "1")  # before a bench imports NumPy and linkside, which start theirs
    console = Console(width=130)
    with console.status("timing"):
        results = [result for name in BENCHES for result in import_module(name).bench()]
    console.print(table(results))
    packages = ", ".join(f"{name} {version(name)}" for name in ("linkside", "numpy", "pin"))
    console.print(f"{platform.machine()}, Python {platform.python_version()}, {packages}; medians, one thread")
    return 0 if all(result.met for result in results) else 1


def table(results: list[Result]) -> Table:
    """A line for each result."""
    out = Table(title="µs for each sample")
    out.add_column("", no_wrap=True)
    out.add_column("linkside", justify="right")
    out.add_column("peer")
    for title in ("µs", "ratio", "required", "met"):
        out.add_column(title, justify="right")
    for r in results:
        theirs, ratio = ("", "") if r.theirs is None else (f"{r.theirs:.2f}", f"{r.ratio:.3g}")
        verdict = "" if not r.requirement else "[green]yes" if r.met else "[red]no"
        out.add_row(r.what, f"{r.ours:.3f}", r.peer, theirs, ratio, r.requirement, verdict)
    return out


if __name__ == "__main__":
    raise SystemExit(main())
