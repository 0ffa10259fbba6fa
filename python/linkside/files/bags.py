"""ROS bags, MCAP files and rosbag2: columns of numbers are read by topic and path of a field."""

from __future__ import annotations

import os
import sqlite3
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import quote

import numpy as np
import numpy.typing as npt
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from linkside._core import BagCollector, McapReader, unpack_file
from linkside.arrays import FloatArray
from linkside.errors import LogError, printable

from .regular import instead
from .tables import failure, reading

STORAGES = (".mcap", ".db3")
PACKED = ".zstd"
"""Suffix of a file that rosbag2 has compressed as a whole."""

METADATA = "metadata.yaml"
LARGEST = 64 << 20
"""Bytes of that file."""

ROWS = 10_000
"""Messages of an SQLite file that are in memory at a time."""

Stamps = npt.NDArray[np.int64]


class Wanted(NamedTuple):
    """What is wanted of a topic.

    ``paths`` lead to a number each; where there is a path of ``names``, to an array each, whose elements belong to the
    names, ``only`` some of them if that is said.
    """

    topic: str
    paths: Sequence[str]
    names: str | None = None
    only: Sequence[str] | None = None


class Series(NamedTuple):
    """What was found: stamps in the messages, none where their type has no stamp, and times of recording (T,) [ns].

    A column (T,) for each path, or for each path and name: the names of the first path, then those of the second.
    """

    stamps: Stamps
    received: Stamps
    names: list[str]
    columns: list[FloatArray]


@dataclass(frozen=True)
class Topic:
    """A topic of a bag: its name, the type of its messages, and how many there are."""

    name: str
    message: str
    count: int


def is_bag(path: str | Path) -> bool:
    """Whether a path is a bag's: by its suffix, or a directory of such files."""
    if not os.path.isdir(path):  # unlike that of a Path, it takes names of any length
        return _is_storage(Path(path))
    with suppress(OSError):
        return any(file.name == METADATA or _is_storage(file) for file in Path(path).iterdir())
    return False


def bag_files(path: str | Path) -> list[Path]:
    """Files of a bag, in the order of time, as its metadata has them or else by name."""
    path = Path(path)
    if not path.is_dir():
        return [path]
    told = [path / name for name in _metadata(path).get("relative_file_paths") or []]
    return told or sorted(filter(_is_storage, path.iterdir()), key=_order)


class Bag:
    """A bag: an MCAP file, an SQLite file of rosbag2, or the directory of one.

    Parameters
    ----------
    path
        The file or the directory.

    Attributes
    ----------
    source : str
        Its name, for messages.
    notes : list of str
        Remarks about what was read: a file that was cut off, damaged chunks.

    Raises
    ------
    LogError
        A file or a directory that is not there, or no bag.
    """

    def __init__(self, path: str | Path) -> None:
        """Look for its files."""
        self.source = str(path)
        self.notes: list[str] = []
        with reading(self.source):
            self._files = bag_files(path)
            mode = _metadata(Path(path)).get("compression_mode") if Path(path).is_dir() else ""
            self._packed = str(mode).lower() == "message"
        if not self._files:
            raise failure(self.source, "no .mcap and no .db3 file is in this directory")
        for file in self._files:
            _refuse_other(file)

    def topics(self) -> list[Topic]:
        """Its topics, by reading it whole."""
        collector = BagCollector([], self._packed)
        self._feed(collector)
        return [Topic(*topic) for topic in collector.topics()]

    def read(self, wanted: Sequence[Wanted]) -> list[Series]:
        """Read what is wanted, in one pass.

        Raises
        ------
        LogError
            A topic that is not there, a field that its type lacks, or a bag that cannot be read.
        """
        requests = [(w.topic, list(w.paths), w.names, None if w.only is None else list(w.only)) for w in wanted]
        collector = BagCollector(requests, self._packed)
        self._feed(collector)
        topics = {name: (message, count) for name, message, count in collector.topics()}
        for want in wanted:
            if topics.get(want.topic, ("", 0))[1] == 0:
                there = ", ".join(f"{name} ({message})" for name, (message, count) in topics.items() if count)
                raise failure(self.source, f"no message of topic {want.topic!r}; there is {there or 'none'}")
        return [Series(*found) for found in collector.finish()]

    def _feed(self, collector: BagCollector) -> None:
        self.notes = []
        for file in self._files:
            with _naming(file), _unpacked(file) as plain:
                if plain.suffix == ".mcap":
                    self._feed_mcap(plain, file, collector)
                else:
                    self._feed_sqlite(plain, file, collector)

    def _feed_mcap(self, plain: Path, file: Path, collector: BagCollector) -> None:
        reader = McapReader(plain)
        while reader.advance(collector):
            pass
        if reader.truncated:
            self.notes.append(f"{file}: this file was cut off: it is read up to its last whole chunk")
        if reader.damaged:
            first, count = reader.damaged[0], len(reader.damaged)
            self.notes.append(f"{file}: {count} damaged chunks are left out, the first at byte {first}")

    def _feed_sqlite(self, plain: Path, file: Path, collector: BagCollector) -> None:
        address = f"file:{quote(str(plain))}?mode=ro"
        with closing(sqlite3.connect(address, uri=True)) as database:
            channels = _define(database, collector)
            for topic, channel in channels.items():
                rows = database.execute("SELECT timestamp, data FROM messages WHERE topic_id = ? ORDER BY id", (topic,))
                try:
                    while some := rows.fetchmany(ROWS):
                        collector.add(channel, some)
                except sqlite3.DatabaseError as error:
                    self.notes.append(f"{file}: this file is damaged ({error}): it is read as far as that goes")
                    return


