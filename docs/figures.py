"""Makes every figure of the pages, or those that are named: ``make figures``, some minutes.

python docs/figures.py record transmissions
"""

from __future__ import annotations

import argparse
from importlib import import_module

SCRIPTS = (
    "tool_error",
    "choose",
    "transmissions",
    "trust",
    "two_peaks",
    "record",
    "learning",
    "papers.pictures",
    "tutorials.pictures",
)
"""Scripts beside this one; each has a function ``draw_all``."""


def main() -> None:
    """Run the scripts one after the other."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scripts", nargs="*", default=SCRIPTS, help=", ".join(SCRIPTS))
    for script in parser.parse_args().scripts:
        import_module(script).draw_all()


if __name__ == "__main__":
    main()
