"""Files that are written whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pyarrow as pa

from linkside.errors import LinksideError, OutputError

from .parts import discard, open_part, replacing
from .regular import instead


def write_text(path: str | Path, text: str) -> None:
    """Write a small file whole or not at all; `OutputError` when that cannot be."""
    write_bytes(path, text.encode())


def write_bytes(path: str | os.PathLike[str], content: bytes) -> None:
    """Write a small file whole or not at all; `OutputError` when that cannot be."""
    path = Path(path)
    with writing(path), replacing(path) as file:
        file.write(content)


def check_writable(path: str | os.PathLike[str], suffixes: tuple[str, ...] = (".parquet", ".csv")) -> None:
    """Raise `OutputError` when a file could not be written to ``path``; nothing there is changed."""
    path = Path(path)
    if path.suffix.lower() not in suffixes:
        raise OutputError(f"{path}: a file that ends in {' or '.join(suffixes)} is expected")
    with writing(path):
        with suppress(FileNotFoundError):  # links in a circle are an OSError of their own
            if instead(path):
                raise OutputError(f"{path}: this is not a file, and is in the way")
        if path.exists() and not os.access(path, os.W_OK):
            raise OutputError(f"{path}: this file must not be written")
        folder = Path(os.path.realpath(path)).parent
        if not folder.is_dir():
            raise OutputError(f"{path}: there is no directory {folder}")
        discard(*open_part(path))  # only an attempt tells of full disks and read-only file systems


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turn what can go wrong while a file is written into an `OutputError` that names it."""
    try:
        yield
    except LinksideError:
        raise
    except (OSError, ValueError, pa.ArrowException) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else error
        raise OutputError(" ".join(f"{path}: cannot be written: {reason}".splitlines())) from error
