"""Draws the pictures of the papers' pages: one of each example's figures. Takes a few minutes."""

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).parent
EXAMPLES = HERE.parents[1] / "examples"
PICTURES = {
    "elastic_control": "control_short",
    "space_robot": "tool_path",
    "square_path": "error",
    "velocity_two_links": "bounded",
}


def main() -> None:
    """Run each example, and keep its picture."""
    for example, picture in PICTURES.items():
        with tempfile.TemporaryDirectory() as folder:
            subprocess.run([sys.executable, EXAMPLES / f"{example}.py", "--out", folder], check=True)
            shutil.copy(Path(folder) / f"{picture}.png", HERE / f"{example}.png")


if __name__ == "__main__":
    main()
