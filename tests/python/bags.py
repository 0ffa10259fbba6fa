"""Bags for tests, written by `rosbags`, and read by it as the reference."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

STORE = get_typestore(Stores.ROS2_JAZZY)
STORE.register(
    get_types_from_msg(
        "uint8 SIZE=3\nstring MODE='# none'\nbool on\nbyte raw\nchar letter\nint8 small\nuint16 medium\nint64 large\n"
        "float32 single\nstring<=12 short\nfloat64[] none\nuint32 after\nfloat64[<=4] few\nint16[3] three\n"
        "string[] words\ngeometry_msgs/Point[] points\nPart[2] parts\nstd_msgs/Empty empty\n"
        "builtin_interfaces/Time stamp",
        "own_msgs/msg/Everything",
    )
)
STORE.register(get_types_from_msg("float64 value 1.5\nuint8[] bytes", "own_msgs/msg/Part"))
KINDS = {"bool": np.bool_, "byte": np.uint8, "char": np.uint8}


def message(kind, random, lengths=(0, 5)):
    """A message of a type with random contents."""
    parts = {name: _value(node, random, lengths) for name, node in STORE.fielddefs[kind][1]}
    return STORE.types[kind](**parts)


def _value(node, random, lengths):
    kind, detail = node
    if kind == Nodetype.BASE:
        return _base(detail[0], random)
    if kind == Nodetype.NAME:
        return message(detail, random, lengths)
    (inner, inner_detail), count = detail
    if kind == Nodetype.SEQUENCE:
        count = int(random.integers(*lengths)) if not count else int(random.integers(0, count + 1))
    values = [_value((inner, inner_detail), random, lengths) for _ in range(count)]
    if inner == Nodetype.BASE and inner_detail[0] != "string":
        return np.array(values, KINDS.get(inner_detail[0], inner_detail[0]))
    return values


def _base(name, random):
    if name == "string":
        return "".join(random.choice(list("abäδ€ "), random.integers(0, 12)))[:12]
    if name == "bool":
        return bool(random.integers(2))
    if name == "byte":
        return int(random.integers(0, 128))  # unsigned in ROS 2, where rosbags has a sign
    kind = np.dtype(KINDS.get(name, name))
    return np.frombuffer(random.bytes(kind.itemsize), kind)[0].item()


def numbers(value, path="") -> Iterator[tuple[str, float]]:
    """Every number in a message, by its path."""
    if isinstance(value, np.ndarray | list):
        for index, element in enumerate(value):
            yield from numbers(element, f"{path}[{index}]")
    elif hasattr(value, "__msgtype__"):
        for name, _ in STORE.fielddefs[value.__msgtype__][1]:
            yield from numbers(getattr(value, name), f"{path}.{name}" if path else name)
    elif not isinstance(value, str):
        yield path, float(value)


def write(path: Path, topics, storage="mcap", mode="none", *, little=True):
    """Write a bag: ``topics`` gives (time [ns], topic, message) in the order of recording."""
    writer = Writer(path, version=9, storage_plugin=StoragePlugin[storage.upper()])
    writer.set_compression(CompressionMode[mode.upper()], CompressionFormat.ZSTD)
    with writer:
        connections = {}
        for time, topic, content in topics:
            kind = content.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(connections[topic], time, STORE.serialize_cdr(content, kind, little_endian=little))
    return path


def stamp(time):
    """A time [ns] as messages have it."""
    return STORE.types["builtin_interfaces/msg/Time"](time // 10**9, time % 10**9)


def header(time):
    """A header with a stamp [ns]."""
    return STORE.types["std_msgs/msg/Header"](stamp(time), "base")


def joint_state(time, names, position, velocity=(), effort=()):
    """A JointState."""
    arrays = (np.asarray(values, float) for values in (position, velocity, effort))
    return STORE.types["sensor_msgs/msg/JointState"](header(time), list(names), *arrays)


def vector(values):
    return STORE.types["geometry_msgs/msg/Vector3"](*map(float, values))


def imu(time, force, rate=(0, 0, 0), *, no_rate=False):
    """An Imu; ``no_rate`` says that it has no gyroscope."""
    nothing = np.zeros(9)
    sign = np.r_[-1.0, np.zeros(8)] if no_rate else nothing
    turn = STORE.types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    return STORE.types["sensor_msgs/msg/Imu"](header(time), turn, nothing, vector(rate), sign, vector(force), nothing)


def wrench(time, force, torque):
    """A WrenchStamped."""
    content = STORE.types["geometry_msgs/msg/Wrench"](vector(force), vector(torque))
    return STORE.types["geometry_msgs/msg/WrenchStamped"](header(time), content)


def read(path):
    """Every message of a bag, by `rosbags`."""
    with Reader(path) as reader:
        for connection, _, data in reader.messages():
            yield STORE.deserialize_cdr(data, connection.msgtype)
