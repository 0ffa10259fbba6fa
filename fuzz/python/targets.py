"""Targets in Python: each takes any bytes, and raises where linkside does what it must not.

What is wrong with an input is a `LinksideError` of one line; an estimate is finite wherever its status says good.
`run.py` drives them with atheris, and `tests/python/test_fuzz.py` on every submission.
"""

from __future__ import annotations

import contextlib
import io
import os
import struct
import tempfile
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

import linkside
from linkside import (
    AccelerationObserver,
    Estimate,
    ExtendedKalmanFilter,
    LinksideError,
    Log,
    Noise,
    ParticleFilter,
    RauchTungStriebelSmoother,
    Robot,
)
from linkside.cli import main

DATA = Path(__file__).parents[2] / "tests/data/arm2_square"
ROBOT = Robot.load(DATA / "robot.yaml")
JOINTS = [{"name": "axis2", "stiffness": 1e5, "motor_inertia": 1.0}, {"name": "axis3", "elastic": False}]


class Finding(Exception):
    """What linkside must not do."""


@contextlib.contextmanager
def refusals() -> Iterator[None]:
    """Let linkside refuse, in one printable line."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except LinksideError as error:
        line = str(error)
        if not line.isprintable() or len(line) > linkside.errors.LONGEST or not line:
            raise Finding(f"a message that is not one printable line: {line!r}") from error


@contextlib.contextmanager
def placed(data: bytes, name: str) -> Iterator[Path]:
    """Put bytes into a file."""
    with tempfile.TemporaryDirectory(dir="/dev/shm" if os.path.isdir("/dev/shm") else None) as folder:
        path = Path(folder) / name
        path.write_bytes(data)
        yield path


def check_estimate(estimate: Estimate) -> None:
    """Estimates are numbers wherever they say that they are good."""
    good = np.asarray(estimate.status) == 0
    for values in (estimate.q, estimate.dq, estimate.q_std):
        if values is not None and not np.isfinite(values[good]).all():
            raise Finding("an estimate that is good and not finite")


def urdf(data: bytes) -> None:
    """A URDF, whose links weigh in the model what the text says."""
    text = data.decode("utf-8", "replace")
    with refusals():
        robot = Robot.from_urdf(text if text.lstrip().startswith("<") else "<" + text, JOINTS)
        torque = robot.gravity_torque(np.zeros(robot.n))
        if not np.isfinite(torque).all():
            raise Finding("a robot that is accepted has no finite torque")


def robot_yaml(data: bytes) -> None:
    """A robot.yaml beside a sound URDF."""
    with placed(data, "robot.yaml") as path, refusals():
        (path.parent / "robot.urdf").write_bytes((DATA / "robot.urdf").read_bytes())
        robot = Robot.load(path)
        if not np.isfinite(robot.mass_matrix(np.zeros(robot.n))).all():
            raise Finding("a robot that is accepted has no finite mass matrix")


def noise_yaml(data: bytes) -> None:
    """A file of tuning."""
    with placed(data, "noise.yaml") as path, refusals():
        ExtendedKalmanFilter(ROBOT, Noise.read(path))


def _log(data: bytes, name: str) -> None:
    with placed(data, name) as path, refusals():
        log = Log.read(path, ROBOT)
        check_estimate(ExtendedKalmanFilter(ROBOT, Noise(jerk=15.0)).run(log))


def csv(data: bytes) -> None:
    """A recording in CSV, and its estimate."""
    _log(data, "log.csv")


def parquet(data: bytes) -> None:
    """A recording in Parquet, and its estimate."""
    _log(data, "log.parquet")


def database(data: bytes) -> None:
    """A bag in SQLite."""
    with placed(data, "bag.db3") as path:
        _command(["convert", str(path), "--joints", "/joints", "--out", str(path.parent / "log.csv")])


def estimate_file(data: bytes) -> None:
    """An estimate that another program wrote, or changed."""
    with placed(data, "estimate.csv") as path, refusals():
        Estimate.read(path)


class Bytes:
    """Values out of bytes; what is missing is zero."""

    def __init__(self, data: bytes) -> None:
        self.data, self.at = data, 0

    def __bool__(self) -> bool:
        return self.at < len(self.data)

    def take(self, count: int) -> bytes:
        """The next bytes."""
        taken = self.data[self.at : self.at + count]
        self.at += count
        return taken + bytes(count - len(taken))

    def below(self, end: int) -> int:
        """A number below ``end``."""
        return self.take(1)[0] % end

    def number(self) -> float:
        """A number: mostly plain, now and then what no sensor should say."""
        odd = (np.nan, np.inf, -np.inf, 0.0, 1e308, -1e308, 5e-324, 1e20)
        kind = self.take(1)[0]
        return odd[kind] if kind < len(odd) else struct.unpack("<h", self.take(2))[0] / 8192

    def array(self, rows: int, width: int) -> np.ndarray:
        """An array, now and then of another shape, order or type."""
        odd = self.below(24)
        shape = {0: (rows, width + 1), 1: (rows + 1, width), 2: (rows * width,), 3: (rows, width, 1), 4: (0, width)}
        values = np.array([self.number() for _ in range(rows * width)]).reshape(rows, width)
        if odd in shape:
            return np.resize(values, shape[odd])
        kinds: dict[int, Callable[[np.ndarray], np.ndarray]] = {
            5: lambda x: x.astype(np.float32),
            6: np.asfortranarray,
            7: lambda x: x[::-1],
            8: lambda x: x.astype(complex),
            9: lambda x: x.astype(str),
        }
        with np.errstate(all="ignore"):
            return kinds.get(odd, lambda x: x)(values)


def kernels(data: bytes) -> None:
    """Arrays of any shape and type for the kernels of dynamics."""
    take = Bytes(data)
    core, rows, n = ROBOT.core, 1 + take.below(4), ROBOT.n
    names = (
        "inverse_dynamics",
        "mass_matrix",
        "forward_dynamics",
        "coriolis_matrix",
        "gravity_torque",
        "link_friction",
    )
    name = names[take.below(len(names))]
    arguments = {"inverse_dynamics": 3, "mass_matrix": 1, "forward_dynamics": 5, "gravity_torque": 1}.get(name, 2)
    with contextlib.suppress(TypeError), refusals():
        getattr(core, name)(*[take.array(rows, n) for _ in range(arguments)])


def recordings(data: bytes) -> None:
    """Tables of any numbers, and what each method makes of them."""
    take = Bytes(data)
    methods = (
        lambda: AccelerationObserver(ROBOT),
        lambda: ExtendedKalmanFilter(ROBOT, Noise(jerk=15.0)),
        lambda: RauchTungStriebelSmoother(ROBOT, Noise(jerk=15.0)),
        lambda: ParticleFilter(ROBOT, Noise(jerk=15.0), particles=16),
    )
    method = methods[take.below(len(methods))]
    rows = 1 + take.below(30)
    times = np.arange(rows) * 1e-3 if take.below(8) else np.array([take.number() for _ in range(rows)])
    columns = {"t": times}
    for signal in ("theta", "dtheta", "tau"):
        for joint in ROBOT.names:
            if take.below(12):
                columns[f"{signal}_{joint}"] = np.array([take.number() for _ in range(rows)])
    for axis in "xyz":
        columns[f"tool_acc_{axis}"] = np.array([take.number() for _ in range(rows)])
    with refusals():
        log = Log.from_table(columns, ROBOT, check=take.below(2) == 0, allow_gaps=take.below(2) == 0)
        check_estimate(method().run(log))


def steps(data: bytes) -> None:
    """`step` with arguments of any shape, type and value."""
    take = Bytes(data)
    observer, kalman = AccelerationObserver(ROBOT), ExtendedKalmanFilter(ROBOT, Noise(jerk=15.0))
    while take:
        theta, tau, acceleration = (take.array(1, width) for width in (2, 2, 3))
        arguments = [x[0] if x.ndim == 2 and len(x) else x for x in (theta, tau, acceleration)]
        with contextlib.suppress(TypeError), refusals():
            if take.below(2):
                state = observer.step(theta=arguments[0], tau=arguments[1], acceleration=arguments[2])
            else:
                dt = 1e-3 if take.below(8) else take.number()
                state = kalman.step(dt=dt, theta=arguments[0], acceleration=arguments[2])
            if state.status == 0 and not (np.isfinite(state.q).all() and np.isfinite(state.dq).all()):
                raise Finding("a state that is good and not finite")


WORDS = """
    estimate check compare merge convert init compile view learn calibrate tune place excite demo paper start next
    --with --out --report --figure --rate --tuning --free --bound --gain --poles --gate --particles --seed --json
    --quiet --strict --no-check --skip-existing --manifest --on --jobs -j --robot --names --align --shift --segments
    --link --reach --steps --axes --count --limit --by --joints --imu --wrench --field --drive --gear-ratio --kp
    --kd --debug -h --help observer ekf smoother elastic-ekf particle reduced-order nicosia-tomei robot.yaml
    robot.urdf log.csv log.parquet truth.csv estimate.csv out.csv out.html out.png out.yaml out.lsr out.json out
    belt nothing.csv . .. / 0 1 2 -1 1e3 nan inf 1e308 auto axis2 axis3 axis2=1 axis2=0:1 stiffness=1:2 bessel:250
    a,b,c upper fore x,z dask threads
