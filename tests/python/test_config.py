"""robot.yaml: what is accepted, and the one line that says why something is not."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ruamel.yaml import YAML

from linkside.errors import ConfigError
from linkside.files.yaml_source import Source
from linkside.robot.config import RobotConfig, RobotFile, load_config
from linkside.robot.joints import JointConfig

from .robots import DATA

TEXT = """\
# an arm
urdf: arm.urdf
joints:
- name: a1
  stiffness: 4.5e5   # measured
  motor_inertia: 70
- {name: a2, stiffness: 3.0e5, motor_inertia: 40, gear_ratio: -100}
- {name: a3, elastic: false}
coupling: {a1: {a2: 0.087}}
accelerometers:
- name: tip
  link: fore
  xyz: [1, 0, 0.08]
  axes: xz
gyroscopes:
- {name: tip, link: fore}
columns: {motor_side: true, theta_a1: pos 1}
"""


def write(folder: Path, text: str) -> str:
    path = folder / "robot.yaml"
    path.write_text(text, encoding="utf-8")
    return str(path)


def message(folder: Path, text: str) -> str:
    """The error about a file, from its line on."""
    path = write(folder, text)
    with pytest.raises(ConfigError) as caught:
        load_config(path)
    line = str(caught.value)
    assert "\n" not in line
    assert line.startswith(path)
    return line.removeprefix(path).removeprefix(":")


def test_reads_every_key_and_fills_in_defaults(tmp_path: Path) -> None:
    config = load_config(write(tmp_path, TEXT))
    first, second, third = config.joints
    assert (first.stiffness, first.damping, first.motor_inertia) == (4.5e5, 0.0, 70.0)
    assert (second.gear_ratio, third.elastic, third.stiffness) == (-100.0, False, None)
    assert config.gravity == (0.0, 0.0, -9.81)
    assert config.coupling == {"a1": {"a2": 0.087}}
    assert config.acceleration_channels == ("tip_x", "tip_z")
    assert config.gyroscope_channels == ("tip_wx", "tip_wy", "tip_wz")
    assert (config.accelerometers[0].noise_std, config.gyroscopes[0].noise_std) == (0.05, 0.001)
    assert (config.encoder.resolution, config.torque.noise_std, config.tool) == (1e-6, 1.0, None)
    assert config.columns.motor_side
    assert config.columns.names == {"theta_a1": "pos 1"}
    assert [config.columns.name_in_log(c) for c in ("theta_a1", "t")] == ["pos 1", "t"]


@pytest.mark.parametrize("path", sorted(DATA.glob("*/robot.yaml")), ids=lambda path: path.parent.name)
def test_reads_the_recorded_robots(path: Path) -> None:
    config = load_config(path)
    assert config.rate_hz == 2000.0
    assert (path.parent / config.urdf).is_file()


def test_models_are_frozen_and_hold_plain_numbers(tmp_path: Path) -> None:
    config = load_config(write(tmp_path, TEXT))
    assert type(config.joints[0].stiffness) is float
    assert type(JointConfig(name="a", elastic=False, damping=np.float64(2)).damping) is float
    with pytest.raises(ValueError, match="frozen"):
        config.joints[0].damping = 3.0


def test_source_can_be_written_back_with_its_comments(tmp_path: Path) -> None:
    source = Source.read(write(tmp_path, TEXT))
    source.tree["joints"][0]["stiffness"] = 4.4e5
    YAML().dump(source.tree, tmp_path / "out.yaml")
    text = (tmp_path / "out.yaml").read_text()
    assert "# an arm" in text
    assert "stiffness: 440000.0 # measured" in text


# What is replaced, by what, and the error's line and text.
MISTAKES = [
    ("4.5e5", "-3", "5: joints[0].stiffness: expected a number greater than 0, got -3"),
    ("4.5e5", "0", "5: joints[0].stiffness: expected a number greater than 0, got 0"),
    ("4.5e5", "'4.5e5'", "5: joints[0].stiffness: expected a number, got '4.5e5'"),
    ("4.5e5", "true", "5: joints[0].stiffness: expected a number, got true"),
    ("4.5e5", "[1, 2]", "5: joints[0].stiffness: expected a number, got a list of 2"),
    ("4.5e5", "{a: 1}", "5: joints[0].stiffness: expected a number, got a mapping"),
    ("4.5e5", ".nan", "5: joints[0].stiffness: expected a finite number, got nan"),
    ("4.5e5", "1e999", "5: joints[0].stiffness: expected a finite number, got inf"),
    ("4.5e5", "4.5e5\n  damping: -1", "6: joints[0].damping: expected a number of at least 0, got -1"),
    (
        "motor_inertia: 70",
        "motor_inertia: -70",
        "6: joints[0].motor_inertia: expected a number greater than 0, got -70",
    ),
    (
        "stiffness: 4.5e5 ",
        "stifness: 4.5e5 ",
        "5: joints[0].stifness: unknown key; did you mean 'stiffness'?",
    ),
    (
        "  motor_inertia: 70\n",
        "",
        "4: joints[0]: missing key 'motor_inertia': an elastic joint needs a number greater than 0",
    ),
    ("gear_ratio: -100", "gear_ratio: 0", "7: joints[1].gear_ratio: expected a number other than 0, got 0"),
    ("gear_ratio: -100", "1: 0", "7: joints[1][1]: expected a key that is text, got 1"),
    ("name: a2, ", "", "7: joints[1]: missing key 'name'"),
    ("name: a2", "name: 2", "7: joints[1].name: expected text, got 2"),
    ("name: a2", "name: ''", "7: joints[1].name: expected printable text, got ''"),
    ("name: a2", "name: a1", "7: joints[1].name: expected a name of its own, got that of joints[0]"),
    ("name: a2", "name: ", "7: joints[1].name: expected text, got nothing"),
    ("elastic: false", "elastic: maybe", "8: joints[2].elastic: expected true or false, got 'maybe'"),
    (
        "elastic: false",
        "elastic: false, link_friction: [1]",
        "8: joints[2].link_friction: expected 6 numbers, got 1",
    ),
    (
        "motor_inertia: 70",
        "motor_inertia: 70\n  soft_windup: {stiffness: 4.5e5, shape: 1}",
        "7: joints[0].soft_windup.stiffness: expected less than the stiffness 450000 can bear, got 450000: "
        "the spring's torque must rise with torsion",
    ),
    (
        "{a1: {a2: 0.087}}",
        "{a2: {a1: 1}}",
        "9: coupling.a2.a1: expected a joint after 'a2': S is strictly upper triangular",
    ),
    (
        "{a1: {a2: 0.087}}",
        "{a1: {a1: 1}}",
        "9: coupling.a1.a1: expected a joint after 'a1': S is strictly upper triangular",
    ),
    (
        "{a1: {a2: 0.087}}",
        "{a1: {a3: 1}}",
        "9: coupling.a1.a3: expected an elastic joint; there is a1, a2",
    ),
    ("{a1: {a2: 0.087}}", "{b: {}}", "9: coupling.b: expected an elastic joint; there is a1, a2"),
    ("{a1: {a2: 0.087}}", "{a1: {a2: x}}", "9: coupling.a1.a2: expected a number, got 'x'"),
    ("{a1: {a2: 0.087}}", "3", "9: coupling: expected a mapping, got 3"),
    ("  link: fore\n", "", "11: accelerometers[0]: missing key 'link'"),
    ("[1, 0, 0.08]", "[1, 0]", "13: accelerometers[0].xyz: expected 3 numbers, got 2"),
    (
        "[1, 0, 0.08]",
        "[1, 0, 0, 0]",
        "13: accelerometers[0].xyz: expected 3 numbers, got 4",
    ),
    ("[1, 0, 0.08]", "[1, 0, up]", "13: accelerometers[0].xyz[2]: expected a number, got 'up'"),
    ("[1, 0, 0.08]", "1", "13: accelerometers[0].xyz: expected a list, got 1"),
    (
        "axes: xz",
        "axes: zx",
        "14: accelerometers[0].axes: expected one of 'x', 'y', 'z', 'xy', 'xz', 'yz' or 'xyz', got 'zx'",
    ),
    ("theta_a1: pos 1", "thta_a1: p", "17: columns.thta_a1: unknown column; did you mean 'theta_a1'?"),
    ("theta_a1: pos 1", "theta_a1: 1", "17: columns.theta_a1: expected text, got 1"),
    ("urdf: arm.urdf\n", "", "1: missing key 'urdf'"),
    ("urdf: arm.urdf", "urdf: [", "4: not valid YAML: …"),
    ("urdf: arm.urdf", "urdf: a\nurdf: b", '3: not valid YAML: found duplicate key "urdf"…'),
    ("urdf: arm.urdf", "urdf: *a", "2: not valid YAML: found undefined alias 'a'"),
    ("urdf: arm.urdf", "urdf: \a", " not valid YAML: unacceptable character #x0007…"),
    ("urdf: arm.urdf", "urdf: 2001-99-99", " not valid YAML: month must be in 1..12"),
    (TEXT, "", " expected a mapping, got nothing"),
    (TEXT, "# nothing\n", " expected a mapping, got nothing"),
    (TEXT, "- 1\n- 2\n", " expected a mapping, got a list of 2"),
    (TEXT, "robot", " expected a mapping, got 'robot'"),
    (TEXT, "urdf: a\njoints: []", "2: joints: expected a list of one joint or more, got an empty one"),
    (TEXT, "urdf: a\njoints: {}", "2: joints: expected a list, got a mapping"),
    (TEXT, "urdf: a\njoints:\n- 3", "3: joints[0]: expected a mapping, got 3"),
    (TEXT, "urdf: 3\njoints: []", "1: urdf: expected text, got 3 (and 1 more)"),
]


@pytest.mark.parametrize(("old", "new", "expected"), MISTAKES)
def test_a_mistake_is_one_line_that_says_where_and_what(tmp_path: Path, old: str, new: str, expected: str) -> None:
    assert old in TEXT
    found = message(tmp_path, TEXT.replace(old, new, 1))
    assert found == expected or (expected.endswith("…") and found.startswith(expected[:-1]))


@pytest.mark.parametrize(("stiffness", "fine"), [(449e3, True), (451e3, False), (-1.0e6, True), (-1.1e6, False)])
def test_soft_windup_must_leave_a_spring_whose_torque_rises(tmp_path: Path, stiffness: float, fine: bool) -> None:
    text = TEXT.replace("motor_inertia: 70", f"motor_inertia: 70\n  soft_windup: {{stiffness: {stiffness}, shape: 3}}")
    if fine:
        assert load_config(write(tmp_path, text)).joints[0].soft_windup.stiffness == stiffness
    else:
        assert "must rise with torsion" in message(tmp_path, text)


def test_unreadable_files_are_one_line(tmp_path: Path) -> None:
    (tmp_path / "bytes.yaml").write_bytes(b"\xff\xfe\x80")
    for name, reason in [("none.yaml", "no such file"), ("", "is a directory"), ("bytes.yaml", "UTF-8")]:
        with pytest.raises(ConfigError, match=reason) as caught:
            load_config(tmp_path / name)
        assert "\n" not in str(caught.value)


def test_merged_keys_are_blamed_on_the_mapping_that_merges_them(tmp_path: Path) -> None:
    text = "base: &b {stiffness: -1}\n"
    assert message(tmp_path, text + "urdf: a\njoints: []").startswith("1: base: unknown key")
    joints = "urdf: a\njoints:\n- &b {name: a, stiffness: -1, motor_inertia: 1}\n- {<<: *b, name: b}\n"
    assert message(tmp_path, joints).startswith("3: joints[0].stiffness")


def test_python_values_are_checked_alike_without_a_line() -> None:
    with pytest.raises(ConfigError) as caught:
        Source({"joints": [{"name": "a", "stiffness": -1, "motor_inertia": 1}]}).validate(RobotConfig)
    assert str(caught.value) == "joints[0].stiffness: expected a number greater than 0, got -1"


def refused(read: Callable[[], RobotFile]) -> str:
    """The one line of the error, or nothing if all is well."""
    try:
        read()
    except ConfigError as error:
        [line] = str(error).splitlines()
        return line
    return ""


def check_outcome(folder: Path, text: str) -> None:
    """Whatever the file: a configuration, or one line that starts with the file's name."""
    path = write(folder, text)
    if error := refused(lambda: load_config(path)):
        assert error.startswith(path)


