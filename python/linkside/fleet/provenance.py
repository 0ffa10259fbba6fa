"""What an estimate was made from, as a digest that its file carries."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

from linkside.errors import LogError
from linkside.files.bags import bag_files, is_bag

from .places import parquet_metadata

METADATA = "linkside.made_from"
"""The key of the digest in the metadata of a Parquet file."""

BLOCK = 1 << 20


@dataclass(frozen=True)
class MadeFrom:
    """What all estimates of a run are made from: the version of linkside, files by their digests, and settings."""

    version: str
    settings: str
    files: tuple[bytes, ...]

    @classmethod
    def of(cls, files: Iterable[str | Path], settings: object) -> MadeFrom:
        """Digest files once for all logs; what cannot be read is for others to complain about."""
        return cls(installed(), repr(settings), tuple(file_digest(path) for path in files))

    def with_log(self, log: bytes) -> str:
        """Digest all that the estimate of a log is made from, by the log's own digest."""
        whole = hashlib.blake2b(f"{self.version} {self.settings}".encode(), digest_size=16)
        for own in (*self.files, log):
            whole.update(own)
        return whole.hexdigest()


def installed() -> str:
    """The version of linkside here."""
    return version("linkside")


def file_digest(path: str | Path) -> bytes:
    """Digest a file, or all files of a bag; ``?`` for what cannot be read."""
    own = hashlib.blake2b(digest_size=16)
    try:
        for part in bag_files(path) if is_bag(path) else [Path(path)]:
            with part.open("rb") as file:
                while block := file.read(BLOCK):
                    own.update(block)
    except (OSError, LogError):
        return b"?"
    return own.digest()


def is_up_to_date(output: str, made_from: Mapping[str, str]) -> bool:
    """Whether a Parquet file is there, whole, and carries the same."""
    metadata = parquet_metadata(output)
    return metadata is not None and all(
        metadata.get(key.encode()) == value.encode() for key, value in made_from.items()
    )