def _define(database: sqlite3.Connection, collector: BagCollector) -> dict[int, int]:
    """Tell a collector of the topics of a file; their numbers there by those here."""
    tables = {name for (name,) in database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    definitions: dict[str, tuple[str, str]] = {}
    if "message_definitions" in tables:
        query = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
        definitions = {kind: (language, text) for kind, language, text in database.execute(query)}
    channels = {}
    for number, name, kind, encoding in database.execute("SELECT id, name, type, serialization_format FROM topics"):
        language, text = definitions.get(kind, ("", ""))
        channels[number] = collector.define(name, kind, encoding, language, text.encode())
    return channels


def _metadata(folder: Path) -> dict[str, Any]:
    """What a directory's metadata says; nothing where it is missing, as after a crash of the recorder."""
    path = folder / METADATA
    if not path.is_file():
        return {}
    if path.stat().st_size > LARGEST:
        raise failure(str(path), f"at most {LARGEST} bytes are expected")
    try:
        tree = YAML(typ="safe", pure=True).load(path.read_text())
    except YAMLError as error:
        raise failure(str(path), f"this is not YAML: {error}") from error
    known = tree.get("rosbag2_bagfile_information") if isinstance(tree, dict) else None
    if not isinstance(known, dict):
        raise failure(str(path), "no rosbag2_bagfile_information is in it")
    return known


def _is_storage(path: Path) -> bool:
    return path.name.lower().removesuffix(PACKED).endswith(STORAGES)


def _order(path: Path) -> tuple[int, str]:
    """Files of one recording are numbered, ``name_0.mcap``, ``name_10.mcap``: by length, then by name."""
    return len(path.name), path.name


def _refuse_other(file: Path) -> None:
    with reading(str(file)):
        try:
            other = instead(file)
        except FileNotFoundError:
            raise failure(str(file), "no such file") from None
    if other or not _is_storage(file):
        raise failure(str(file), f"this is {other or 'no bag'}: a file that ends in .mcap or .db3 is expected")


@contextmanager
def _unpacked(file: Path) -> Iterator[Path]:
    """The file itself, or a temporary one with what is in it."""
    if not file.name.lower().endswith(PACKED):
        yield file
        return
    with tempfile.TemporaryDirectory() as folder:
        plain = Path(folder) / file.name[: -len(PACKED)]
        unpack_file(file, plain)
        yield plain


@contextmanager
def _naming(file: Path) -> Iterator[None]:
    """Let errors say which file they are about."""
    try:
        with reading(str(file)):
            yield
    except sqlite3.Error as error:
        raise failure(str(file), f"cannot be read as SQLite: {error}") from error
    except LogError as error:
        if str(error).startswith(printable(str(file))):
            raise
        raise failure(str(file), str(error)) from error