MARKS = [*":-[]{}#&*!|>'\"%@`,?\n\t \a\0é", "<<: ", "- ", "*x", "&x ", "!!int ", "---\n", "~", "0x"]
FRAGMENTS = st.one_of(st.sampled_from(MARKS), st.text(max_size=4), st.sampled_from(TEXT.splitlines(keepends=True)))
EDITS = st.lists(st.tuples(st.integers(0, len(TEXT)), st.integers(0, 12), FRAGMENTS), min_size=1, max_size=4)


@settings(max_examples=150, deadline=None)
@given(edits=EDITS)
def test_mangled_text_never_raises_anything_else(
    tmp_path_factory: pytest.TempPathFactory, edits: list[tuple[int, int, str]]
) -> None:
    text = TEXT
    for start, length, fragment in edits:
        text = text[:start] + fragment + text[start + length :]
    check_outcome(tmp_path_factory.getbasetemp(), text)


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=6,
)


def replace_some_node(draw: st.DrawFn, node: Any) -> Any:
    """The tree with one node, anywhere, replaced by anything."""
    if not isinstance(node, dict | list) or not node or draw(st.integers(0, 3)) == 0:
        return draw(VALUES)
    copy = node.copy()
    key = draw(st.sampled_from(sorted(node))) if isinstance(node, dict) else draw(st.integers(0, len(node) - 1))
    copy[key] = replace_some_node(draw, node[key])
    return copy


@st.composite
def mutated_trees(draw: st.DrawFn) -> Any:
    return replace_some_node(draw, YAML(typ="safe").load(TEXT))


@settings(max_examples=150, deadline=None)
@given(tree=mutated_trees())
def test_odd_values_never_raise_anything_else(tmp_path_factory: pytest.TempPathFactory, tree: Any) -> None:
    check_outcome(tmp_path_factory.getbasetemp(), json.dumps(tree))
    if isinstance(tree, dict):
        refused(lambda: Source(tree).validate(RobotFile))
