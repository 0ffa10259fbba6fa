"""The text of a URDF: numbers as all readers understand them, nothing twice, and no more than can be worked on."""

import math
import re
import xml.etree.ElementTree as ET
from typing import Any

NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")
"""What C++ and Python both read as the same number."""

LARGEST = 64 * 2**20
"""Characters of a URDF; meshes are not part of it."""

DEEPEST = 256
"""Joints one after the other, and elements one in the other."""

MOST = 10_000
"""Links."""


def parse(text: str) -> ET.Element:
    """Parse XML; ValueError when it is too large or nests too deeply, ParseError when it is no XML."""
    if len(text) > LARGEST:
        raise ValueError(f"expected at most {LARGEST} characters, got {len(text)}")
    parser: Any = ET.XMLPullParser(("start", "end"))
    depth = 0
    for start in range(0, len(text), 65_536):
        parser.feed(text[start : start + 65_536])
        for event, _ in parser.read_events():
            depth += 1 if event == "start" else -1
            if depth > DEEPEST:
                raise ValueError(f"expected elements at most {DEEPEST} deep")
    return ET.fromstring(text)


def refuse_twice(element: ET.Element, *children: str, owner: str = "") -> None:
    """Refuse a child that is there more than once: parsers differ in which of them they take."""
    for child in children:
        if (count := len(element.findall(child))) > 1:
            owner = owner or f"{element.tag} '{element.get('name')}'"
            raise ValueError(f"{owner}: <{child}> is there {count} times")


def refuse_deep(root: ET.Element) -> None:
    """Refuse more links, or more joints one after the other, than can be worked on."""
    if (count := len(root.findall("link"))) > MOST:
        raise ValueError(f"expected at most {MOST} links, got {count}")
    parents = {joint.find("child").get("link"): joint.find("parent").get("link") for joint in root.findall("joint")}  # type: ignore[union-attr]
    depth: dict[str | None, int] = {}
    for link in parents:
        path: list[str | None] = []
        here: str | None = link
        while here in parents and here not in depth and len(path) <= len(parents):
            path.append(here)
            here = parents[here]
        for one in reversed(path):
            depth[one] = depth.get(parents[one], 0) + 1
    deepest = max(depth.values(), default=0)
    if deepest > DEEPEST:
        raise ValueError(f"expected at most {DEEPEST} joints one after the other, got {deepest}")


def numbers(element: ET.Element, path: str, key: str, count: int = 1) -> list[float]:
    """Read `count` finite numbers from an attribute of the child at `path`."""
    child = element.find(path)
    text = "" if child is None else child.get(key, "")
    words = text.split()
    values = [float(word) for word in words if NUMBER.fullmatch(word)]
    if len(values) != count or len(words) != count or not all(map(math.isfinite, values)):
        number = "a finite number" if count == 1 else f"{count} finite numbers"
        owner = f"{element.tag} '{element.get('name')}'"
        raise ValueError(f"{owner}: expected {number} in <{path} {key}=…>, got '{text}'")
    return values
