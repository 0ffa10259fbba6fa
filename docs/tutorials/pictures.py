"""Draws the pictures of the tutorials, from what their pages do when they are followed."""

import tempfile
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from drawing import save, style
from walk import walk

from linkside import Estimate, ExtendedKalmanFilter, Log, Robot
from linkside.excitation import expected_errors
from linkside.figures.style import COLOURS, finish

HERE = Path(__file__).parent


def norm(error: np.ndarray) -> np.ndarray:
    """Length in mm of errors in m, without their mean."""
    return 1e3 * np.linalg.norm(error - error.mean(axis=0), axis=1)


def draw_path(names: dict[str, Any], folder: Path) -> None:
    """Path and errors of the first tutorial."""
    log, estimate, motors = names["log"], names["estimate"], names["motors"]
    truth = Estimate.read(folder / "run/truth.parquet").tool_position
    figure, (path, error) = plt.subplots(1, 2, figsize=(9, 3.2), layout="constrained", width_ratios=(1, 1.7))
    for tool, look in (
        (motors, {"color": COLOURS[1]}),
        (estimate.tool_position, {"color": COLOURS[0], "linewidth": 3}),
    ):
        path.plot(tool[:, 0], tool[:, 2], **look)
    path.plot(truth[:, 0], truth[:, 2], "k--", linewidth=1)
    path.set(title="path of the tool", xlabel="x [m]", ylabel="z [m]", aspect="equal")
    error.semilogy(log.t, 1e3 * np.linalg.norm(motors - truth, axis=1), color=COLOURS[1], label="motors alone")
    smoothed = 1e3 * np.linalg.norm(estimate.tool_position - truth, axis=1)
    error.semilogy(log.t, smoothed, color=COLOURS[0], label="smoother")
    bound = 3e3 * np.linalg.norm(estimate.tool_std, axis=1)
    error.semilogy(log.t, bound, color=COLOURS[0], linestyle=":", label="smoother, three standard deviations")
    error.plot([], [], "k--", linewidth=1, label="truth")
    error.set(title="error of the tool", xlabel="time [s]", ylabel="[mm]", ylim=(1e-4, 1e3))
    error.legend(frameon=False, ncols=2, loc="upper right", fontsize="small")
    for axes in (path, error):
        finish(axes, legend=False)
    save(figure, HERE / "path.svg")


def draw_fault(names: dict[str, Any], folder: Path) -> None:
    """The NIS and the error around the fault of the first tutorial."""
    robot = names["robot"]
    log = Log.read(folder / "faulty.parquet", robot, check=False)
    estimate = ExtendedKalmanFilter(robot).run(log)
    truth = Estimate.read(folder / "run/truth.parquet").tool_position
    figure, (nis, error) = plt.subplots(2, 1, figsize=(8, 3.6), layout="constrained", sharex=True)
    nis.semilogy(log.t, np.maximum(estimate.nis, 1e-2), color=COLOURS[0])
    nis.set(ylabel="NIS of the sample", title="z axis of the accelerometer flipped at 0.6 s")
    error.plot(log.t, 1e3 * np.linalg.norm(estimate.tool_position - truth, axis=1), color=COLOURS[0])
    error.set(xlabel="time [s]", ylabel="tool error [mm]")
    for axes in (nis, error):
        axes.axvspan(0.6, log.t[-1], color=COLOURS[1], alpha=0.15, linewidth=0)
        finish(axes, legend=False)
    save(figure, HERE / "fault.svg")


