"""Inputs of a report: files with their hashes, versions, the date."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import datetime, timezone
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from linkside.errors import LogError
from linkside.files.bags import bag_files, is_bag

BLOCK = 1 << 20

PACKAGES = ("linkside", "numpy", "pin", "scipy")
"""Those whose version may matter to a result."""


@dataclass(frozen=True)
class Input:
    """A file that was read.

    Attributes
    ----------
    role : str
        What it is, such as ``"robot"``.
    path : str
        As the user called it.
    size : int
        Bytes; of a bag, of all its files.
    sha256 : str
        Of the file; of a bag of several files, of their contents one after the other.
    """

    role: str
    path: str
    size: int
    sha256: str


def inputs(files: Iterable[tuple[str, str | Path | None]]) -> list[Input]:
    """Hash files, given with their roles; what is None, or can no longer be read, is left out."""
    found = []
    for role, path in files:
        if path is None:
            continue
        digest, size = hashlib.sha256(), 0
        try:
            for part in bag_files(path) if is_bag(path) else [Path(path)]:
                with part.open("rb") as file:
                    while block := file.read(BLOCK):
                        digest.update(block)
                        size += len(block)
        except (OSError, LogError):
            continue
        found.append(Input(role, str(path), size, digest.hexdigest()))
    return found


def versions() -> str:
    """The versions of what a result depends on, and the machine."""
    there = []
    for name in PACKAGES:
        try:
            there.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            continue
    return ", ".join([*there, f"Python {platform.python_version()}", f"{platform.system()} {platform.machine()}"])


def today() -> str:
    """Date and time, UTC."""
    return datetime.now(timezone.utc).strftime("%Y-%m-%d %H:%M UTC")
