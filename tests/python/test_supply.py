"""What the wheel is made of: licences that allow to give it on, crates of one registry, and no more unsafe code."""

import json
import re
import runpy
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

ALLOWED = set(re.findall(r'^    "(.+)",$', (ROOT / "deny.toml").read_text(), flags=re.MULTILINE))

UNSAFE = {"capi": 65, "core": 4}
"""Times that `unsafe` stands in a crate: pointers from C, and calls of functions compiled for other instructions."""


@pytest.fixture(scope="module")
def packages():
    cargo = shutil.which("cargo") or pytest.skip("no cargo")
    command = [cargo, "metadata", "--locked", "--format-version", "1"]
    done = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True)
    return [package for package in json.loads(done.stdout)["packages"] if package["source"]]


def may(licence):
    """Whether an expression of SPDX, of `AND` and `OR` as crates have them, allows what is allowed here."""
    parts = licence.replace("(", "").replace(")", "").replace("/", " OR ").split(" AND ")
    return all(ALLOWED & set(part.split(" OR ")) for part in parts)


def test_licences_are_among_those_that_are_allowed(packages):
    assert [f"{package['name']}: {package['license']}" for package in packages if not may(package["license"])] == []
    assert not may("GPL-3.0-only")
    assert not may("MIT AND GPL-3.0-only")


def test_crates_come_from_one_registry(packages):
    assert {package["source"] for package in packages} == {"registry+https://github.com/rust-lang/crates.io-index"}


def test_the_wheel_brings_the_licences_of_its_crates(packages):
    linked = runpy.run_path(str(ROOT / "docs/licences.py"))["linked"]()
    listed, *found = re.split(r"^=+$", (ROOT / "THIRD-PARTY-LICENSES.txt").read_text("utf-8"), flags=re.MULTILINE)
    names = [" ".join(crate) for crate in linked]
    assert re.findall(r"^(\S+ \d[^:]*): ", listed, re.MULTILINE) == names, "make licences"
    owners = {name for part in found for name in re.match(r"\s*With (.*):", part)[1].split(", ")}
    assert owners == set(names), "each has a text"
    assert "THIRD-PARTY-LICENSES.txt" in (ROOT / "pyproject.toml").read_text()


def test_unsafe_code_does_not_grow():
    found = {}
    for crate in sorted((ROOT / "rust").iterdir()):
        code = "\n".join(re.sub("//.*", "", path.read_text()) for path in crate.rglob("*.rs"))
        if count := len(re.findall(r"\bunsafe\b", code)):
            found[crate.name] = count
    assert found == UNSAFE, "less is good, and to be written here; more wants a reason"
