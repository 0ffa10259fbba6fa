"""What is published names its repository, and the workflow that publishes it is sound."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from ruamel.yaml import YAML

ROOT = Path(__file__).parents[2]

WORKFLOW = ROOT / ".github/workflows/release.yml"

ADDRESS = "https://github.com/someone/linkside"


@pytest.fixture(scope="module")
def published(tmp_path_factory):
    """The files that are changed, changed."""
    clone = tmp_path_factory.mktemp("clone")
    for path in (*ROOT.glob("rust/*/Cargo.toml"), *map(ROOT.joinpath, ("README.md", "pyproject.toml"))):
        copy = clone / path.relative_to(ROOT)
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(path, copy)
    subprocess.run([sys.executable, ROOT / "docs/published.py", ADDRESS, "v1.2.3"], cwd=clone, check=True)
    return clone


def test_links_and_pictures_of_the_readme_are_absolute(published):
    text = (published / "README.md").read_text()
    assert f"({ADDRESS}/raw/v1.2.3/docs/tool_error.svg)" in text
    assert f"({ADDRESS}/blob/v1.2.3/docs/files.md)" in text
    assert "](docs/" not in text
    before = (ROOT / "README.md").read_text()
    assert text.count("](") == before.count("](")
    assert text.count("](#") == before.count("](#")


def test_packages_name_the_repository(published):
    project = (published / "pyproject.toml").read_text()
    assert f'[project.urls]\nRepository = "{ADDRESS}"\n' in project
    for crate in published.glob("rust/*/Cargo.toml"):
        assert crate.read_text().count(f'repository = "{ADDRESS}"\n') == 1


def test_only_publishing_may_write():
    workflow = YAML(typ="safe").load(WORKFLOW.read_text())
    assert workflow["permissions"] == {"contents": "read"}
    writing = {name for name, job in workflow["jobs"].items() if "permissions" in job}
    assert writing == {"publish"}
    assert workflow["jobs"]["publish"]["needs"] == [name for name in workflow["jobs"] if name != "publish"]
    names = [row["name"] for row in workflow["jobs"]["wheels"]["strategy"]["matrix"]["include"]]
    assert len(set(names)) == len(names)


def test_what_the_workflow_calls_is_there():
    text = WORKFLOW.read_text()
    for path in ("docs/published.py", "examples/controller.cpp"):
        assert path in text
        assert (ROOT / path).is_file()
    assert "\ninstall-c:" in (ROOT / "Makefile").read_text()
