"""Plain English: no riddles and one spelling, in pages, docstrings and messages."""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
RIDDLES = {
    r"[Ff]oretell\w*|[Ff]oretold\b(?! :|, opt)": "predict",
    r"\banew\b": "again",
    r"\bso many\b": "this many; say what is counted",
    r"\bbelieved?\b": "trust, use",
    r"came of it": "the result",
    r"\b(rides?|riding|led|leads) along\b": "is propagated",
    r"\bhow sure\b": "uncertainty",
    r"\babsurd\b": "extreme",
    r"\bhonest\b": "realistic, correct",
    r"\bput right\b": "corrected",
    r"\bto and fro\b": "back and forth",
}
"""Words that a reader has to solve, and what to write instead."""

AMERICAN = r"\b(behavior|model(ed|ing)|analyz\w+|normaliz\w+|optimiz(e|es|ed|ing|er)|lineariz\w+|neighbor\w*)\b"
"""Spellings of the other side of the Atlantic; names in code are not prose."""

PAGES = [*sorted((ROOT / "docs").rglob("*.md")), *(ROOT / f"{n}.md" for n in ("README", "CHANGELOG", "CONTRIBUTING"))]
MODULES = sorted((ROOT / "python/linkside").rglob("*.py"))


@cache
def prose(path):
    """Lines of a page without its code; lines of a module's docstrings and messages."""
    text = path.read_text()
    if path.suffix == ".md":
        text = re.sub(r"^```.*?^```|`[^`\n]*`", "", text, flags=re.MULTILINE | re.DOTALL)
        return text.splitlines()
    strings = (n.value for n in ast.walk(ast.parse(text)) if isinstance(n, ast.Constant) and isinstance(n.value, str))
    return [line for string in strings if " " in string for line in re.sub(r"`[^`\n]*`", "", string).splitlines()]


def found(paths, pattern):
    """Lines with the pattern, each with its file."""
    return [
        f"{path.relative_to(ROOT)}: {line.strip()}"
        for path in paths
        for line in prose(path)
        if re.search(pattern, line)
    ]


@pytest.mark.parametrize("pattern", RIDDLES)
def test_no_riddles(pattern):
    assert found([*PAGES, *MODULES], pattern) == [], f"write instead: {RIDDLES[pattern]}"


def test_british_spelling():
    assert found([*PAGES, *MODULES], AMERICAN) == []


def test_code_is_no_prose():
    assert "foretell" in (ROOT / "CHANGELOG.md").read_text()
    assert not any("foretell" in line for line in prose(ROOT / "CHANGELOG.md"))


@pytest.mark.parametrize("page", [p for p in PAGES if p.parent.name == "tutorials"], ids=lambda page: page.stem)
def test_tutorials_have_pictures(page):
    assert re.search(r"!\[.+\]\(\w+\.svg\)", page.read_text())
