"""Recordings with few rows a second: estimates are as accurate as the page on recordings says."""

import re
import runpy
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"
errors = runpy.run_path(str(DOCS / "rates.py"))["errors"]


@pytest.mark.parametrize("every", [4, 10, 20, 40])
def test_the_table_of_rates_is_true(every):
    rows = re.findall(r"^\| arm2_square \| (.*) \|$", (DOCS / "record.md").read_text(), re.MULTILINE)
    rate, *found = errors("arm2_square", every)
    [stated] = [cells[1:] for cells in (row.split(" | ") for row in rows) if cells[0] == rate]
    for said, here in zip(stated, found, strict=True):
        if said == "refused":
            assert here == said
        else:
            assert float(here) == pytest.approx(float(said), abs=1.5e-3)