def draw_calibration(names: dict[str, Any], folder: Path) -> None:
    """Estimates over true values, and the error on the second recording of the second tutorial."""
    true, found = (Robot.load(folder / name) for name in ("true.yaml", "robot.calibrated.yaml"))
    tolerances = found.config.tolerances.calibrated
    figure, (values, error) = plt.subplots(1, 2, figsize=(9, 3), layout="constrained", width_ratios=(1, 1.7))
    labels = []
    for joint, known in zip(found.drives, true.drives, strict=True):
        for kind in ("stiffness", "damping"):
            ratio = getattr(joint, kind) / getattr(known, kind)
            spread = tolerances[f"{kind}_{joint.name}"]
            values.errorbar(ratio, len(labels), xerr=2 * spread * ratio, fmt="o", color=COLOURS[0], capsize=4)
            labels.append(f"{kind},\n{joint.name}")
    values.axvline(1, color="0.5", linewidth=1)
    values.set(yticks=range(len(labels)), yticklabels=labels, title="estimate over true value", ylim=(3.5, -0.5))
    truth = Estimate.read(folder / "test/truth.parquet").tool_position
    for name, colour in (("typical.yaml", COLOURS[1]), ("robot.calibrated.yaml", COLOURS[0])):
        robot = Robot.load(folder / name)
        log = Log.read(folder / "test/log.parquet", robot)
        tool = names["RauchTungStriebelSmoother"](robot).run(log).tool_position
        error.semilogy(log.t, norm(tool - truth), color=colour, label=name.replace(".yaml", ""))
    error.set(title="error of the tool, second recording", xlabel="time [s]", ylabel="[mm]", ylim=(1e-4, 30))
    error.legend(frameon=False, loc="upper right", ncols=2)
    for axes in (values, error):
        finish(axes, legend=False)
    values.margins(x=0.1)
    save(figure, HERE / "calibrate.svg")


def draw_loop(names: dict[str, Any], folder: Path) -> None:
    """Deviation of the link in the closed loop of the third tutorial."""
    figure, axes = plt.subplots(figsize=(8, 3), layout="constrained")
    t = names["motion"].t
    for (fed_back, error), colour in zip(names["deviation"].items(), (COLOURS[1], COLOURS[0]), strict=True):
        axes.plot(t, error, color=colour, linewidth=1.2, label=f"feedback of {fed_back}")
    axes.axvspan(0.05, 0.25, color="0.6", alpha=0.2, linewidth=0, label="motion")
    axes.set(title="deviation of link 1 from its plan", xlabel="time [s]", ylabel="[mrad]")
    axes.legend(frameon=False)
    finish(axes, legend=False)
    save(figure, HERE / "loop.svg")


def draw_repeats(names: dict[str, Any], folder: Path) -> None:
    """Errors over repeats of the fourth tutorial."""
    figure, axes = plt.subplots(figsize=(8, 3), layout="constrained")
    for label, errors, look in (
        ("learning from motors: true error", names["true"], {"color": COLOURS[1], "marker": "o"}),
        ("learning from motors: error seen by the motors", names["seen"], {"color": COLOURS[1], "linestyle": ":"}),
        ("learning from the observer: true error", names["better"], {"color": COLOURS[0], "marker": "o"}),
    ):
        axes.semilogy(errors, label=label, **look)
    axes.set(title="error of the tool, RMS of each repeat", xlabel="repeat", ylabel="[mm]")
    axes.legend(frameon=False, fontsize="small")
    finish(axes, legend=False)
    save(figure, HERE / "repeats.svg")


def draw_excitation(names: dict[str, Any], folder: Path) -> None:
    """The planned motion and its standard errors, of the journey from a URDF alone."""
    motion, robot = names["motion"], Robot.load(folder / "robot.yaml")
    before, after = expected_errors(robot, []), expected_errors(robot, motion)
    figure, (path, errors) = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained", width_ratios=(1.3, 1))
    for j, name in enumerate(robot.names):
        (line,) = path.plot(motion.t[::8], motion.theta[::8, j], color=COLOURS[j], label=name)
        line.get_path().should_simplify = False
    path.set(title="planned motion", xlabel="time [s]", ylabel="[rad]")
    path.legend(frameon=False)
    chosen = [
        i for i, p in enumerate(after.parameters) if p.kind in ("stiffness", "damping", "translation", "rotation")
    ]
    rows = np.arange(len(chosen))
    errors.hlines(rows, after.std[chosen], before.std[chosen], color="0.6")
    errors.semilogx(before.std[chosen], rows, "o", color=COLOURS[1], label="without the motion")
    errors.semilogx(after.std[chosen], rows, "o", color=COLOURS[0], label="with it")
    errors.set_yticks(rows, [after.parameters[i].name for i in chosen], fontsize="x-small")
    errors.set(title="standard errors, in tolerances", ylim=(len(rows) + 0.8, -0.5))
    errors.legend(frameon=False, fontsize="small", loc="lower right", ncols=2)
    for axes in (path, errors):
        finish(axes, legend=False)
    save(figure, HERE / "urdf.svg")


