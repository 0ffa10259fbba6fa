"""Name the repository in what is published: `python docs/published.py https://github.com/OWNER/NAME v1.2.3`.

PyPI and crates.io show README without the files beside it, so that its links and pictures must be absolute there.
The clone keeps relative ones, which are right on any branch.
"""

import re
import sys
from pathlib import Path

PICTURES = (".svg", ".png")

RELATIVE = re.compile(r"(\]\()(?!https?://|#|mailto:)([^)\s]+)\)")
"""Beginning and target of a link of Markdown to a file."""


def absolute(text: str, address: str, version: str) -> str:
    """Markdown with absolute links, to the files as they are at a tag."""

    def link(found: re.Match[str]) -> str:
        kind = "raw" if found[2].endswith(PICTURES) else "blob"
        return f"{found[1]}{address}/{kind}/{version}/{found[2]})"

    return RELATIVE.sub(link, text)


def publish(folder: Path, address: str, version: str) -> None:
    """Change the files of a clone."""
    readme = folder / "README.md"
    readme.write_text(absolute(readme.read_text(encoding="utf-8"), address, version), encoding="utf-8")
    urls = {
        "Repository": address,
        "Documentation": f"{address}/blob/{version}/docs/index.md",
        "Changelog": f"{address}/blob/{version}/CHANGELOG.md",
        "Issues": f"{address}/issues",
    }
    project = folder / "pyproject.toml"
    table = "".join(f'{name} = "{url}"\n' for name, url in urls.items())
    text = project.read_text(encoding="utf-8").replace(
        "[project.scripts]", f"[project.urls]\n{table}\n[project.scripts]"
    )
    project.write_text(text, encoding="utf-8")
    for crate in folder.glob("rust/*/Cargo.toml"):
        licence = "license.workspace = true\n"
        crate.write_text(crate.read_text().replace(licence, f'{licence}repository = "{address}"\n'))


if __name__ == "__main__":
    publish(Path(), sys.argv[1].rstrip("/"), sys.argv[2])
