"""The targets of fuzzing in Python, on their corpus and on mutants of it: the same ones in every run."""

import random
import re
import sys
from pathlib import Path

import pytest

FUZZ = Path(__file__).parents[2] / "fuzz"
sys.path.append(str(FUZZ / "python"))

from targets import TARGETS  # noqa: E402

MUTANTS = 40


def corpus(name):
    """What fuzzing found worth keeping, in the order of names."""
    return [path.read_bytes() for path in sorted((FUZZ / "corpus" / name).iterdir())]


def mutate(draw, content, other):
    """Change, remove, double or append some bytes, or change a digit."""
    content = bytearray(content)
    for _ in range(draw.randint(1, 4)):
        start = draw.randrange(len(content) + 1)
        end = min(len(content), start + draw.randint(1, 8))
        digits = [found.start() for found in re.finditer(rb"[0-9]", content)]
        match draw.randrange(6):
            case 0:
                del content[start:]
            case 1:
                del content[start:end]
            case 2:
                content[start:start] = content[start:end]
            case 3:
                content += other[draw.randrange(len(other) + 1) :]
            case 4 if digits:
                content[draw.choice(digits)] = draw.choice(b"0123456789.-eE_ ")
            case _:
                content[start:end] = draw.randbytes(end - start)
    return bytes(content)


@pytest.mark.parametrize("name", TARGETS)
def test_targets_hold_on_their_corpus_and_on_mutants_of_it(name):
    seeds, draw = corpus(name), random.Random(7)
    assert seeds
    for seed in seeds:
        TARGETS[name](seed)
    for _ in range(MUTANTS):
        TARGETS[name](mutate(draw, draw.choice(seeds), draw.choice(seeds)))


def test_every_target_has_a_binary_and_a_corpus():
    rust = re.findall(r'^    \("(\w+)",', (FUZZ / "src/lib.rs").read_text(), flags=re.MULTILINE)
    binaries = re.findall(r'^name = "(\w+)"', (FUZZ / "Cargo.toml").read_text(), flags=re.MULTILINE)
    assert binaries == rust
    assert {path.name for path in (FUZZ / "corpus").iterdir()} == {*rust, *TARGETS}
    assert len(rust) + len(TARGETS) >= 14
