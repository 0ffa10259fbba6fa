"""The command line's conversion of bags into logs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime, timezone
from typing import Any

import click
from rich.console import RenderableType

from linkside.files.bags import Bag
from linkside.files.tables import numbers
from linkside.files.yaml_source import Source
from linkside.recording.pace import column_rates
from linkside.recording.sources import bag_table, origin_of, robot_table
from linkside.recording.writer import EstimateWriter
from linkside.robot import Robot
from linkside.robot.sources import SourcesConfig
from linkside.text import Titled

from .terminal import rate_lines

OPTIONS = {"JointState": "--joints {topic}", "Imu": "--imu NAME={topic}", "WrenchStamped": "--wrench NAME={topic}"}
"""What takes a topic, by its type; any other has fields."""


def contents(path: str) -> list[RenderableType]:
    """Tell of a bag's topics, and how to take them."""
    bag = Bag(path)
    table = Titled(path, ("topic", "type", "messages", "taken by"))
    for topic in bag.topics():
        option = OPTIONS.get(topic.message.rpartition("/")[2], "--field COLUMN={topic}:PATH")
        table.add_row(topic.name, topic.message, str(topic.count), option.format(topic=topic.name))
    return [table, *bag.notes]


def sources(options: Mapping[str, Sequence[str]]) -> SourcesConfig:
    """What options of the command line say, as robot.yaml says it."""
    tree: dict[str, Any] = {key: _named(f"--{key}", options[key]) for key in ("imu", "wrench")}
    tree["fields"] = _named("--field", options["fields"])
    tree["joints"] = [_joints(text) for text in options["joints"]]
    return Source(tree).validate(SourcesConfig)


def run(path: str, by: SourcesConfig | Robot, out: str) -> Iterator[str]:
    """Write the log of a bag, and say in lines what is in it."""
    bag = Bag(path)
    table = robot_table(bag, by) if isinstance(by, Robot) else bag_table(bag, by, None, ())
    with EstimateWriter(out, table.metadata) as writer:
        writer.write(table)
    time, *columns = table.names
    arrays = table.to_arrow()
    t = numbers(arrays, time, out)
    seconds, nanoseconds = divmod(origin_of(table), 10**9)
    begin = datetime.fromtimestamp(seconds, timezone.utc).strftime("%Y-%m-%d %H:%M:%S")
    yield f"{out}: {len(t)} rows, {t[-1] - t[0]:.6g} s; {time} = 0 is {begin}.{nanoseconds:09d} UTC"
    yield from rate_lines(column_rates(t, ((column, numbers(arrays, column, out)) for column in columns)))


def _named(option: str, texts: Sequence[str]) -> dict[str, str]:
    """What an option says of something by name, ``NAME=VALUE``."""
    named: dict[str, str] = {}
    for text in texts:
        name, _, value = text.partition("=")
        if not name or not value or name in named:
            why = "is there twice" if name in named else "expected NAME=VALUE"
            raise click.UsageError(f"{option} {text}: {why}")
        named[name] = value
    return named


def _joints(text: str) -> dict[str, str]:
    """``TOPIC``, or ``TOPIC:SIGNAL=PATH,…``."""
    topic, _, paths = text.partition(":")
    return {"topic": topic, **(_named(f"--joints {topic}:", paths.split(",")) if paths else {})}