""".split()  # noqa: SIM905


def command_line(data: bytes) -> None:
    """Words of the command line in any order, in a folder of its own."""
    words = [WORDS[byte] if byte < len(WORDS) else chr(byte) for byte in data[:12]]
    if not words or {"demo", "paper", "calibrate", "tune", "excite", "place", "dask"} & set(words):
        words = ["estimate", *[word for word in words if word not in ("--on", "-h")]][:12]
        words = [
            word for word in words if word not in ("demo", "paper", "calibrate", "tune", "excite", "place", "dask")
        ]
    with placed(CSV, "log.csv") as path:
        for name in ("robot.yaml", "robot.urdf"):
            (path.parent / name).write_bytes((DATA / name).read_bytes())
        before = os.getcwd()
        os.chdir(path.parent)
        try:
            _command(words)
        finally:
            os.chdir(before)


def _command(words: list[str]) -> None:
    """Run a command: its exit status is one of those that are promised, and a failure is one line."""
    out, err = io.StringIO(), io.StringIO()
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), warnings.catch_warnings():
            main(words)
    except SystemExit as end:
        said = err.getvalue()
        if end.code not in (0, 1, 2, 3, None):
            raise Finding(f"{words}: exit status {end.code}") from end
        if "Traceback" in said and "--debug" not in words:
            raise Finding(f"{words}: {said}") from end
        if end.code == 2 and not said.strip():
            raise Finding(f"{words}: fails, and says nothing") from end


CSV = "\n".join(
    [
        "t,theta_axis2,theta_axis3,tau_axis2,tau_axis3,tool_acc_x,tool_acc_y,tool_acc_z",
        *(f"{i * 5e-4},{0.001 * i},{0.5 - 0.001 * i},10,{5 + i % 3},0.1,0,9.8" for i in range(40)),
    ]
).encode()

TARGETS: dict[str, Callable[[bytes], None]] = {
    target.__name__: target
    for target in (
        urdf,
        robot_yaml,
        noise_yaml,
        csv,
        parquet,
        database,
        estimate_file,
        kernels,
        recordings,
        steps,
        command_line,
    )
}
"""Every target, by its name."""