def draw_bag(names: dict[str, Any], folder: Path) -> None:
    """When the sensors of the bag are read, and the error of the tool."""
    merged, robot, estimate = names["merged"], names["robot"], names["estimate"]
    truth = Estimate.read(folder / "run/truth.parquet")
    figure, (stamps, error) = plt.subplots(1, 2, figsize=(9, 2.8), layout="constrained", width_ratios=(1, 1.7))
    rows = merged.t < 0.0101
    for height, (name, values) in enumerate((("accelerometer", merged.acceleration), ("joints", merged.theta))):
        read = merged.t[rows & np.isfinite(values[:, 0])]
        stamps.plot(1e3 * read, np.full(len(read), height), "o", color=COLOURS[1 - height], label=name)
    stamps.set(title="readings", xlabel="time [ms]", yticks=(0, 1), ylim=(-0.6, 1.6))
    stamps.set_yticklabels(("accelerometer", "joints"))
    at = np.stack([np.interp(merged.t, truth.t, x) for x in truth.tool_position.T], axis=1)
    known = np.isfinite(merged.theta[:, 0])
    motors = robot.tool_position(merged.theta[known]) - at[known]
    error.semilogy(merged.t[known], 1e3 * np.linalg.norm(motors, axis=1), color=COLOURS[1], label="motors alone")
    smoothed = 1e3 * np.linalg.norm(estimate.tool_position - at, axis=1)
    error.semilogy(merged.t, smoothed, color=COLOURS[0], label="smoother")
    error.set(title="error of the tool", xlabel="time [s]", ylabel="[mm]")
    error.legend(frameon=False)
    for axes in (stamps, error):
        finish(axes, legend=False)
    stamps.margins(x=0.05)
    save(figure, HERE / "bag.svg")


def draw_batch(names: dict[str, Any], folder: Path) -> None:
    """Distance of the tool from the command in each repeat, and the NIS of each."""
    robot, path = names["robot"], names["path"]
    wanted = robot.tool_position(path.q)
    figure, (error, nis) = plt.subplots(1, 2, figsize=(9, 2.8), layout="constrained", width_ratios=(1.7, 1))
    for number, file in enumerate(sorted((folder / "estimates").glob("*.parquet"))):
        estimate, bad = Estimate.read(file), number == 17
        look = {"color": COLOURS[1] if bad else COLOURS[0], "linewidth": 1.5 if bad else 0.5, "zorder": 2 + bad}
        label = {0: "49 repeats", 17: "repeat 17"}.get(number)
        error.plot(estimate.t, 1e3 * np.linalg.norm(estimate.tool_position - wanted, axis=1), **look, label=label)
        nis.semilogy(number, np.nanmean(estimate.nis), "o", color=look["color"], markersize=3)
    error.set(title="tool, distance from the command", xlabel="time [s]", ylabel="[mm]")
    error.legend(frameon=False)
    nis.set(title="NIS, mean of a recording", xlabel="repeat")
    for axes in (error, nis):
        finish(axes, legend=False)
    save(figure, HERE / "batch.svg")


PICTURES = {
    "bag.md": (draw_bag,),
    "batch.md": (draw_batch,),
    "urdf.md": (draw_excitation,),
    "path.md": (draw_path, draw_fault),
    "calibrate.md": (draw_calibration,),
    "loop.md": (draw_loop,),
    "repeats.md": (draw_repeats,),
}


@style()
def draw_all() -> None:
    """Follow the tutorials, and draw what they found."""
    for page, draw in PICTURES.items():
        with tempfile.TemporaryDirectory() as directory:
            names = walk(HERE / page, Path(directory))
            for picture in draw:
                picture(names, Path(directory))
