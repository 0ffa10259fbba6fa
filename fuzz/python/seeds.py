"""The first inputs of each target: what is right, for mutations to make wrong.

``python fuzz/python/seeds.py`` writes them into `fuzz/corpus`; what fuzzing adds lies beside them.
"""

import io
import random
import struct
import sys
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))

from targets import CSV, DATA, WORDS  # noqa: E402
from tests.python import bags  # noqa: E402

CORPUS = ROOT / "fuzz/corpus"


def plain(seed, count):
    """Bytes that targets read as plain numbers and steps."""
    draw = random.Random(seed)
    return bytes(draw.randrange(16, 240) for _ in range(count))


def block(content):
    """A block with its length before it."""
    return struct.pack("<H", len(content)) + content


def bag(folder, storage, mode):
    """The bytes of a bag with joints and an IMU."""
    joints = [(t, "/joints", bags.joint_state(t, ["axis2", "axis3"], [0.1, 0.2], [0.0, 0.1])) for t in range(0, 9, 3)]
    imu = [(t, "/imu", bags.imu(t, (0.0, 0.1, 9.8))) for t in range(1, 9, 3)]
    path = bags.write(folder / f"{storage}-{mode}", sorted(joints + imu, key=lambda one: one[0]), storage, mode)
    return next(file for file in path.iterdir() if file.suffix in (".mcap", ".db3")).read_bytes()


def message(names, positions):
    """A message of the definition in `bags.rs`, in CDR."""
    data = b"\0\1\0\0" + struct.pack("<IIIc", 1, 2, 1, b"\0") + b"\0\0\0" + struct.pack("<I", len(names))
    for name in names:
        data += struct.pack("<I", len(name) + 1) + name.encode() + b"\0"
        data += bytes(-(len(data) - 4) % 4)
    data += struct.pack("<I", len(positions))
    data += bytes(-(len(data) - 4) % 8) + struct.pack(f"<{len(positions)}d", *positions)
    part = struct.pack("<I", 2) + b"a\0\0\0" + struct.pack("<2fI", 1.0, 2.0, 0)
    data += struct.pack("<I", 1) + part
    return data + bytes(-(len(data) - 4) % 8) + struct.pack("<qI", 7, 1) + b"w\0"


def seeds(folder):
    """Target, name, content."""
    definition = b"float64[] position\nstring[] name\ngeometry_msgs/Point p\n===\nMSG: geometry_msgs/Point\nfloat64 x\n"
    text = block(b"own_msgs/msg/All") + block(b"p.x") + block(b"")
    yield "definition", "point", text + block(definition) + b"\1" + block(message(["a"], [1.0]))
    yield "definition", "names", block(b"a/msg/B") + block(b"position") + block(b"name") + block(definition) + b"\0"
    for name, names in {"two": ["a", "b"], "none": []}.items():
        yield "cdr", name, b"\1" + block(message(names, [0.5] * len(names))) * 2
        yield "compressed", name, b"\1" + block(message(names, [0.5] * len(names)))
    for mode in ("none", "message", "storage"):
        yield "mcap", mode, bag(folder, "mcap", mode)
    yield "database", "rows", bag(folder, "sqlite3", "none")
    for file in (ROOT / "tests/data/compiled").iterdir():
        content = file.read_bytes()
        yield "compiled_file", file.stem, content
        yield "compiled_content", file.stem, content[20:-4]
    for target in ("description", "step_observer", "step_ekf", "step_elastic", "step_velocity", "run_filter"):
        for seed, count in enumerate((60, 400, 1500)):
            yield target, str(count), plain(seed, count)
    for target in ("run_smoother", "run_particles", "dynamics", "c_interface", "kernels", "recordings", "steps"):
        for seed, count in enumerate((60, 300, 900)):
            yield target, str(count), plain(seed, count)
    yield "urdf", "arm", (DATA / "robot.urdf").read_bytes()
    yield "robot_yaml", "arm", (DATA / "robot.yaml").read_bytes()
    yield (
        "robot_yaml",
        "more",
        (DATA / "robot.yaml").read_bytes()
        + (
            b"  rpy: [0, 0, 0]\ncoupling: {axis2: {axis3: 0.1}}\ngravity: [0, 0, -9.81]\ncolumns: {motor_side: true}\n"
            b"tolerances: {stiffness: 0.1}\nunits: {theta: deg}\n"
        ),
    )
    yield "noise_yaml", "all", b"jerk: [15.0, 12.0]\nacceleration: 0.05\ntransmission: 1e-4\n"
    yield "csv", "comma", CSV
    yield "csv", "german", CSV.replace(b",", b";").replace(b".", b",")
    yield "estimate_file", "csv", b"t,q_axis2,q_axis3,dq_axis2,dq_axis3,status\n0,0.1,0.2,0,0,0\n0.001,0.1,0.2,0,0,8\n"
    rows = [[float(cell) for cell in line.split(",")] for line in CSV.decode().split("\n")[1:]]
    columns = dict(zip(CSV.decode().split("\n")[0].split(","), zip(*rows, strict=True), strict=True))
    file = io.BytesIO()
    pq.write_table(pa.table({name: pa.array(values) for name, values in columns.items()}), file, compression="none")
    yield "parquet", "plain", file.getvalue()
    for line in (
        "estimate robot.yaml log.csv --with ekf --out out.csv --report out.html",
        "check robot.yaml log.csv --report out.html",
        "compare log.csv log.csv --out out.json --align start",
        "merge robot.yaml log.csv --out out.csv --rate 1e3",
        "compile robot.yaml --with observer --rate 1e3 --out out.lsr",
        "init robot.urdf --out out.yaml --drive belt",
    ):
        yield "command_line", line.split()[0], bytes(WORDS.index(word) for word in line.split())


if __name__ == "__main__":
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        for target, name, content in seeds(Path(folder)):
            (CORPUS / target).mkdir(parents=True, exist_ok=True)
            (CORPUS / target / name).write_bytes(content)
