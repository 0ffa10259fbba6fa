"""Environments of their own for peers that cannot be installed beside the others; made once, under target."""

import subprocess
import sys
from pathlib import Path

HOME = Path(__file__).parents[2] / "target/peers"


def interpreter(name: str, *requirements: str) -> Path | None:
    """Python with these packages and what they need; None where they cannot be had, as without a network."""
    folder = HOME / f"{name}-{sys.version_info.major}.{sys.version_info.minor}"
    python = folder / "bin/python"
    complete = folder / "complete"
    if complete.exists():
        return python
    make = [sys.executable, "-m", "venv", "--clear", str(folder)]
    fill = [str(python), "-m", "pip", "install", "--quiet", "--retries", "1", "--timeout", "10", *requirements]
    try:
        for command in (make, fill):
            subprocess.run(command, check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    complete.touch()
    return python
