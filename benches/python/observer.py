"""The acceleration-driven observer against the same in NumPy and Pinocchio, on the six-axis recording."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy_observer import NumpyObserver
from timing import Result, microseconds

from linkside import AccelerationObserver, Log, Robot
from linkside.observers.poles import damped

FOLDER = Path(__file__).parents[2] / "tests/data/kr15_six_axes"
POLES = damped(250)
AGREE = 1e-9  # rad


def bench() -> Iterator[Result]:
    """`run` for three and for six elastic joints, and `step`."""
    robot = Robot.load(FOLDER / "robot.yaml")
    yield run("run, 3 elastic joints of 6, 1 sensor", variant(robot, elastic=3, sensors=1))
    yield run("run, 6 elastic joints, 3 sensors", robot)
    yield step("step from Python, 3 joints, 1 sensor", variant(robot, elastic=3, sensors=1, joints=3))
    yield step("step from Python, 6 joints, 3 sensors", robot)


def variant(robot: Robot, elastic: int, sensors: int, joints: int = 6) -> Robot:
    """The robot with its first joints and sensors; joints beyond `elastic` follow their motors."""
    settings = robot.config.model_dump(exclude={"urdf"})
    settings["accelerometers"] = settings["accelerometers"][:sensors]
    settings["joints"] = settings["joints"][:joints]
    for joint in settings["joints"][elastic:]:
        joint["elastic"] = False
    return Robot.from_urdf(FOLDER / "robot.urdf", **settings)


def run(what: str, robot: Robot) -> Result:
    """Whole recordings; first made sure that both compute the same."""
    log = Log.read(FOLDER / "log.parquet", robot)
    ours = AccelerationObserver(robot, POLES, start="rest")
    theirs = NumpyObserver(FOLDER / "robot.urdf", robot, POLES.poles, 1 / robot.config.rate_hz)
    arrays = log.theta, log.tau, log.acceleration
    apart = np.abs(ours.run(log).q - theirs.run(*arrays)["q"]).max()
    if apart > AGREE:
        raise SystemExit(f"{what}: linkside and NumPy are {apart:.1e} rad apart, this compares nothing")
    loop = microseconds(lambda: theirs.run(*arrays), len(log), repeats=5)
    whole = microseconds(lambda: ours.run(log), len(log), repeats=25)
    return Result(what, whole, "NumPy + Pinocchio in a loop", loop, least_ratio=200)


def step(what: str, robot: Robot) -> Result:
    """One sample after the other, as a control loop would."""
    log = Log.read(FOLDER / "log.parquet", robot)
    observer = AccelerationObserver(robot, POLES, start="rest")
    samples = list(zip(log.theta, log.tau, log.acceleration, strict=True))

    def loop() -> None:
        observer.reset()
        for theta, tau, acceleration in samples:
            observer.step(theta=theta, tau=tau, acceleration=acceleration)

    return Result(what, microseconds(loop, len(samples)), most=3.0 if robot.n == 3 else None)
