"""Tutorials do what they say: each is followed from top to bottom in an empty folder."""

import json
import re
import runpy
import subprocess
from pathlib import Path

import pytest

from linkside import Robot
from linkside.robot.starter import starter

DOCS = Path(__file__).parents[2] / "docs"
walk = runpy.run_path(str(DOCS / "walk.py"))["walk"]
notebook = runpy.run_path(str(DOCS / "notebooks.py"))["notebook"]


@pytest.mark.parametrize("page", sorted((DOCS / "tutorials").glob("*.md")), ids=lambda page: page.stem)
def test_notebooks_have_all_of_the_page(page):
    cells = notebook(page)["cells"]
    code = [cell["source"] for cell in cells if cell["cell_type"] == "code"]
    text = page.read_text()
    assert [c for c in code if c[0] not in "%!"] == re.findall(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    assert sum(c.startswith("!") for c in code) == text.count("```sh\n")
    for line in filter(None, text.splitlines()):
        assert line.startswith("```") or any(line in cell["source"] for cell in cells), line


def test_path(tmp_path):
    names = walk(DOCS / "tutorials/path.md", tmp_path)
    assert names["estimate"].status_summary()["good"] == 1052


@pytest.fixture(scope="module")
def loop(tmp_path_factory):
    folder = tmp_path_factory.mktemp("loop")
    return folder, walk(DOCS / "tutorials/loop.md", folder)


def test_loop(loop):
    assert loop[1]["bridged"] == 20


def test_loop_in_cpp(loop, build):
    folder, names = loop
    done = subprocess.run([build(folder / "loop.cpp")], cwd=folder, check=True, capture_output=True, text=True)
    assert float(done.stdout) == names["states"][-1][0]


def test_repeats(tmp_path):
    names = walk(DOCS / "tutorials/repeats.md", tmp_path)
    assert names["true"][-1] > 10 * names["better"][-1]
    assert names["better"][5] < 1.01 * names["better"][-1]


def test_calibrate(tmp_path):
    page = DOCS / "tutorials/calibrate.md"
    walk(page, tmp_path)
    assert not (tmp_path / "slow.yaml").exists()
    found, true = (Robot.load(tmp_path / name) for name in ("robot.calibrated.yaml", "true.yaml"))
    table = re.findall(r"^(stiffness|damping)_(\w+) +[\d.]+ +([\d.]+) +([\d.e+]+)$", page.read_text(), re.MULTILINE)
    assert len(table) == 4
    for kind, joint, value, error in table:
        stated, spread = float(value), float(error)
        written, right = (getattr(robot.drives[robot.names.index(joint)], kind) for robot in (found, true))
        assert abs(written - right) < 3 * spread, (kind, joint)
        assert written == pytest.approx(stated, abs=spread), (kind, joint)


def test_urdf(tmp_path):
    page = DOCS / "tutorials/urdf.md"
    walk(page, tmp_path)
    drafted = starter(tmp_path / "robot.urdf", tmp_path / "robot.yaml", gear_ratios={"shoulder": 100, "elbow": 80})
    filled = (tmp_path / "robot.yaml").read_text().splitlines()
    asked = ("rate_hz", "joints:", "encoder", "torque:", "tool", "accelerometers", "- {name: tool_acc")
    assert [line for line in filled if line not in drafted.splitlines() and not line.startswith(asked)] == []
    found = Robot.load(tmp_path / "robot.calibrated.yaml")
    table = re.findall(r"^(\w+) +\S+ +([\d.]+) +([\d.e+]+)$", page.read_text(), re.MULTILINE)
    springs = {f"stiffness_{d.name}": d.stiffness for d in found.drives}
    assert {name: float(value) for name, value, _ in table if name in springs} == pytest.approx(springs, rel=0.01)
    for (true, stiffness), error in zip({8e4: "shoulder", 4.5e4: "elbow"}.items(), (2700, 1000), strict=True):
        assert springs[f"stiffness_{stiffness}"] == pytest.approx(true, abs=3 * error)
    assert found.accelerometers[0].xyz[0] == pytest.approx(0.504, abs=0.002)


def test_bag(tmp_path):
    names = walk(DOCS / "tutorials/bag.md", tmp_path)
    assert names["estimate"].status_summary()["good"] == 1501
    assert (tmp_path / "motion.mcap").stat().st_size > 10_000
    assert "No row, channel or finding contradicts" in (tmp_path / "report.html").read_text()


def test_batch(tmp_path):
    names = walk(DOCS / "tutorials/batch.md", tmp_path)
    assert names["worst"] == ["repeat_17"]
    assert "49 of 50 estimates" in (tmp_path / "batch.html").read_text()
    compared = json.loads((tmp_path / "repeats.json").read_text())
    distances = compared["repeats"]["distances"]
    assert max(distances, key=distances.get) in compared["repeats"]["outliers"]
    assert sorted(1e6 * distance for distance in distances.values())[-2:] == pytest.approx([28.5, 3187], rel=0.05)
    assert list(compared["repeats"]["outliers"]) == ["repeat_17"]
    assert 1e-6 < compared["spread"]["tool"] < 1e-4
    assert all((tmp_path / page).stat().st_size <= 2e6 for page in ("batch.html", "repeats.html"))
