"""Draws record.svg, how well motions determine springs, and prints the table of record.md; takes a minute or two."""

import runpy
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from drawing import save, style

from linkside import Log, Robot, Sensor, simulate
from linkside.calibration import calibrate
from linkside.control.trajectories import rest_to_rest
from linkside.figures.style import COLOURS, finish

HERE = Path(__file__).parent
POSTURES = np.array([[-0.9, 1.2], [-0.3, 0.4], [-1.1, 1.5], [-0.7, 0.9]])
DURATIONS = (0.3, 0.6, 1.2, 2.0)
SHARES = {"up to 0.8 and 1.1 rad": 1.0, "up to 0.12 and 0.17 rad": 0.15}
JOINTS = ("shoulder", "elbow")
PERCENT = (0.5, 1, 2, 5, 10)


def record(robot: Robot, seconds: float, share: float = 1.0, noise: bool = True) -> Log:
    """Move the arm of the tutorials from posture to posture, each motion taking so many seconds."""
    postures = POSTURES[0] + share * (POSTURES - POSTURES[0])
    path = rest_to_rest(postures, duration=seconds, period=1e-3)

    def controller(t, state):
        row = min(round(1000 * t), len(path.q) - 1)
        error, rate = path.q[row] - state.theta, path.dq[row] - state.dtheta
        return hold[row] + [4e4, 1.2e4] * error + [1500, 400] * rate

    hold = robot.gravity_torque(path.q)
    sensors = {} if noise else {"acceleration": Sensor(), "theta": Sensor()}
    duration = len(path.q) / 1000
    return simulate(robot, controller, duration, 1000, q=postures[0], substeps=4, sensors=sensors).log


def draw_readings(axes: plt.Axes, robot: Robot) -> None:
    """How springs that are 20 % stiffer change the accelerometer's readings."""
    stiffer = robot.scaled(stiffness=1.2)
    for seconds, colour in ((0.3, COLOURS[0]), (2.0, COLOURS[1])):
        one, other = (record(machine, seconds, noise=False) for machine in (robot, stiffer))
        change = (other.acceleration - one.acceleration)[:, 2]
        axes.plot(one.t / one.t[-1], change, color=colour, linewidth=1, label=f"{seconds:g} s a motion")
        print(f"{seconds} s: the readings change by {change.std():.3f} m/s² RMS")
    axes.axhspan(-0.05, 0.05, color="0.6", alpha=0.5, linewidth=0, label="noise of the sensor")
    axes.set(title="effect of 20 % stiffer springs on a reading", xlabel="share of the recording", ylabel="[m/s²]")
    axes.legend(frameon=False, fontsize="small", loc="lower right")


@style()
def draw_all() -> None:
    """Calibrate on recordings from fast to slow, of large motions and small ones."""
    walk = runpy.run_path(str(HERE / "walk.py"))["walk"]
    with tempfile.TemporaryDirectory() as directory:
        walk(HERE / "tutorials/path.md", Path(directory))
        robot = Robot.load(Path(directory) / "robot.yaml")
    guess = robot.scaled(stiffness=1.15)
    figure, (readings, errors) = plt.subplots(1, 2, figsize=(9, 3.2), layout="constrained")
    draw_readings(readings, robot)
    for (name, share), marker in zip(SHARES.items(), ("o-", "s--"), strict=True):
        found = {joint: [] for joint in JOINTS}
        for seconds in DURATIONS:
            result = calibrate(guess, record(robot, seconds, share))
            cells = []
            for joint in JOINTS:
                estimates = {e.parameter.name: e for e in result.estimates}
                spring = estimates.get(f"stiffness_{joint}")
                found[joint].append(100 * spring.std / spring.value if spring else np.nan)
                cells.append(f"{spring.value:.0f} ± {spring.std:.0f}" if spring else "refused")
            print(f"| {name} | {seconds} s | {' | '.join(cells)} | {'yes' if result.accepted else 'no'} |", flush=True)
        for joint, colour in zip(JOINTS, COLOURS, strict=False):
            errors.loglog(DURATIONS, found[joint], marker, color=colour, label=f"{joint}, {name}")
    errors.set(title="standard error of a calibrated spring", xlabel="duration of a motion [s]", ylabel="[%]")
    errors.set_xticks(DURATIONS, [f"{seconds:g}" for seconds in DURATIONS])
    errors.set_yticks(PERCENT, [f"{value:g}" for value in PERCENT])
    errors.minorticks_off()
    errors.legend(frameon=False, fontsize="x-small")
    for axes in (readings, errors):
        finish(axes, legend=False)
    save(figure, HERE / "record.svg")
