"""Commands on a disk that is full or breaks, or in a process that is killed: `tests/c/faults.c` lets calls fail.

A process imports linkside once, with that library loaded, and is forked for each run, so that a run takes no longer
than the command itself.
"""

import ctypes
import errno
import json
import mmap
import os
import shutil
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

CALLS = ("open", "write", "sync", "rename")
ERRNO, FULL, SHORT, KILL = range(4)

FAULTS = {
    "no space": (FULL, 0),
    "broken": (ERRNO, errno.EIO),
    "interrupted": (ERRNO, errno.EINTR),
    "short": (SHORT, 0),
    "killed": (KILL, 0),
}

SERVER = """
import importlib, json, os, signal, sys, time, traceback
import linkside, linkside.cli
for name in sys.argv[1:]:
    importlib.import_module(name)
EXITED = os.WEXITED | os.WNOHANG | os.WNOWAIT
print("ready", flush=True)
for line in sys.stdin:
    job = json.loads(line)
    child = os.fork()
    if not child:
        os.chdir(job["folder"])
        said = os.open(job["said"], os.O_CREAT | os.O_TRUNC | os.O_WRONLY)
        os.dup2(said, 1), os.dup2(said, 2)
        try:
            exec(job["words"]) if isinstance(job["words"], str) else linkside.cli.main(job["words"])
        except SystemExit as exit:
            sys.stdout.flush(), sys.stderr.flush()
            os._exit(exit.code or 0)
        except linkside.LinksideError as error:
            print(f"linkside: {error}", flush=True)
            os._exit(2)
        except BaseException:
            traceback.print_exc()
            sys.stderr.flush()
            os._exit(70)
        os._exit(0)
    end = time.monotonic() + (job["kill"] or 0.0)
    while job["kill"] is not None and time.monotonic() < end and not os.waitid(os.P_PID, child, EXITED):
        time.sleep(0.0005)
    if job["kill"] is not None:
        os.kill(child, signal.SIGKILL)  # an ended child is not yet reaped: no other process has its number
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""


class Plan(ctypes.Structure):
    """What is to fail, as `struct plan` of the library."""

    _fields_ = (
        ("call", ctypes.c_int32),
        ("way", ctypes.c_int32),
        ("error", ctypes.c_int32),
        ("unused", ctypes.c_int32),
        ("at", ctypes.c_int64),
        ("seen", ctypes.c_int64 * len(CALLS)),
        ("folder", ctypes.c_char * 4096),
    )


@dataclass(frozen=True)
class Ended:
    """How a run ended: exit status (negative: by a signal), what it said, and what it left."""

    status: int
    said: str
    files: dict[str, bytes]


class Disk:
    """Runs commands in a folder of its own, and lets a call of theirs fail.

    Parameters
    ----------
    place
        A folder for all that this needs.
    modules
        Imported before the first run rather than in each.

    Attributes
    ----------
    folder
        Where commands run; `put` empties it.
    """

    def __init__(self, place, modules=()):
        if not sys.platform.startswith("linux"):
            pytest.skip("LD_PRELOAD is of Linux")
        compiler = shutil.which("cc") or pytest.skip("no C compiler")
        library, plan = place / "faults.so", place / "plan"
        source = Path(__file__).parents[1] / "c/faults.c"
        flags = ["-O1", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC"]
        subprocess.run([compiler, *flags, source, "-o", library, "-ldl"], check=True)
        self.folder, self._said = place / "disk", place / "said"
        plan.write_bytes(bytes(ctypes.sizeof(Plan)))
        with plan.open("r+b") as file:
            self._plan = Plan.from_buffer(mmap.mmap(file.fileno(), 0))
        self.environment = os.environ | {
            "LD_PRELOAD": str(library),
            "LINKSIDE_FAULTS": str(plan),
            "TMPDIR": str(self.folder / "tmp"),
            "OPENBLAS_NUM_THREADS": "1",
            "MPLBACKEND": "agg",
            "SOURCE_DATE_EPOCH": "0",
            "COLUMNS": "200",
        }
        self._modules = modules
        self._server = None

    def __enter__(self):
        command = [sys.executable, "-W", "ignore", "-c", SERVER, *self._modules]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
        self._server = subprocess.Popen(command, env=self.environment, **pipes)
        assert self._server.stdout.readline() == "ready\n"
        return self

    def __exit__(self, *_):
        self._server.communicate()

    def put(self, files):
        """Empty the folder, and put files there."""
        shutil.rmtree(self.folder, ignore_errors=True)
        (self.folder / "tmp").mkdir(parents=True)
        for name, content in files.items():
            (self.folder / name).parent.mkdir(exist_ok=True)
            (self.folder / name).write_bytes(content)

    def run(self, words, fault=None, kill=None):
        """Run a command, or a Python program (one string).

        ``fault`` is a kind of call, its number from 1, and what happens to it; ``kill`` is when to kill the run [s].
        """
        self.arm(fault)
        job = {"folder": str(self.folder), "said": str(self._said), "words": words, "kill": kill}
        self._server.stdin.write(json.dumps(job) + "\n")
        self._server.stdin.flush()
        status = int(self._server.stdout.readline())
        return Ended(status, self._said.read_text(), self.files())

    def arm(self, fault):
        """Let a call fail from now on, counted from here."""
        call, at, (way, error) = fault or (None, 0, (ERRNO, 0))
        self._plan.call = -1 if call is None else CALLS.index(call)
        self._plan.at, self._plan.way, self._plan.error = at, way, error
        self._plan.seen = type(self._plan.seen)()
        self._plan.folder = str(self.folder).encode()

    @property
    def seen(self):
        """How many calls of each kind there were."""
        return dict(zip(CALLS, self._plan.seen, strict=True))

    def files(self):
        """All that is there, hidden files too."""
        inside = (path for path in self.folder.rglob("*") if path.is_file())
        return {str(path.relative_to(self.folder)): path.read_bytes() for path in inside}


KILLED = -signal.SIGKILL
