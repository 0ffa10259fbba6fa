"""Writes each tutorial as a Jupyter notebook: ``python docs/notebooks.py FOLDER``.

The page is the only source: text becomes Markdown cells; code, commands and files become cells that run.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

TUTORIALS = Path(__file__).parent / "tutorials"
FILES = {"xml": "robot.urdf", "yaml": "robot.yaml", "cpp": "loop.cpp"}


def notebook(page: Path) -> dict[str, Any]:
    """Turn a page into a notebook of format 4."""
    cells = [cell for cell in split(page.read_text()) if cell["source"]]
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    return {"cells": cells, "metadata": {"kernelspec": kernel}, "nbformat": 4, "nbformat_minor": 4}


def split(text: str) -> Iterator[dict[str, Any]]:
    """Cut a page into cells: blocks that run, and the text between them with blocks that only show."""
    shown = ""
    for part in re.split(r"(^```\w+\n.*?^```\n)", text, flags=re.MULTILINE | re.DOTALL):
        block = re.match(r"```(python|sh|xml|yaml|cpp)\n(.*)```\n", part, re.DOTALL)
        if block is None:
            shown += part
            continue
        yield {"cell_type": "markdown", "metadata": {}, "source": shown.strip()}
        shown = ""
        yield {
            "cell_type": "code",
            "metadata": {},
            "source": runnable(*block.groups()),
            "outputs": [],
            "execution_count": None,
        }
    yield {"cell_type": "markdown", "metadata": {}, "source": shown.strip()}


def runnable(language: str, block: str) -> str:
    """Write a block as a cell that runs: files are saved, commands go to the shell."""
    if language in FILES:
        return f"%%writefile {FILES[language]}\n{block}"
    return "".join(f"!{line}\n" for line in block.splitlines()) if language == "sh" else block


def main() -> None:
    """Write all notebooks."""
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    for page in sorted(TUTORIALS.glob("*.md")):
        (folder / f"{page.stem}.ipynb").write_text(json.dumps(notebook(page), ensure_ascii=False, indent=1))


if __name__ == "__main__":
    main()
