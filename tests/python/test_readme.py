"""The documents do not lie: their code runs, their robots load, and their table of errors is what comes out."""

import re
import shutil
from pathlib import Path

import pytest

import linkside
from linkside import AccelerationObserver, Estimate, Log, Robot

ROOT = Path(__file__).parents[2]
DATA = ROOT / "tests/data"
DOCUMENTS = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]


def blocks(document, language):
    return re.findall(rf"^```{language}\n(.*?)^```", document.read_text(), re.MULTILINE | re.DOTALL)


def with_blocks(language):
    return [pytest.param(d, id=str(d.relative_to(ROOT))) for d in DOCUMENTS if blocks(d, language)]


@pytest.mark.parametrize("document", with_blocks("python"))
def test_python_runs(document, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    namespace = {}
    for block in blocks(document, "python"):
        exec(compile(block, str(document), "exec"), namespace)


@pytest.mark.parametrize("document", with_blocks("yaml"))
def test_robots_load(document, tmp_path):
    shutil.copy(DATA / "arm2_square/robot.urdf", tmp_path)
    for block in blocks(document, "yaml"):
        path = tmp_path / "robot.yaml"
        path.write_text(block)
        assert Robot.load(path).tool is not None


@pytest.mark.parametrize("document", [pytest.param(d, id=d.name) for d in DOCUMENTS])
def test_links_lead_somewhere(document):
    for target in re.findall(r"\]\((?!http)([^)#]+)(?:#[^)]*)?\)", document.read_text()):
        assert (document.parent / target).exists(), target


def centred_rms(tool, truth):
    error = tool - truth
    return 1e3 * ((error - error.mean(axis=0)) ** 2).sum(axis=1).mean() ** 0.5


def test_table_of_tool_errors_is_true():
    rows = re.findall(r"^\| (kr15_\w+|arm2_\w+).*\| ([\d.]+) \| ([\d.]+) \|$", DOCUMENTS[0].read_text(), re.MULTILINE)
    assert len(rows) == 5
    for name, motor, observer in rows:
        folder = linkside.demo.FOLDER if name == "kr15_short" else DATA / name
        robot = Robot.load(folder / "robot.yaml")
        log = Log.read(folder / "log.parquet", robot)
        truth = Estimate.read(folder / "truth.parquet").tool_position
        tools = robot.tool_position(log.theta), AccelerationObserver(robot).run(log).tool_position
        for stated, tool in zip((motor, observer), tools, strict=True):
            last_digit = 10.0 ** -len(stated.partition(".")[2])
            assert centred_rms(tool, truth) == pytest.approx(float(stated), abs=0.51 * last_digit), name
