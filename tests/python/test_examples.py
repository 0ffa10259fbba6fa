"""The examples run as they are, and come to what the documents say."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]


def test_velocity_noise(tmp_path):
    command = [sys.executable, ROOT / "examples/velocity_noise.py", "arm2_square"]
    done = subprocess.run(command, check=True, capture_output=True, text=True, cwd=tmp_path)
    found = re.findall(r"^  (\w+).* ([\d.]+) mrad/s at", done.stdout, re.MULTILINE)
    errors = {name: min(float(error) for other, error in found if other == name) for name, _ in found}
    assert errors["ReducedOrderObserver"] < errors["Kalman"] / 4 < errors["difference"] / 8
    document = (ROOT / "docs/velocity.md").read_text()
    stated = re.search(r"reduced-order, exact model \| \*\*([\d.]+)\*\*", document)
    assert float(stated.group(1)) == pytest.approx(errors["ReducedOrderObserver"], abs=0.02)


def test_constraints():
    done = subprocess.run(
        [sys.executable, ROOT / "examples/constraints.py"], check=True, capture_output=True, text=True
    )
    limited, first, second = (np.abs(list(map(float, line[34:].split()))) for line in done.stdout.splitlines()[1:])
    assert limited[0] > 0.05
    assert limited[1:].max() < 0.04
    assert first[1:].max() < 0.02
    assert second[0] > 0.5
    assert second[1:].max() < 0.02


def test_coulomb():
    done = subprocess.run([sys.executable, ROOT / "examples/coulomb.py"], check=True, capture_output=True, text=True)
    rows = [re.findall(r"([\d.]+) \(([\d.]+)\)", line) for line in done.stdout.splitlines()[1:]]
    kalman, particles, wide = (np.array(row, float) for row in rows)
    assert len(kalman) == 3
    assert (kalman[:, 0] > 80).all()
    assert (wide[:, 0] > 50).all()
    assert (particles[:, 0] < 30).all()
    assert (particles[:, 1] < kalman[:, 1]).all()
