"""Disks that are full or break, and processes that are killed: each file is whole or as it was, the next run succeeds.

Each call of a command that opens, writes, syncs or renames a file fails in turn: for want of space, by a broken disk,
by a signal; it writes half of what it should; or the process is killed in it.
"""

import random
import time

import numpy as np
import pytest

from .faults import FAULTS, KILLED, Disk
from .writers import COMMANDS, MANIFEST, MODULES, PROGRAMS, lasting, make_inputs, words

OLD = b"what was there before\n"

DONE, FAILED = (0, 3), (1, 2)
"""Exit status of a run that has written all, and of one that has not."""

QUICK = ("compile", "estimate")
"""A command for each of the two ways of writing."""


@pytest.fixture(scope="module")
def disk(tmp_path_factory):
    with Disk(tmp_path_factory.mktemp("faults"), MODULES) as disk:
        yield disk


@pytest.fixture(scope="module")
def small_disk(tmp_path_factory):
    """For commands that need little of linkside; Arrow looks for pandas."""
    with Disk(tmp_path_factory.mktemp("faults"), ["linkside.cli.estimating", "pandas"]) as disk:
        yield disk


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    return make_inputs(tmp_path_factory.mktemp("inputs"))


class Trial:
    """A command, and what it writes on a sound disk: files, calls of each kind, and how long it takes."""

    def __init__(self, disk, words):
        self.disk, self.words = disk, words
        disk.put({})
        began = time.monotonic()
        ended = disk.run(words)
        self.duration = time.monotonic() - began
        assert ended.status in DONE, ended.said
        self.calls = disk.seen
        self.new = same(ended.files)
        replaced = [] if "init" in words else [name for name in self.new if name != MANIFEST]  # that is also read
        self.old = dict.fromkeys(replaced, lasting("", OLD))
        assert self.new

    def faults(self, most):
        """Every kind of fault of every kind of call: at the last, the first, and some between."""
        for call, count in self.calls.items():
            for at in sorted({round(at) for at in np.linspace(count, 1, min(count, most))}):
                yield from ((call, at, fault) for fault in FAULTS if call == "write" or fault != "short")

    def run(self, fault=None, kill=None):
        """Run over older files, with a fault or killed; then once more without."""
        self.disk.put(dict.fromkeys(self.old, OLD))
        ended = self.disk.run(self.words, fault and (*fault[:2], FAULTS[fault[2]]), kill)
        left = hidden(ended.files)
        found = same({name: content for name, content in ended.files.items() if name not in left})
        self.check(found)
        if ended.status != KILLED:
            assert left == []
            assert ended.status in (*DONE, *FAILED), ended.said
        if ended.status in DONE:
            assert found == self.new, "it says that all is well"
        if ended.status in FAILED:
            assert ended.said.splitlines()[-1].startswith("linkside: ")
            assert "Traceback" not in ended.said
        if left or found != self.new:
            again = self.disk.run(self.words)
            assert again.status in DONE, again.said
            assert same(again.files) == self.new, "what a run left is in the way of the next"
        return ended.status

    def check(self, files):
        """Every file is as it was or as it is to be, and nothing else is there but where to resume."""
        assert self.old.keys() <= files.keys()
        for name, content in files.items():
            if name != MANIFEST and not name.endswith(".partial"):  # what failed, and where to resume
                assert content in (self.old.get(name), self.new[name]), f"{name} is half written"


def same(files):
    """Files, as far as they are the same in every run."""
    return {name: lasting(name, content) for name, content in files.items()}


def hidden(files):
    """Temporary files, beside outputs or in the system's folder."""
    return [name for name in files if name.startswith(("tmp/", ".")) or "/." in name]


@pytest.mark.parametrize("name", QUICK)
def test_a_call_that_fails_leaves_each_file_whole_or_as_it_was(small_disk, inputs, name):
    trial = Trial(small_disk, words(name, inputs))
    ended = {(call, fault): trial.run((call, at, fault)) for call, at, fault in trial.faults(1)}
    assert ended["write", "no space"] == ended["sync", "broken"] == ended["rename", "no space"] == 2
    assert ended["write", "short"] == ended["write", "interrupted"] == 0
    assert ended["write", "killed"] == KILLED


@pytest.mark.slow
@pytest.mark.parametrize("name", [*COMMANDS, *PROGRAMS])
def test_every_command_that_writes(disk, inputs, name):
    trial = Trial(disk, words(name, inputs))
    for fault in trial.faults(4):
        trial.run(fault)


@pytest.mark.slow
def test_runs_that_are_killed_at_200_random_moments(disk, inputs):
    draw = random.Random(0)
    killed = 0
    for name in [*COMMANDS, *PROGRAMS]:
        trial = Trial(disk, words(name, inputs))
        killed += sum(trial.run(kill=draw.uniform(0, trial.duration)) == KILLED for _ in range(10))
    assert killed > 100
