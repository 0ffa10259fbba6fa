"""Temporary files and folders of outputs; those of killed runs are found and removed by a later run.

A writer holds a lock, which the system releases whenever the process ends.
"""

from __future__ import annotations

import os
import shutil
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import IO

try:
    import fcntl
except ImportError:  # Windows, where a file that is open cannot be removed anyway
    fcntl = None  # type: ignore[assignment]

PART = ".linkside-part"
SPILL = ".linkside-spill"
_LOCK = "lock"


def open_part(path: Path) -> tuple[Path, IO[bytes]]:
    """Create a file beside ``path``, on the same file system, with the permissions of any new file.

    What killed runs left there is removed first. Raises OSError.
    """
    target = Path(os.path.realpath(path))
    clear(target.parent)
    while True:
        part = target.with_name(f".{uuid.uuid4().hex}{PART}")
        file = part.open("xb")
        if _lock(file) and part.exists():  # not if another run took it for abandoned before it was locked
            return part, file
        file.close()


@contextmanager
def replacing(path: Path) -> Iterator[IO[bytes]]:
    """Give a file that takes the place of ``path`` when the block ends well, and is gone when not. Raises OSError."""
    part, file = open_part(path)
    try:
        yield file
        publish(part, file, path)
    finally:
        discard(part, file)


def settle(file: IO[bytes]) -> None:
    """Bring all that was written onto the disk. Raises OSError."""
    file.flush()
    os.fsync(file.fileno())


def discard(part: Path, file: IO[bytes]) -> None:
    """Close a file and remove it, unless it was published."""
    with suppress(OSError):  # a full disk refuses what is still to be flushed
        file.close()
    with suppress(OSError):
        part.unlink(missing_ok=True)


def publish(part: Path, file: IO[bytes], path: Path) -> None:
    """Give a file that is written its name, in place of an older one, safe against a power cut. Raises OSError."""
    settle(file)  # or the name could be left on an empty file
    if fcntl is None:
        file.close()  # Windows renames no file that is open
    os.replace(part, os.path.realpath(path))  # before its lock is gone: to others it were abandoned
    file.close()


@contextmanager
def spill_folder(folder: Path) -> Iterator[Path]:
    """Make a folder in ``folder`` for what does not fit into memory; removed at the end whatever happens."""
    clear(folder)
    spill, file = _locked_folder(folder)
    try:
        with file:
            yield spill
    finally:
        shutil.rmtree(spill, ignore_errors=True)


def _locked_folder(folder: Path) -> tuple[Path, IO[bytes]]:
    while True:
        spill = folder / f".{uuid.uuid4().hex}{SPILL}"
        spill.mkdir()
        file = (spill / _LOCK).open("xb")
        if _lock(file) and (spill / _LOCK).exists():
            return spill, file
        file.close()


def clear(folder: Path) -> None:
    """Remove what killed runs left in a folder; what runs still write stays."""
    with suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            path = Path(entry.path)
            if entry.name.endswith(PART) and entry.is_file(follow_symlinks=False):
                _remove(path, partial(path.unlink, missing_ok=True))
            elif entry.name.endswith(SPILL):
                _remove(path / _LOCK, partial(shutil.rmtree, path, ignore_errors=True))


def _remove(locked: Path, remove: Callable[[], None]) -> None:
    """Remove a file that no process writes, under its lock, so that a process that has just created it notices."""
    with suppress(OSError), locked.open("rb") as file:
        if _lock(file):
            remove()


def _lock(file: IO[bytes]) -> bool:
    """Lock a file that is open, unless another process has."""
    if fcntl is None:
        return True
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        return not isinstance(error, BlockingIOError)  # a file system without locks
    return True
