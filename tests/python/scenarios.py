"""Scenarios: what an estimator is given step by step and what it must answer, to the last bit, for all languages.

``python tests/python/scenarios.py LIBRARY`` writes `tests/data/scenarios` with the C library. A number is its bits, in
sixteen hexadecimal digits, so that every language reads the same one.
"""

import ctypes
import json
import random
import struct
import sys
from pathlib import Path

DATA = Path(__file__).parents[1] / "data"
SCENARIOS = DATA / "scenarios"
SIGNALS = ("theta", "dtheta", "tau", "acceleration", "rate", "q", "dq", "ddq", "torque", "ddqref", "wrench", "position")
ESTIMATES = ("t", "q", "dq", "ddq", "theta", "dtheta", "q_std", "tool_position", "tool_std", "nis")
STEPS = 60


class Sample(ctypes.Structure):
    """`LinksideSample`."""

    _fields_ = (("dt", ctypes.c_double), *((name, ctypes.POINTER(ctypes.c_double)) for name in SIGNALS))


class Estimator:
    """An estimator of the C library."""

    def __init__(self, library, content):
        self.c = ctypes.CDLL(str(library))
        self.c.linkside_values.restype = ctypes.POINTER(ctypes.c_double)
        self.c.linkside_width.restype = self.c.linkside_joints.restype = ctypes.c_size_t
        self.c.linkside_status.restype = ctypes.c_uint8
        self.held = ctypes.c_void_p()
        assert self.c.linkside_from_bytes(content, ctypes.c_size_t(len(content)), ctypes.byref(self.held)) == 0

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.c.linkside_free(self.held)

    def width(self, signal):
        """How many numbers of a signal it reads."""
        return self.c.linkside_width(self.held, signal.encode())

    def step(self, given):
        """Take a step as a scenario has it; gives the answer as a scenario has it."""
        if given.get("reset"):
            self.c.linkside_reset(self.held)
        arrays = {name: (ctypes.c_double * len(bits))(*map(number, bits)) for name, bits in given["signals"].items()}
        sample = Sample(
            number(given["dt"]), **{n: ctypes.cast(a, ctypes.POINTER(ctypes.c_double)) for n, a in arrays.items()}
        )
        taken = self.c.linkside_step(self.held, ctypes.byref(sample)) == 0
        answer = {"taken": taken, "status": self.c.linkside_status(self.held) if taken else 0}
        return answer | ({name: self.values(name) for name in ESTIMATES if self.values(name)} if taken else {})

    def values(self, name):
        """A part of the estimate, in bits."""
        length = ctypes.c_size_t()
        found = self.c.linkside_values(self.held, name.encode(), ctypes.byref(length))
        return [bits(found[i]) for i in range(length.value)] if found else []


def bits(value):
    """A number in hexadecimal digits; every NaN is the same."""
    return struct.pack(">d", value if value == value else float("nan")).hex()


def number(digits):
    """The number of those digits."""
    return struct.unpack(">d", bytes.fromhex(digits))[0]


def write(library):
    """Write a scenario for each compiled robot: motion, missing readings, refused ones, resets."""
    SCENARIOS.mkdir(exist_ok=True)
    for path in sorted((DATA / "compiled").glob("*.lsr")):
        draw = random.Random(path.stem)
        with Estimator(library, path.read_bytes()) as estimator:
            widths = {name: estimator.width(name) for name in SIGNALS if estimator.width(name)}
            steps = []
            for index in range(STEPS):
                signals = {
                    name: [reading(draw, name, index, i) for i in range(width)]
                    for name, width in widths.items()
                    if name == "theta" or draw.random() < 0.95
                }
                given = {"dt": bits(1e-3), "signals": {name: [bits(x) for x in row] for name, row in signals.items()}}
                steps.append(given | ({"reset": True} if index == 40 else {}))
            answers = [estimator.step(given) for given in steps]
        content = {"steps": steps, "answers": answers}
        rows = {name: ",\n".join(map(json.dumps, content[name])) for name in ("steps", "answers")}
        parts = ",\n".join(f'"{name}": [\n{lines}\n]' for name, lines in rows.items())
        (SCENARIOS / f"{path.stem}.json").write_text(f'{{"estimator": "{path.name}",\n{parts}}}\n')


def reading(draw, name, index, channel):
    """A reading of a robot that sways; now and then one that is missing, wrong or infinite."""
    if index > 2 and draw.random() < 0.04:
        return draw.choice([float("nan"), float("nan"), 7.0, float("inf")])
    offset = {"acceleration": (0.0, 0.0, 9.8)[channel % 3], "tau": 300.0}.get(name, 0.3 * channel)
    size = {"acceleration": 0.5, "tau": 50.0}.get(name, 1e-3)
    return offset + size * (draw.random() - 0.5) + 1e-3 * index * (name in ("theta", "q"))


if __name__ == "__main__":
    write(Path(sys.argv[1]))
