"""An hour of six joints at 2 kHz, as JointState messages in MCAP and in SQLite, to a log: beside `rosbags`.

``python benches/python/bags.py [minutes]``. rosbags reads the first minute, and its time is scaled up.
"""

import argparse
import sqlite3
import struct
import tempfile
import time
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import zstandard
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from linkside.files.bags import Bag
from linkside.files.tables import ArrowTable
from linkside.recording.sources import bag_table
from linkside.recording.writer import EstimateWriter
from linkside.robot.sources import SourcesConfig

RATE, JOINTS, START = 2000, 6, 1_700_000_000
SHORT = 60
"""Seconds that rosbags reads."""

STORE = get_typestore(Stores.ROS2_JAZZY)
KIND, TOPIC = "sensor_msgs/msg/JointState", "/joint_states"
TEXT = STORE.generate_msgdef(KIND, ros_version=2)[0]


def main() -> None:
    """Write the bags, and read them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("minutes", type=float, nargs="?", default=60.0)
    minutes = parser.parse_args().minutes
    with tempfile.TemporaryDirectory() as folder:
        for suffix, write in (("mcap", write_mcap), ("db3", write_sqlite)):
            long, short = Path(folder) / f"long.{suffix}", Path(folder) / f"short_{suffix}"
            write(long, int(60 * minutes))
            write_by_rosbags(short, StoragePlugin.MCAP if suffix == "mcap" else StoragePlugin.SQLITE3)
            measure(long, short, Path(folder) / "log.parquet")
            long.unlink()


def serialized() -> bytes:
    """A message of zeros; its stamp is at byte 4, its last 3 × (8 + 8 n) bytes are lengths and numbers."""
    names = [f"joint_{number}" for number in range(JOINTS)]
    zeros, types = np.zeros(JOINTS), STORE.types
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](0, 0), "base_link")
    return bytes(STORE.serialize_cdr(types[KIND](header, names, zeros, zeros, zeros), KIND))


def second(number: int, random: np.random.Generator) -> np.ndarray:
    """The messages of a second, (RATE, bytes): encoders' steps, smooth velocities, noisy efforts."""
    t = number + np.arange(RATE) / RATE
    phase = t[:, None] * np.linspace(1, 3, JOINTS)
    position = np.round(np.sin(phase) / 6.8e-7) * 6.8e-7
    effort = np.round(100 * np.cos(phase) + random.standard_normal(phase.shape), 3)
    messages = np.tile(np.frombuffer(serialized(), np.uint8), (RATE, 1))
    stamps = np.stack((np.full(RATE, START + number), np.arange(RATE) * (10**9 // RATE)), axis=1).astype("<u4")
    messages[:, 4:12] = stamps.view(np.uint8)
    size, block = messages.shape[1], 8 * JOINTS
    for part, values in enumerate((position, np.cos(phase), effort)):
        end = size - (2 - part) * (block + 8)
        messages[:, end - block : end] = np.ascontiguousarray(values).view(np.uint8)
    return messages


def seconds(count: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Times of recording (RATE,) [ns] and messages of each second."""
    random = np.random.default_rng(1)
    for number in range(count):
        yield (START + number) * 10**9 + np.arange(RATE) * (10**9 // RATE), second(number, random)


def text(value: str) -> bytes:
    """A text as MCAP has it."""
    return struct.pack("<I", len(value)) + value.encode()


def record(kind: int, body: bytes) -> bytes:
    """A record of MCAP."""
    return struct.pack("<BQ", kind, len(body)) + body


def write_mcap(path: Path, count: int) -> None:
    """A chunk a second, compressed with zstd, with checksums."""
    schema = record(3, struct.pack("<H", 1) + text(KIND) + text("ros2msg") + text(TEXT))
    channel = record(4, struct.pack("<HH", 1, 1) + text(TOPIC) + text("cdr") + struct.pack("<I", 0))
    with path.open("wb") as file:
        file.write(b"\x89MCAP0\r\n" + record(1, text("ros2") + text("bench")) + schema + channel)
        for times, messages in seconds(count):
            size = messages.shape[1]
            head = np.dtype(
                [("kind", "u1"), ("length", "<u8"), ("channel", "<u2"), ("number", "<u4"), ("times", "<u8", 2)]
            )
            records = np.zeros(RATE, np.dtype([("head", head), ("message", "u1", size)]))
            records["head"]["kind"], records["head"]["length"], records["head"]["channel"] = 5, size + 22, 1
            records["head"]["times"], records["message"] = times[:, None], messages
            plain = records.tobytes()
            packed = zstandard.compress(plain, 1)
            fields = struct.pack("<QQQI", int(times[0]), int(times[-1]), len(plain), zlib.crc32(plain))
            file.write(record(6, fields + text("zstd") + struct.pack("<Q", len(packed)) + packed))
        file.write(record(15, struct.pack("<I", 0)) + record(2, struct.pack("<QQI", 0, 0, 0)) + b"\x89MCAP0\r\n")


def write_sqlite(path: Path, count: int) -> None:
    """The tables of rosbag2 since ROS 2 Iron."""
    with sqlite3.connect(path) as database:
        database.execute("CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT)")
        database.execute(
            "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)"
        )
        columns = "id INTEGER PRIMARY KEY, topic_type TEXT, encoding TEXT, encoded_message_definition TEXT"
        database.execute(f"CREATE TABLE message_definitions({columns})")
        database.execute("INSERT INTO topics VALUES (1, ?, ?, 'cdr')", (TOPIC, KIND))
        database.execute("INSERT INTO message_definitions VALUES (1, ?, 'ros2msg', ?)", (KIND, TEXT))
        for times, messages in seconds(count):
            rows = ((time, bytes(message)) for time, message in zip(times.tolist(), messages, strict=True))
            database.executemany("INSERT INTO messages (topic_id, timestamp, data) VALUES (1, ?, ?)", rows)
    database.close()


def write_by_rosbags(path: Path, storage: StoragePlugin) -> None:
    """The first seconds, by rosbags itself."""
    with Writer(path, version=9, storage_plugin=storage) as writer:
        topic = writer.add_connection(TOPIC, KIND, typestore=STORE)
        for times, messages in seconds(SHORT):
            for time_, message in zip(times.tolist(), messages, strict=True):
                writer.write(topic, time_, bytes(message))


def measure(long: Path, short: Path, log: Path) -> None:
    """Time ours from the bag to a log, and rosbags from a minute to arrays, which are equal."""
    begun, processor = time.perf_counter(), time.process_time()
    table = taken(long)
    read = time.perf_counter() - begun
    with EstimateWriter(log) as writer:
        writer.write(table)
    ours, count = time.perf_counter() - begun, table.count or 0
    processor = time.process_time() - processor
    del table
    begun, rows = time.process_time(), []
    with Reader(short) as reader:
        for connection, _, data in reader.messages():
            message = STORE.deserialize_cdr(data, connection.msgtype)
            stamp = message.header.stamp
            rows.append((stamp.sec * 10**9 + stamp.nanosec, *message.position, *message.velocity, *message.effort))
    theirs = (time.process_time() - begun) * count / len(rows)
    same = taken(short).to_arrow()
    assert (np.array([row[1:] for row in rows]) == np.array(same.columns[1:]).T).all()
    print(
        f"{long.name}: {count} messages, {long.stat().st_size / 1e6:.0f} MB: to arrays in {read:.1f} s, to a log of "
        f"{log.stat().st_size / 1e6:.0f} MB in {ours:.1f} s ({processor:.1f} s of processor time); rosbags to arrays "
        f"{theirs:.0f} s of processor time"
    )


def taken(bag: Path) -> ArrowTable:
    """All joints' signals."""
    return bag_table(Bag(bag), SourcesConfig.model_validate({"joints": TOPIC}), None, ())


if __name__ == "__main__":
    main()
