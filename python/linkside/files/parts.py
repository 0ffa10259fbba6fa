"""Files and folders while they are being written: found and cleared by a later run if theirs was killed.

Whoever writes holds a lock, which the system releases when a process ends, however it ends.
"""

from __future__ import annotations

import os
import shutil
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
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
def spill_folder(folder: Path) -> Iterator[Path]:
    """Make a folder in ``folder`` for what does not fit into memory; removed at the end whatever happens."""
    clear(folder)
    spill = folder / f".{uuid.uuid4().hex}{SPILL}"
    spill.mkdir()
    try:
        with (spill / _LOCK).open("xb") as file:
            _lock(file)
            yield spill
    finally:
        shutil.rmtree(spill, ignore_errors=True)


def clear(folder: Path) -> None:
    """Remove what killed runs left in a folder; what runs still write stays."""
    with suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            if entry.name.endswith(PART) and entry.is_file(follow_symlinks=False) and _abandoned(Path(entry.path)):
                Path(entry.path).unlink(missing_ok=True)
            elif entry.name.endswith(SPILL) and _abandoned(Path(entry.path) / _LOCK):
                shutil.rmtree(entry.path, ignore_errors=True)


def _abandoned(path: Path) -> bool:
    try:
        with path.open("rb") as file:
            return _lock(file)
    except OSError:
        return False


def _lock(file: IO[bytes]) -> bool:
    """Lock a file that is open, unless another process has."""
    if fcntl is None:
        return True
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        return not isinstance(error, BlockingIOError)  # a file system without locks
    return True
