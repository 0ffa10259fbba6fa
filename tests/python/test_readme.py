"""The documents do not lie: their code runs, their robots load, and their table of errors is what comes out."""

import re
import shutil
from pathlib import Path

import pytest

import linkside
from linkside import AccelerationObserver, Estimate, Log, Robot

ROOT = Path(__file__).parents[2]
DATA = ROOT / "tests/data"
PAGES = sorted((ROOT / "docs").rglob("*.md"))
DOCUMENTS = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *PAGES]


def blocks(document, language):
    return re.findall(rf"^```{language}\n(.*?)^```", document.read_text(), re.MULTILINE | re.DOTALL)


def with_blocks(language):
    """Pages with code; tutorials, which are followed block by block, have a test of their own."""
    found = [d for d in DOCUMENTS if blocks(d, language) and d.parent.name != "tutorials"]
    return [pytest.param(d, id=str(d.relative_to(ROOT))) for d in found]


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


def prose(document):
    """A document's text without its blocks of code."""
    return re.sub(r"^```.*?^```", "", document.read_text(), flags=re.MULTILINE | re.DOTALL)


def anchors(document):
    """What headings are linked by, here, on GitHub and on the site."""
    headings = re.findall(r"^#+ (.*)$", prose(document), re.MULTILINE)
    plain = (re.sub(r"[^\w\s-]", "", heading).strip().lower() for heading in headings)
    return {re.sub(r"[\s-]+", "-", heading) for heading in plain}


@pytest.mark.parametrize("document", [pytest.param(d, id=str(d.relative_to(ROOT))) for d in DOCUMENTS])
def test_links_lead_somewhere(document):
    for target, anchor in re.findall(r"\]\((?!http)([^)#]*)(?:#([^)]*))?\)", prose(document)):
        page = document.parent / target if target else document
        assert page.exists(), target
        assert not anchor or anchor in anchors(page), f"{target}#{anchor}"
        if document in PAGES:
            assert page.resolve().is_relative_to(ROOT / "docs"), f"{target} is not part of the site"


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


def test_readme_is_short():
    assert len(DOCUMENTS[0].read_text().splitlines()) <= 120


def test_figures_are_the_same_on_every_page():
    """Tool errors with default settings stand in four tables; what each recording's row says is the same in all."""

    def table(name, heading):
        text = (ROOT / name).read_text()
        rows = text[text.index(heading) :].split("\n\n")[0].splitlines()[2:]
        return {re.match(r"\| (\w+)", row)[1]: re.findall(r"[\d.]+(?= [|/])", row.split("|", 2)[2]) for row in rows}

    readme = table("README.md", "| recording | EKF")
    choose = table("docs/choose.md", "| recording | motors")
    kalman = table("docs/kalman.md", "| recording | defaults")
    elastic = table("docs/elastic.md", "| recording | acceleration-driven")
    assert len(readme) == 5
    for name, (ekf, smoother, motors, observer) in readme.items():
        assert choose[name][:4] == [motors, observer, ekf, smoother], name
        assert elastic[name][:2] == [ekf, smoother], name
        assert choose[name][4:] == elastic[name][2:4], name
        assert [f"{float(x):.{len(y) - 2}f}" for x, y in zip(kalman[name], (ekf, smoother), strict=False)] == [
            ekf,
            smoother,
        ], name
