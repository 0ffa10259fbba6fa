"""Write THIRD-PARTY-LICENSES.txt, the licences of all crates that are part of the wheel: `make licences`.

Licences ask that their text goes with the binary. The file is renewed with the lock file; a test holds it to that.
"""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
FILE = ROOT / "THIRD-PARTY-LICENSES.txt"
TEXTS = ("LICEN[CS]E*", "COPYING*", "NOTICE*", "COPYRIGHT*")
RULE = "=" * 100


def cargo(*arguments: str) -> str:
    """What a command of Cargo prints."""
    done = subprocess.run(["cargo", *arguments, "--locked"], cwd=ROOT, check=True, capture_output=True, text=True)
    return done.stdout


def linked() -> list[tuple[str, str]]:
    """Names and versions of the crates that are compiled into the extension, on any platform; macros leave no code."""
    tree = cargo("tree", "-p", "linkside-py", "-e", "normal,no-proc-macro", "--target", "all", "--prefix", "none")
    crates = {tuple(line.split()[:2]) for line in tree.splitlines() if "(/" not in line}
    return sorted((name, version.removeprefix("v")) for name, version in crates)


def texts(folder: Path) -> list[str]:
    """The licences that a crate brings, without blanks at the ends."""
    files = sorted({path for pattern in TEXTS for path in folder.glob(pattern) if path.is_file()})
    return ["\n".join(line.rstrip() for line in path.read_text("utf-8").splitlines()).strip() for path in files]


def written(crates: list[tuple[str, str]], packages: dict[tuple[str, str], dict[str, Any]]) -> str:
    """The file: what is whose, then each text once with the crates that it came with."""
    owners: dict[str, list[str]] = {}
    lines = ["The Python extension of linkside contains code of these crates, under these licences:", ""]
    for crate in crates:
        package, name = packages[crate], " ".join(crate)
        lines.append(f"{name}: {package['license']}; {package['repository'] or 'crates.io'}")
        for text in texts(Path(package["manifest_path"]).parent):
            owners.setdefault(text, []).append(name)
    for text, names in owners.items():
        lines += ["", RULE, f"With {', '.join(names)}:", "", text]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Write the file."""
    metadata = json.loads(cargo("metadata", "--format-version", "1"))
    packages = {(package["name"], package["version"]): package for package in metadata["packages"]}
    FILE.write_text(written(linked(), packages), "utf-8")


if __name__ == "__main__":
    main()
