"""The site leads to every page and every public name, and its formulas can be drawn."""

import pkgutil
import re
from pathlib import Path

import pytest

import linkside

ROOT = Path(__file__).parents[2]
PAGES = sorted((ROOT / "docs").rglob("*.md"))
BUILT = "rust/"  # by rustdoc, not from a page


def test_every_page_is_in_the_navigation_once():
    navigation = (ROOT / "mkdocs.yml").read_text().partition("\nnav:\n")[2].partition("\n\n")[0]
    entries = re.findall(r"([\w/.-]+\.(?:md|html))$", navigation, re.MULTILINE)
    listed = sorted(entry for entry in entries if not entry.startswith(BUILT))
    assert listed == sorted(str(page.relative_to(ROOT / "docs")) for page in PAGES)


def test_every_public_name_is_described():
    text = "".join(page.read_text() for page in sorted((ROOT / "docs/api").glob("*.md")))
    described = re.findall(r"^::: ([\w.]+)$", text, re.MULTILINE)
    assert len(described) == len(set(described))
    for name in described:
        pkgutil.resolve_name(name)
    missing = {f"linkside.{name}" for name in linkside.__all__} - set(described)
    assert missing == {"linkside.control", "linkside.demo"}  # its parts are described; the data of the demo


@pytest.mark.parametrize("page", [pytest.param(p, id=str(p.relative_to(ROOT))) for p in PAGES])
def test_pictures_are_there_and_say_what_they_show(page):
    for words, target in re.findall(r"!\[(.*?)\]\((.*?)\)", page.read_text()):
        assert (page.parent / target).is_file(), target
        assert len(words) > 20, f"{target}: a reader who cannot see it learns nothing from {words!r}"


def test_formulas_can_be_drawn():
    converter = pytest.importorskip("latex2mathml.converter")
    for page in PAGES:
        for formula in re.findall(r"^```math\n(.*?)^```", page.read_text(), re.MULTILINE | re.DOTALL):
            drawn = converter.convert(formula.strip(), display="block")
            left = re.search(r"<m[a-z]*>\\[A-Za-z]+</m", drawn)
            assert left is None, f"{page.name}: {left.group()}"
