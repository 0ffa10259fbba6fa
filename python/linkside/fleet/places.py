"""Where logs are read from and results are written to: paths, and URLs of object stores.

A log in a store is copied to a temporary file while it is estimated, and a result is put into its store when it is
whole. Stores are those of fsspec; ``s3://``, ``gs://`` and ``az://`` use obstore, which repeats requests that a busy
store refuses, and reads keys and endpoints from the environment as other tools do (``AWS_ENDPOINT_URL``).
"""

from __future__ import annotations

import glob
import hashlib
import re
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import urlsplit
from urllib.request import url2pathname

import pyarrow as pa
import pyarrow.parquet as pq

from linkside.errors import EstimatorError, LinksideError, LogError, OutputError
from linkside.files.parts import spill_folder
from linkside.files.writing import check_writable

Read = TypeVar("Read")

OBJECTS = ("s3", "gs", "az")
"""Protocols of obstore."""

_URL = re.compile(r"[a-z][a-z0-9+.-]+://")


def is_url(place: str) -> bool:
    """Whether a place is not a path of this machine."""
    return _URL.match(place) is not None


def plain(place: str) -> str:
    """The path of a URL ``file://…``; any other place as it is."""
    return url2pathname(urlsplit(place).path) if place.startswith("file://") else place


def logs_of(patterns: Iterable[str]) -> list[str]:
    """Logs by path, glob or URL: each once, those of a glob sorted.

    Raises
    ------
    LogError
        A glob without a match, or a store that does not answer.
    """
    found: dict[str, None] = {}
    for pattern in map(plain, patterns):
        matches = _matches(pattern) if glob.has_magic(pattern) and not Path(pattern).exists() else [pattern]
        if not matches:
            raise LogError(f"{pattern}: no such file")
        found.update(dict.fromkeys(matches))
    return list(found)


def joined(folder: str, name: str) -> str:
    """The place of a name in a folder."""
    return f"{folder.rstrip('/')}/{name}" if is_url(folder) else str(Path(folder) / name)


@contextmanager
def local_copy(place: str) -> Iterator[str]:
    """Give a path to read from: the place itself, or for a URL that of a copy."""
    if not is_url(place):
        yield place
        return
    with spill_folder(Path(tempfile.gettempdir())) as folder:
        copy = folder / place.rstrip("/").rsplit("/", 1)[-1]
        with _answering(place, LogError, "cannot be read"):
            store, path = _store(place)
            store.get_file(path, str(copy))
        with _instead_of(str(copy), place):
            yield str(copy)


@contextmanager
def local_output(place: str) -> Iterator[Path]:
    """Give a path to write to: the place itself, or for a URL a temporary file that is uploaded at the end."""
    if not is_url(place):
        yield Path(place)
        return
    with spill_folder(Path(tempfile.gettempdir())) as folder:
        copy = folder / place.rsplit("/", 1)[-1]
        with _instead_of(str(copy), place):
            yield copy
        with _answering(place, OutputError, "cannot be written"):
            store, path = _store(place)
            store.put_file(str(copy), path)  # an object appears when its last byte is there


def parquet_metadata(place: str) -> dict[bytes, bytes] | None:
    """Metadata of a Parquet file; None if it is missing or not whole."""
    try:
        if not is_url(place):
            return pq.read_metadata(place).metadata or {}
        store, path = _store(place)
        with store.open(path, "rb") as file:
            return pq.read_metadata(file).metadata or {}
    except (OSError, pa.ArrowException):
        return None


def state(place: str) -> str | None:
    """A text that changes whenever an object of a store does; None for a path, or if there is no object."""
    if not is_url(place):
        return None
    with _answering(place, LogError, "cannot be read"):
        store, path = _store(place)
        try:
            told = store.info(path)
        except FileNotFoundError:
            return None
    known = repr(sorted((key, str(value)) for key, value in told.items()))
    return hashlib.blake2b(known.encode(), digest_size=16).hexdigest()


def exists(place: str) -> bool:
    """Whether something is at a place."""
    return state(place) is not None if is_url(place) else Path(place).exists()


def check_store(place: str) -> None:
    """Raise `OutputError` where the store of a URL does not answer."""
    with _answering(place, OutputError, "cannot be written"):
        store, path = _store(place)
        store.exists(path)


def check_output(place: str, suffixes: tuple[str, ...]) -> None:
    """Raise `OutputError` where a file could not be written, or its name ends in none of ``suffixes``."""
    if not is_url(place):
        check_writable(place, suffixes)
    elif not place.lower().endswith(suffixes):
        raise OutputError(f"{place}: a file that ends in {' or '.join(suffixes)} is expected")
    else:
        check_store(place)


def from_anywhere(read: Callable[..., Read], place: str | Path, *args: Any) -> Read:
    """Read a path or a URL by what reads a path."""
    with local_copy(str(place)) as path:
        return read(path, *args)


def _matches(pattern: str) -> Sequence[str]:
    if not is_url(pattern):
        return sorted(glob.glob(pattern, recursive=True))
    with _answering(pattern, LogError, "cannot be read"):
        store, path = _store(pattern)
        return sorted(store.unstrip_protocol(found) for found in store.glob(path))


def _store(place: str) -> tuple[Any, str]:
    """The store of a URL, and the path in it."""
    fsspec = _fsspec()
    store, path = fsspec.core.url_to_fs(place)
    return store, path


@cache
def _fsspec() -> Any:
    try:
        import fsspec.core
        import obstore.fsspec
    except ImportError:
        raise EstimatorError("object stores need fsspec and obstore: pip install 'linkside[fleet]'") from None
    obstore.fsspec.register(OBJECTS)
    return fsspec


@contextmanager
def _answering(place: str, kind: type[LinksideError], what: str) -> Iterator[None]:
    """Report errors of a store in one line; each kind of store has exceptions of its own, without a common base."""
    try:
        yield
    except LinksideError:
        raise
    except FileNotFoundError:
        raise kind(f"{place}: no such file") from None
    except Exception as error:
        raise kind(f"{place}: {what}: {error}") from error


@contextmanager
def _instead_of(copy: str, place: str) -> Iterator[None]:
    """Let errors name the place instead of its copy."""
    try:
        yield
    except LinksideError as error:
        if copy not in str(error):
            raise
        raise type(error)(str(error).replace(copy, place)) from error
