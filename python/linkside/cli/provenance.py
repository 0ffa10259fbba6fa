"""What an estimate was made from, as a digest that its file carries."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from importlib.metadata import version
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from linkside.errors import LogError
from linkside.files.bags import bag_files, is_bag

METADATA = "linkside.made_from"
"""The key of the digest in the metadata of a Parquet file."""

BLOCK = 1 << 20


def digest(files: Iterable[str | Path], settings: object) -> str:
    """Digest files, settings and the version of linkside; unreadable files are reported elsewhere."""
    whole = hashlib.blake2b(f"{version('linkside')} {settings!r}".encode(), digest_size=16)
    for path in files:
        whole.update(_of_file(path))
    return whole.hexdigest()


def _of_file(path: str | Path) -> bytes:
    own = hashlib.blake2b(digest_size=16)
    try:
        for part in bag_files(path) if is_bag(path) else [Path(path)]:
            with part.open("rb") as file:
                while block := file.read(BLOCK):
                    own.update(block)
    except (OSError, LogError):
        return b"?"
    return own.digest()


def is_up_to_date(output: Path, made_from: Mapping[str, str]) -> bool:
    """Whether a Parquet file is there, whole, and carries the same."""
    try:
        metadata = pq.read_metadata(output).metadata or {}
    except (OSError, pa.ArrowException):
        return False
    return all(metadata.get(key.encode()) == value.encode() for key, value in made_from.items())
