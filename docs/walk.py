"""Does what a tutorial says: saves its files, runs its commands and its code, in the order of the page.

A block of ``xml`` is saved as robot.urdf, one of ``yaml`` as robot.yaml and one of ``cpp`` as loop.cpp. A command ends
with ``# exit status N`` where that is not 0. What ``print`` gives is what the comment behind it, or a line ``# …``
below it, says, to its last digit.
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import shlex
from collections.abc import Iterator
from glob import glob
from pathlib import Path
from typing import Any

from linkside.cli import main

FILES = {"xml": "robot.urdf", "yaml": "robot.yaml", "cpp": "loop.cpp"}
NUMBER = r"-?\d+(?:\.\d+)?(?:e[-+]?\d+)?"


def walk(page: Path, folder: Path) -> dict[str, Any]:
    """Follow a page in a folder, and return the variables of its code; `AssertionError` where it promises too much."""
    text, before, names = page.read_text(), Path.cwd(), {}
    os.chdir(folder)
    try:
        for language, block in re.findall(r"^```(\w+)\n(.*?)^```", text, re.MULTILINE | re.DOTALL):
            if language in FILES:
                Path(FILES[language]).write_text(block)
            elif language == "sh":
                run_commands(block)
            elif language == "python":
                run_code(block, names)
    finally:
        os.chdir(before)
    return names


def run_commands(block: str) -> None:
    """Run each line of a block in this process."""
    for line in block.splitlines():
        program, *words = shlex.split(line, comments=True)
        arguments = [name for word in words for name in (sorted(glob(word)) or [word])]
        assert program == "linkside", line
        promised = re.search(r"# exit status (\d)", line)
        try:
            with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()) as said:
                main(arguments)
        except SystemExit as end:
            status = end.code or 0
        else:
            status = 0
        assert status == int(promised.group(1) if promised else 0), f"{line}: exit status {status}: {said.getvalue()}"


def run_code(block: str, names: dict[str, Any]) -> None:
    """Run a block of code, and hold what it prints to the comments behind."""
    with contextlib.redirect_stdout(io.StringIO()) as said:
        exec(compile(block, "tutorial", "exec"), names)
    comments = re.findall(r"^print\(.*\)  # (.*)$|^# (.*)$", block, re.MULTILINE)
    promises = [beside or below for beside, below in comments]
    for promise, line in zip(promises, said.getvalue().splitlines(), strict=True):
        for stated, found in zip(numbers(promise), numbers(line), strict=True):
            digits = len(stated.partition(".")[2].partition("e")[0])
            power = int(stated.partition("e")[2] or 0)
            assert abs(float(stated) - float(found)) <= 1.01 * 10.0 ** (power - digits), f"{line!r} is not {promise!r}"


def numbers(text: str) -> Iterator[str]:
    """The numbers in a line, without those in brackets, which are units."""
    return iter(re.findall(NUMBER, re.sub(r"\[[^\d\]]*\]", "", text)))
